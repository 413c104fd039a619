"""Every change of a session is taken back."""

from tests.workbench.app.plants import record_pendulum, upload, write_source
from workbench.app.session import Session
from workbench.app.stages.diagnose import choose_search
from workbench.app.state import SearchChoices, State


def test_every_change_is_taken_back_in_turn(tmp_path):
    session = Session(tmp_path / "session")
    sources = [write_source(record_pendulum(name, seed, 4.0), tmp_path) for name, seed in (("swing", 1), ("check", 2))]
    known: list[tuple[State, str]] = []
    for do, what in (
        (lambda: session.load(sources), "load swing, check"),
        (lambda: session.hold_out("check.csv", True), "fit or check"),
        (lambda: choose_search(session, SearchChoices(fix="gravity=2")), "choose what is looked for"),
        (lambda: session.remove("check.csv"), "remove check"),
    ):
        known.append((session.state, what))
        session.run_action(do)
        assert session.notice == "" and session.last_change == what
        session.run_action(lambda: choose_search(session, session.state.choices))
        assert session.last_change == what  # what changes nothing is no change
    for before, what in reversed(known):
        assert session.last_change == what
        after = session.state
        session.run_action(session.undo)
        assert session.state is before and session.undone[-1] == (what, after)
        session.run_action(lambda: session.undo(is_redo=True))
        assert session.state is after and session.last_change == what
        session.run_action(session.undo)
    session.run_action(session.undo)
    assert session.notice == "there is nothing to undo" and session.last_change == ""
    session.run_action(lambda: session.undo(is_redo=True))
    session.run_action(lambda: session.remove("swing.csv"))  # another change takes the place of those undone
    session.run_action(lambda: session.undo(is_redo=True))
    assert session.notice == "there is nothing to redo" and session.undone == []


def test_a_recording_that_was_removed_comes_back_though_another_took_its_name(tmp_path):
    session = Session(tmp_path / "session")
    contents = [write_source(record_pendulum("swing", seed, 4.0), tmp_path).file.read_bytes() for seed in (1, 2)]
    for content in contents:
        upload(session, "swing.csv", content)
        session.run_action(lambda: session.remove("swing.csv"))
        assert session.notice == ""
    upload(session, "swing.csv", b"time,position,torque\n0,0,0\n0.001,nan,0\n")  # which changes nothing
    assert session.notice.startswith("swing.csv: ")
    for content in contents[::-1]:
        session.run_action(session.undo)
        (one,) = session.state.loaded
        assert one.source.file.read_bytes() == content
        assert session.last_change == "load swing"
        session.run_action(session.undo)
    assert session.state.loaded == () and session.last_change == ""
