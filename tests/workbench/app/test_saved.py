"""Sessions in a file, and every change taken back."""

import io
import json
import math
import zipfile
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from estimators import add, diagnose
from estimators.selection.score import Gain
from pendulum_env.physics.potential import HardStop
from tests.estimators.diagnosis.test_experiment import first as wagged
from tests.workbench.app.plants import files_of, limited, recorded, reopened, upload, written
from workbench.app.card import Choice
from workbench.app.saved import CONTENTS, STUDY, _plain, _typed, pack, study
from workbench.app.session import Session
from workbench.app.stages.diagnose import look_for
from workbench.app.stages.export import commands, file
from workbench.app.state import Asked, State
from workbench.mistakes import InputError

ASKED = Asked(only="stribeck,quadratic_drag", fix="gravity=2.01")
CHOICES = [Choice("time", "ms"), Choice("position", "", "*-1/6"), Choice("torque", "A", "0.091")]


def plain(record: object) -> object:
    return json.loads(json.dumps(record, default=_plain))


@pytest.fixture(scope="module")
def worked(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session that has chosen columns, held a recording out, known a value, diagnosed and added what was found."""
    folder = tmp_path_factory.mktemp("worked")
    swing = recorded("swing", 1, 8.0, rate=250.0)
    rows = zip(1e3 * swing.time, -6 * swing.position, swing.torque / 0.091, strict=True)
    text = "clock,angle,current\n" + "".join(f"{t:.9g},{q:.12g},{i:.12g}\n" for t, q, i in rows)
    session = Session(folder / "session")
    upload(session, "swing.csv", text.encode())
    session.act(lambda: session.answer(session.cards[0].told(CHOICES, False, (0.0, 7.0))))
    session.act(lambda: session.load([written(recorded("check", 2, 5.0, rate=250.0), folder, held_out=True)]))
    session.act(lambda: look_for(session, ASKED))
    state = session.state
    found = diagnose(state.train, state.holdout, state.model.terms, **ASKED.effects, **ASKED.limits)
    state = state.diagnosed(found)
    session.state = state.with_step(add(state.model, "stribeck", state.train, state.holdout, **ASKED.limits))
    assert session.notice == "" and session.state.added == ("stribeck",)
    return session


def test_a_saved_session_opens_as_it_was(worked, tmp_path):
    session = reopened(tmp_path, pack(worked.state))
    assert session.notice == "" and files_of(session) == ["check.csv", "swing.csv"]
    before, after = worked.state, session.state
    assert study(session.state) == study(worked.state) and commands(after) == commands(before)
    assert (after.asked, after.added, after.found) == (ASKED, before.added, before.found)
    for old, new in zip(before.loaded, after.loaded, strict=True):
        np.testing.assert_array_equal(new.recording.position, old.recording.position)
        assert new.held_out == old.held_out
    assert plain(after.told) == plain(before.told)
    drawn, again = (one.case.data.parts[0].residual(one.model.terms, one.model.theta) for one in (before, after))
    np.testing.assert_allclose(again, drawn, rtol=1e-9)  # of data that are prepared anew
    assert after.without_step().model.theta == pytest.approx(before.without_step().model.theta, rel=1e-12)
    grown = [add(one.model, "quadratic_drag", one.train, one.holdout, **ASKED.limits) for one in (before, after)]
    assert plain(grown[1]) == plain(grown[0])  # the work goes on alike


def test_a_session_without_recordings_or_model_opens_as_well(tmp_path):
    first = Session(tmp_path / "first")
    assert reopened(tmp_path, pack(first.state)).notice == ""
    first.act(lambda: first.load([written(recorded("held", 1, 4.0), tmp_path, held_out=True)]))
    assert first.state.trouble
    session = reopened(tmp_path, pack(first.state))
    assert session.notice == "" and session.state.trouble == first.state.trouble


def changed(content: bytes, change: Callable[[dict[str, bytes]], object]) -> bytes:
    """An archive with its files changed."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return packed.getvalue()


def told(*path: str | int, to: object) -> Callable[[dict[str, bytes]], None]:
    """Change a value of `session.json`."""

    def change(files: dict[str, bytes]) -> None:
        place = content = json.loads(files[CONTENTS])
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = to
        files[CONTENTS] = json.dumps(content).encode()

    return change


def elsewhere(files: dict[str, bytes]) -> None:
    files["../../check.csv"] = files.pop("check.csv")
    files[STUDY] = files[STUDY].replace(b'"check.csv"', b'"../../gone.csv"')


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda files: files.pop(CONTENTS), "lacks session.json"),
        (lambda files: files.pop("check.csv"), "lacks check.csv"),
        (lambda files: files.update({"check.csv": b"\x80\x04pickle"}), "check.csv: "),
        (elsewhere, "lacks gone.csv"),
        (lambda files: files.update({CONTENTS: b"[" * 100_000}), "is not JSON"),
        (told("schema", to="other"), "'schema' of session.json should be"),
        (told("ladder", 0, "model", "terms", 0, to="os.system"), "unknown effect 'os.system'"),
        (told("ladder", 1, "errors", "holdout", "position_rms", to=None), "makes no sense"),
        (told("diagnosis", "candidates", 0, "verdict", to="sure"), "'sure' is not a valid Verdict"),
        (told("asked", "fix", to="gravity"), "should be NAME=VALUE"),
        (told("origins", to=7), "makes no sense"),
    ],
)
def test_a_file_that_is_no_session_changes_nothing(worked, tmp_path, change, why):
    session = reopened(tmp_path, changed(pack(worked.state), change))
    assert why in session.notice and str(tmp_path) not in session.notice and "\n" not in session.notice
    assert session.state.loaded == () and not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_archives_that_are_damaged_or_hold_too_much_are_refused(worked, tmp_path, monkeypatch):
    for content in (b"PK", pack(worked.state)[:-40], b"time,position,torque\n"):
        assert "session.zip: is damaged, or no ZIP archive" in reopened(tmp_path, content).notice
    bomb = changed(pack(worked.state), lambda files: files.update({"zeros": bytes(10_000_000)}))
    limited(monkeypatch, space=5_000_000)
    assert "of which at most 5 MB are read" in reopened(tmp_path, bomb).notice
    limited(monkeypatch, upload=1000)
    with pytest.raises(InputError, match="remove a recording first"):
        pack(worked.state)


