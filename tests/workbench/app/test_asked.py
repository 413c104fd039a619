"""What a diagnosis is asked to look for, and what is known before it: the same in the page and on the command line."""

import json
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from pendulum_env.physics import BASE, Model
from pendulum_env.recording import Source, write_recording
from tests import slow
from tests.patience import PATIENCE
from tests.workbench.app.plants import recorded

pytest.importorskip("dash")

from dash import html

from workbench.app.asked import NOTHING, Asked
from workbench.app.jobs import Workers
from workbench.app.session import Session
from workbench.app.stages import diagnose
from workbench.app.stages.export import commands, snippet
from workbench.app.tasks import start_addition, start_diagnosis
from workbench.cli import main

ASKED = Asked(only="stribeck,quadratic_drag,spring", without="spring", fix="gravity=2.01", bound="viscous=0:0.2")


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    workers = Workers()
    yield workers
    workers.close()


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    """A session with `swing.csv`, which lies in the working directory as well."""
    write_recording(recorded("swing", 1, 10.0), tmp_path / "swing.csv")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "session").mkdir()
    session = Session(tmp_path / "session")
    session.copy([Source(tmp_path / "swing.csv")])
    return session


@pytest.mark.slow
def test_what_is_asked_for_gives_what_the_command_line_gives(session: Session, workers: Workers) -> None:
    assert session.look_for(ASKED)
    base = session.state.model.estimates["gravity"]
    assert (base.value, base.std) == (2.01, 0.0)  # from the first rung on
    for start in (start_diagnosis, lambda *to: start_addition(*to, "stribeck")):
        with session.lock:
            start(session, workers)
        assert session.job is not None and session.job.over.wait(PATIENCE) and session.notice == ""
    found = session.state.diagnosis
    assert found is not None and {one.effect for one in found.candidates} == {"stribeck", "quadratic_drag"}
    for line in commands(session.state).splitlines():
        assert main(shlex.split(line)[1:]) == 0
    assert json.loads(Path("diagnosis.json").read_text()) == json.loads(json.dumps(found.json()))
    made = Model.load("model.json")
    assert made.estimates["gravity"].value == 2.01 and made.estimates["viscous"].value <= 0.2
    assert made.theta == pytest.approx(session.state.model.theta, rel=1e-6)
    exec(snippet(session.state), {})
    assert Model.load("model.json").theta == pytest.approx(session.state.model.theta, rel=1e-6)


def test_the_ladder_begins_anew_where_other_values_are_known_and_only_there(session: Session) -> None:
    before = session.state
    session.look_for(Asked(only="stribeck"))
    assert session.state.ladder is before.ladder
    session.look_for(Asked(bound="gravity=:1.5"))
    assert session.state.model.estimates["gravity"].value == pytest.approx(1.5) and session.state.ladder != before
    session.act(lambda: session.hold_out("swing.csv", False))
    session.state = session.state.having(session.state.loaded)
    assert session.state.model.estimates["gravity"].value == pytest.approx(1.5)  # other recordings, the same bounds
    session.look_for(NOTHING)
    assert session.state.model.theta == pytest.approx(before.model.theta)


@pytest.mark.parametrize(
    ("field", "wrong"),
    slow.but_first(
        [
            ("only", "stribek"),
            ("without", "--fix"),
            ("fix", "gravity"),
            ("fix", "gravity=heavy"),
            ("fix", "gravty=2"),
            ("fix", "cogging.order=12"),
            ("bound", "viscous=1"),
            ("bound", "viscous=1:0"),
        ]
    ),
)
def test_a_mistake_stands_beside_its_field_in_the_words_of_the_command_line(
    session: Session, capsys: pytest.CaptureFixture[str], field: str, wrong: str
) -> None:
    asked, before = Asked(**{field: wrong}), session.state
    assert not session.look_for(asked) and session.state is before
    (said,) = asked.faults(BASE).items()
    assert said[0] == field
    assert main(["diagnose", "swing.csv", f"--{field}={wrong}"]) == 2
    assert said[1] in capsys.readouterr().err
    page = html.Div(diagnose.show(session))
    shown = [str(one) for one in page._traverse() if getattr(one, "role", None) == "alert"]
    assert len(shown) == 1 and getattr(page[f"ask-{field}"], "value", "") in (wrong, [wrong])


def test_two_fields_that_contradict_each_other_are_told_of_once() -> None:
    assert list(Asked(fix="gravity=2", bound="gravity=1:3").faults(BASE)) == ["bound"]
    assert list(Asked(only="stribeck", without="stribeck").faults(BASE)) == ["without"]
    assert Asked.of([["stribeck", "cogging"], None, " gravity=2 ", ""]) == Asked("stribeck,cogging", "", "gravity=2")
