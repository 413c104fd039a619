"""Sessions in a file, and every change taken back."""

import base64
import io
import json
import math
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimators import add, diagnose
from estimators.selection.score import Gain
from pendulum_env.reading import Unreadable, Value
from pendulum_env.recording import Source, write_recording
from tests.workbench.app.plants import recorded

pytest.importorskip("dash")

from workbench.app import session as session_module
from workbench.app.asked import Asked
from workbench.app.mapping import Choice
from workbench.app.saved import CONTENTS
from workbench.app.session import STUDY, Session
from workbench.app.stages.export import commands
from workbench.app.state import State
from workbench.app.typed import plain, typed

ASKED = Asked(only="stribeck,quadratic_drag", fix="gravity=2.01")
CHOICES = [Choice("time", "ms"), Choice("position", "", "*-1/6"), Choice("torque", "A", "0.091")]


def session_in(folder: Path) -> Session:
    folder.mkdir()
    return Session(folder)


def opened(folder: Path, content: bytes, name: str = "session.zip") -> Session:
    session = session_in(folder / "other")
    session.act(lambda: session.open(name, f"data:;base64,{base64.b64encode(content).decode()}"))
    return session


@pytest.fixture(scope="module")
def worked(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session that has chosen columns, held a recording out, known a value, diagnosed and added what was found."""
    folder = tmp_path_factory.mktemp("worked")
    swing = recorded("swing", 1, 8.0)
    rows = zip(1e3 * swing.time, -6 * swing.position, swing.torque / 0.091, strict=True)
    text = "clock,angle,current\n" + "".join(f"{t:.9g},{q:.12g},{i:.12g}\n" for t, q, i in rows)
    write_recording(recorded("check", 2, 5.0), folder / "check.csv")
    session = session_in(folder / "session")
    data = f"data:;base64,{base64.b64encode(text.encode()).decode()}"
    session.act(lambda: session.receive([("swing.csv", data)], unwrap=False))
    session.act(lambda: session.answer(session.cards[0].told(CHOICES, False, (0.0, 7.0))))
    session.act(lambda: session.copy([Source(folder / "check.csv", role="holdout")]))
    session.act(lambda: session.look_for(ASKED) or None)
    state = session.state
    found = diagnose(state.train, state.holdout, state.model.terms, **ASKED.effects, **ASKED.limits)
    state = state.diagnosed(found, state.ladder)
    session.state = state.grown(add(state.model, "stribeck", state.train, state.holdout, **ASKED.limits))
    assert session.notice == "" and session.state.added == ("stribeck",)
    return session


def test_a_saved_session_opens_as_it_was(worked: Session, tmp_path: Path) -> None:
    session = opened(tmp_path, worked.save())
    assert session.notice == "" and sorted(path.name for path in tmp_path.glob("*/*")) == ["check.csv", "swing.csv"]
    before, after = worked.state, session.state
    assert session.study() == worked.study() and commands(after) == commands(before)
    assert (after.asked, session.tried, after.added, after.found) == (ASKED, ASKED, before.added, before.found)
    for old, new in zip(before.loaded, after.loaded, strict=True):
        np.testing.assert_array_equal(new.recording.position, old.recording.position)
        assert new.held_out == old.held_out
    assert plain(after.told) == plain(before.told) and after.model.terms == before.model.terms  # limits included
    assert after.undone().model.theta == pytest.approx(before.undone().model.theta, rel=1e-12)
    grown = [add(one.model, "quadratic_drag", one.train, one.holdout, **ASKED.limits) for one in (before, after)]
    assert plain(grown[1]) == plain(grown[0])  # the work goes on alike


def test_a_session_without_recordings_or_model_opens_as_well(tmp_path: Path) -> None:
    first = session_in(tmp_path / "first")
    write_recording(recorded("held", 1, 4.0), tmp_path / "held.csv")
    first.act(lambda: first.copy([Source(tmp_path / "held.csv", role="holdout")]))
    assert first.state.trouble
    session = opened(tmp_path, first.save())
    assert session.notice == "" and session.state.trouble == first.state.trouble


def changed(content: bytes, change: Callable[[dict[str, bytes]], object]) -> bytes:
    """An archive with its files changed."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return packed.getvalue()


def deflated(content: bytes) -> bytes:
    """A small archive of a large file."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(CONTENTS, content)
    return packed.getvalue()


def told(*path: str | int, to: object) -> Callable[[dict[str, bytes]], None]:
    """Change a value of `session.json`."""

    def change(files: dict[str, bytes]) -> None:
        content = json.loads(files[CONTENTS])
        place = content
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = to
        files[CONTENTS] = json.dumps(content).encode()

    return change


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda files: files.pop(CONTENTS), "lacks session.json"),
        (lambda files: files.pop("check.csv"), "lacks check.csv"),
        (lambda files: files.update({"check.csv": b"\x80\x04pickle"}), "check.csv: "),
        (lambda files: files.update({STUDY: b"[[recording]]\nfile='../../check.csv'\n"}), "different recordings"),
        (lambda files: files.update({CONTENTS: b"[" * 100_000}), "nests more than"),
        (told("schema", to="other"), "'schema' should be"),
        (told("ladder", 0, "model", "terms", 0, to="os.system"), "unknown effect 'os.system'"),
        (told("ladder", 1, "added", to="cogging"), "do not follow from each other"),
        (told("ladder", 0, "errors", "train", "torque_rms", to="1"), "'ladder[0].errors.train.torque_rms' of the"),
        (told("ladder", 1, "errors", "holdout", "position_rms", to=0), "do not follow from each other"),
        (told("diagnosis", "candidates", 0, "effect", to="<script>"), "is not one of its recordings"),
        (told("diagnosis", "candidates", 0, "verdict", to="sure"), "has to be one of selected, "),
        (told("diagnosis", to=None), "is not one of its recordings"),
        (told("asked", "fix", to="gravity"), "should be NAME=VALUE"),
        (told("origins", to=7), "'origins' of the session is 7: it has to be a list"),
    ],
)
def test_a_file_that_is_no_session_changes_nothing(
    worked: Session, tmp_path: Path, change: Callable[[dict[str, bytes]], None], why: str
) -> None:
    session = opened(tmp_path, changed(worked.save(), change))
    assert why in session.notice and str(tmp_path) not in session.notice and "\n" not in session.notice
    assert session.state.loaded == () and [path.name for path in tmp_path.iterdir()] == ["other"]


def test_archives_that_are_damaged_or_hold_too_much_are_refused(
    worked: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number, content in enumerate((b"PK", worked.save()[:-40], b"time,position,torque\n")):
        (tmp_path / str(number)).mkdir()
        assert "session.zip: is damaged, or no ZIP archive" in opened(tmp_path / str(number), content).notice
    packed = deflated(bytes(10_000_000))
    monkeypatch.setattr(session_module, "SPACE", 20_000)
    assert "of which at most 20 kB are read" in opened(tmp_path, packed).notice
    monkeypatch.setattr(session_module.uploads, "UPLOAD", 1000)
    with pytest.raises(session_module.InputError, match="remove a recording first"):
        worked.save()


def test_a_name_in_an_archive_leads_nowhere_else(worked: Session, tmp_path: Path) -> None:
    def change(files: dict[str, bytes]) -> None:
        files["../../check.csv"] = files.pop("check.csv")
        files[STUDY] = files[STUDY].replace(b'"check.csv"', b'"../../check.csv"')

    session = opened(tmp_path, changed(worked.save(), change))
    assert session.notice == "session.zip: lacks check.csv; a session is what “Save session” wrote"
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == []


@pytest.mark.parametrize("number", [1.5, math.inf, -math.inf])
def test_a_record_comes_back_from_json(number: float) -> None:
    gain = Gain(number, math.nan, 0.5)
    back = typed(Gain, Value("the gain", "", json.loads(json.dumps(plain(gain), allow_nan=False))))
    assert (back.total, back.chance) == (number, 0.5) and math.isnan(back.error)
    with pytest.raises(Unreadable, match="'chance' of the gain is True"):
        typed(Gain, Value("the gain", "", {"total": 1.0, "error": 0.0, "chance": True}))


# ------------------------------------------------------------------------------------------------ undo


def test_every_change_is_taken_back_in_turn(tmp_path: Path) -> None:
    session = session_in(tmp_path / "session")
    write_recording(recorded("swing", 1, 4.0), tmp_path / "swing.csv")
    write_recording(recorded("check", 2, 4.0), tmp_path / "check.csv")
    known: list[tuple[State, str]] = []
    for do, what in (
        (
            lambda: session.copy([Source(tmp_path / "swing.csv"), Source(tmp_path / "check.csv")]),
            "load swing and check",
        ),
        (lambda: session.hold_out("check.csv", True), "fit or check"),
        (lambda: session.align(True), "correct the torque"),
        (lambda: session.look_for(Asked(fix="gravity=2")), "choose what is looked for"),
        (lambda: session.remove("check.csv"), "remove check"),
    ):
        known.append((session.state, what))
        session.act(do)  # type: ignore[arg-type]  # what it returns is nobody's business
        assert session.notice == "" and session.last_change == what
        session.act(lambda: session.look_for(session.state.asked) and session.align(session.state.is_aligned))  # type: ignore[func-returns-value]
        assert session.last_change == what  # what changes nothing is no change
    for before, what in reversed(known):
        assert session.last_change == what
        session.act(session.undo)
        assert session.state is before and session.tried == before.asked
        assert {one.file for one in before.loaded} == set(session.folder.iterdir())
    session.act(session.undo)
    assert session.notice == "there is nothing to undo" and session.last_change == ""


def test_a_file_that_was_removed_goes_when_nothing_can_bring_it_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = session_in(tmp_path / "session")
    write_recording(recorded("swing", 1, 4.0), tmp_path / "swing.csv")
    write_recording(recorded("check", 2, 4.0), tmp_path / "check.csv")

    def load_and_remove() -> None:
        session.act(lambda: session.copy([Source(tmp_path / "swing.csv")]))
        session.act(lambda: session.remove("swing.csv"))
        assert session.notice == "" and (session.folder / "swing.csv").exists()

    load_and_remove()
    load_and_remove()  # another file of a name that was removed takes its place
    for what in ("remove swing", "load swing"):
        assert session.last_change == what
        session.act(session.undo)
        assert session.notice == ""
    session.act(session.undo)
    assert session.notice == "there is nothing to undo" and list(session.folder.iterdir()) == []
    load_and_remove()
    monkeypatch.setattr("workbench.app.history.MOST_UNDONE", 1)
    session.act(lambda: session.copy([Source(tmp_path / "check.csv")]))
    assert [file.name for file in session.folder.iterdir()] == ["check.csv"]