@pytest.mark.parametrize("number", [1.5, math.inf, -math.inf, math.nan])
def test_a_record_comes_back_from_json(number):
    back = _typed(Gain, plain(Gain(number, 0.0, 0.5)))
    assert (back.error, back.chance) == (0.0, 0.5) and back.total == pytest.approx(number, nan_ok=True)


def test_windows_and_timing_of_a_diagnosis_come_back(worked, tmp_path):
    state = worked.state
    assert state.diagnosis is not None and state.diagnosis.data is not None
    beside = (*state.terms, HardStop())
    late = [replace(one, channel=replace(one.channel, delay=0.004)) for one in state.diagnosis.alignments]
    data = replace(state.diagnosis.data, window_share=0.5, impacts_beside=beside)
    session = Session(tmp_path / "first")
    session.state = replace(state, diagnosis=replace(state.diagnosis, data=data, alignments=tuple(late)))
    found = reopened(tmp_path, pack(session.state)).state.diagnosis
    assert found is not None and found.data is not None and found.data.impacts_beside is not None
    assert [term.id for term in found.data.impacts_beside] == [term.id for term in beside]
    assert found.data.window_share == 0.5 and [one.delay for one in found.data.alignments] == [0.004, 0.004]


def test_a_session_of_an_older_version_has_its_table_and_noise_floor(worked, tmp_path):
    def older(files: dict[str, bytes]) -> None:
        content = json.loads(files[CONTENTS])
        content["diagnosis"]["noise_floor"] = content["diagnosis"].pop("floors")[""]
        content["diagnosis"]["table"] = content["diagnosis"].pop("tables") or None
        files[CONTENTS] = json.dumps(content).encode()

    session = reopened(tmp_path, changed(pack(worked.state), older))
    assert session.notice == "" and plain(session.state.told) == plain(worked.state.told)


def test_an_experiment_that_is_suggested_is_saved_and_comes_back(tmp_path):
    session = Session(tmp_path / "first")
    wagging, found = wagged("a spring at small angles")
    session.act(lambda: session.load([written(wagging, tmp_path)]))
    session.state = session.state.diagnosed(found)
    text = file(session.state, "experiment", "")[1]
    rows = np.loadtxt(io.BytesIO(text), delimiter=",", skiprows=1)
    assert rows.shape[1] == 2 and np.abs(rows[:, 1]).max() > 1.0
    again = reopened(tmp_path, pack(session.state)).state
    assert file(again, "experiment", "") == file(session.state, "experiment", "")
    with pytest.raises(InputError, match="the diagnosis suggests no experiment"):
        file(Session(tmp_path / "empty").state, "experiment", "")


# ------------------------------------------------------------------------------------------------ undo


def test_every_change_is_taken_back_in_turn(tmp_path):
    session = Session(tmp_path / "session")
    sources = [written(recorded(name, seed, 4.0), tmp_path) for name, seed in (("swing", 1), ("check", 2))]
    known: list[tuple[State, str]] = []
    for do, what in (
        (lambda: session.load(sources), "load swing and check"),
        (lambda: session.hold_out("check.csv", True), "fit or check"),
        (lambda: look_for(session, Asked(fix="gravity=2")), "choose what is looked for"),
        (lambda: session.remove("check.csv"), "remove check"),
    ):
        known.append((session.state, what))
        session.act(do)
        assert session.notice == "" and session.last_change == what
        session.act(lambda: look_for(session, session.state.asked))
        assert session.last_change == what  # what changes nothing is no change
    for before, what in reversed(known):
        assert session.last_change == what
        session.act(session.undo)
        assert session.state is before
    session.act(session.undo)
    assert session.notice == "there is nothing to undo" and session.last_change == ""


def test_a_file_that_was_removed_goes_when_nothing_can_bring_it_back(tmp_path, monkeypatch):
    session = Session(tmp_path / "session")
    content = written(recorded("swing", 1, 4.0), tmp_path).file.read_bytes()
    for _ in range(2):  # another file of a name that was removed takes its place
        upload(session, "swing.csv", content)
        session.act(lambda: session.remove("swing.csv"))
        assert session.notice == ""
    upload(session, "swing.csv", b"time,position,torque\n0,0,0\n0.001,nan,0\n")  # nor does one that cannot be read
    assert session.notice.startswith("swing.csv: ") and files_of(session) == ["swing.csv"] * 2
    for what in ("remove swing", "load swing") * 2:
        assert session.last_change == what
        session.act(session.undo)
    assert session.last_change == "" and files_of(session) == []
    limited(monkeypatch, undone=1)
    upload(session, "swing.csv", content)
    session.act(lambda: session.remove("swing.csv"))
    upload(session, "check.csv", content)
    assert files_of(session) == ["check.csv"]
