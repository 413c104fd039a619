"""Every change of a session is taken back."""

from tests.workbench.app.plants import files_of, limited, recorded, upload, written
from workbench.app.session import Session
from workbench.app.stages.diagnose import look_for
from workbench.app.state import Asked, State


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
