"""What a diagnosis is asked to look for, and what is known before it: the same in the page and on the command line."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import slow
from tests.patience import PATIENCE
from tests.workbench.app.plants import comes_to_the_same, recorded, written
from workbench.app.session import Session
from workbench.app.stages import add, diagnose
from workbench.app.state import NOTHING, Asked
from workbench.processes import Workers

ASKED = Asked(only="stribeck,quadratic_drag,spring", without="spring", fix="gravity=2.01", bound="viscous=0:0.2")


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    workers = Workers()
    yield workers
    workers.close()


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: Workers) -> Session:
    """A session with `swing.csv`, which lies in the working directory as well."""
    monkeypatch.chdir(tmp_path)
    session = Session(tmp_path / "session", workers)
    session.load([written(recorded("swing", 1, 10.0), tmp_path)])
    return session


@pytest.mark.slow
def test_what_is_asked_for_gives_what_the_command_line_gives(session):
    for start in (lambda: diagnose.start(session, ASKED), lambda: add.start(session, "stribeck")):
        session.act(start)
        assert session.job is not None and session.job.over.wait(PATIENCE) and session.notice == ""
    base = session.state.ladder[0].model.estimates["gravity"]
    assert (base.value, base.std) == (2.01, 0.0)  # from the first rung on
    found = session.state.diagnosis
    assert found is not None and {one.effect for one in found.candidates} == {"stribeck", "quadratic_drag"}
    made = session.state.model.estimates
    assert made["gravity"].value == 2.01 and made["viscous"].value <= 0.2
    comes_to_the_same(session.state, "shell", "Python")
    assert json.loads(Path("diagnosis.json").read_text()) == json.loads(json.dumps(found.json()))


def test_the_ladder_begins_anew_where_other_values_are_known_and_only_there(session):
    before = session.state
    diagnose.look_for(session, Asked(only="stribeck"))
    assert session.state.prepared is before.prepared
    diagnose.look_for(session, Asked(bound="gravity=:1.5"))
    assert session.state.model.estimates["gravity"].value == pytest.approx(1.5)
    session.state = session.state.anew(loaded=session.state.loaded)  # perhaps other recordings: the same bounds
    assert session.state.model.estimates["gravity"].value == pytest.approx(1.5)
    diagnose.look_for(session, NOTHING)
    assert session.state.model.theta == pytest.approx(before.model.theta)


@pytest.mark.parametrize(
    ("field", "wrong"),
    slow.but_first([("only", "stribek"), ("without", "--fix"), ("fix", "gravty=2"), ("bound", "viscous=1:0")]),
)
def test_a_mistake_is_told_in_the_words_of_the_command_line(session, field, wrong, refused):
    before = session.state
    session.act(lambda: diagnose.look_for(session, Asked(**{field: wrong})))
    assert session.state is before and session.job is None
    assert session.notice != "" and session.notice in refused("diagnose", "swing.csv", f"--{field}={wrong}")


def test_fields_of_the_form_become_options():
    form = {"ask-only": ["stribeck", "cogging"], "ask-without": None, "ask-fix": " gravity=2 ", "ask-bound": ""}
    assert Asked.of(form) == Asked("stribeck,cogging", "", "gravity=2")
