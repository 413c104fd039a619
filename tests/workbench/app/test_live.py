"""Runs in real time, short ones."""

import signal
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.signals.measurements import Smoothing
from pendulum_env.backends.hardware.drive import need
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.words import name
from tests import slow
from tests.patience import PATIENCE, wait_until
from tests.pendulum_env.rigs import Disturbed, EmulatedRig, Host
from tests.workbench.app.plants import limited, live_form, recorded, written
from workbench.app import live
from workbench.app.live import Follower, Run
from workbench.app.session import Session, Sessions
from workbench.app.stages.live import RATE, course, options, told
from workbench.mistakes import InputError
from workbench.processes import Worker

LIMITS = {"torque": 4.0, "reply": 1.0, "gap": 2.0, "watchdog": 3.0}  # [N m], [s]; a busy machine is no fault here
SERVER = """
import sys, time
from workbench.app.live import Follower, Run
from workbench.processes import Worker
run = Run(["--backend=dm1015b", f"--config={sys.argv[1]}", "--seconds=60"], Worker("rig"))
while run.time < 0.3:
    time.sleep(0.02)
print("running", flush=True)
while True:
    run.watch()
    time.sleep(0.1)
"""
ID, OTHER = "0" * 32, "1" * 32


def begun(*options: str) -> Run:
    return Run([*options, "--rate=500"], Worker("live view"))


def watched(run: Run) -> Run:
    """The run, of which a page has just asked."""
    run.watch()
    return run


def finish(run: Run) -> None:
    wait_until(lambda: not watched(run).running)


def test_a_replay_plays_the_recording_and_knows_no_truth(tmp_path):
    original = recorded("swing", 1, seconds=2.0)
    run = begun("--backend=replay", f"--replay={written(original, tmp_path).file}", "--seconds=60")
    finish(run)
    assert run.trouble == "" and run.begun.truth == {} and run.identification is not None
    again = run.recording("again")
    np.testing.assert_array_equal(again.position, original.position[:-1])
    np.testing.assert_array_equal(again.torque, original.torque[:-1])
    assert len(run.motion) <= 51 and run.motion[-1, 0] == pytest.approx(again.time[-1])


def test_a_stopped_run_is_over_and_keeps_what_it_measured():
    run = begun("--excitation=steps", "--amplitude=4", "--effect=stribeck=0.4", "--seconds=60")
    wait_until(lambda: watched(run).time >= 0.5)
    run.stop()
    assert not run.running and run.trouble == ""
    assert {"inertia", "stribeck"} <= set(run.begun.truth)
    recording = run.recording("stopped")
    assert recording.rate == pytest.approx(run.begun.rate) and np.abs(recording.torque).max() < 4.5
    run.stop()  # twice does no harm


def test_a_run_that_cannot_be_is_refused_in_the_words_of_the_command_line():
    with pytest.raises(InputError, match="unknown excitation 'noise'"):
        begun("--excitation=noise")


@pytest.mark.slow
def test_a_policy_drives_and_keeps_to_its_constraint():
    run = begun("--backend=pymunk", "--excitation=rl", "--policy=peak", "--seconds=2")
    finish(run)
    assert run.trouble == ""
    torque = run.recording("learnt").torque
    assert np.abs(torque).max() == pytest.approx(6.0, abs=0.2) and np.std(torque) > 3.0


# ------------------------------------------------------------------------------------------------ the rig


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[EmulatedRig]:
    try:
        need("serial")
    except ModuleNotFoundError as error:
        pytest.skip(str(error))
    emulated = EmulatedRig(tmp_path, "serial", limits=LIMITS)
    yield emulated
    emulated.close()


def driving(session: Session, torque: str = "paper") -> Run:
    """A run of the session that moves its motor."""
    session.run = run = begun(
        *options(session, live_form("dm1015b", excitation=torque, seconds=60.0, effect="stribeck"))
    )
    wait_until(lambda: watched(run).time > 0.3 or not run.running)
    if not run.running:
        raise Disturbed(run.trouble)
    return run


def is_off(rig: EmulatedRig) -> bool:
    """Whether the motor had torque, and now has neither torque nor power."""
    events = rig.events()
    torque, power = ([value for _, event, value in events if event == what] for what in ("torque", "power"))
    return any(torque) and torque[-1] == 0 and power[-1] == 0


@pytest.fixture
def sessions(rig: EmulatedRig) -> Iterator[Sessions]:
    sessions = Sessions(rig=rig.config)
    yield sessions
    sessions.close()


@pytest.mark.realtime
@pytest.mark.parametrize("torque", slow.but_first(["paper", "rl-peak"]))
def test_the_rig_runs_and_has_no_torque_once_it_is_stopped_whatever_else_is_done(rig, sessions, torque):
    session = sessions.of(ID)
    run = driving(session, torque)
    wait_until(lambda: watched(run).time > 1.0)  # by then either has asked for more than is allowed
    assert run.begun.remark == "torque is cut at 4 N m (limits.torque), 6 were asked for"
    assert run.begun.truth == {} and not is_off(rig)

    class Work:
        running = True

        def cancel(self) -> None: ...

    session.job = Work()  # type: ignore[assignment]
    session.halt()
    assert not run.running and run.trouble == "" and is_off(rig)
    measured = run.recording("rig").torque
    assert len(measured) > 0.2 * run.begun.rate and 3.0 < np.abs(measured).max() < 4.1


@pytest.mark.realtime
@pytest.mark.slow
def test_the_rig_stops_at_once_even_while_what_it_measured_is_looked_at(rig, sessions):
    session, looking, looked = sessions.of(ID), Event(), Event()
    run = driving(session)

    def long(rows: object) -> None:
        looking.set()
        looked.wait()

    run.follower.take = long  # type: ignore[method-assign]
    Thread(target=run.follow, daemon=True).start()
    assert looking.wait(PATIENCE)
    stopping = Thread(target=session.halt)
    stopping.start()
    try:
        wait_until(lambda: is_off(rig))
        assert not any(event == "expired" for _, event, _ in rig.events())  # it did not come to the watchdog
    finally:
        looked.set()
        stopping.join()
    assert not run.running
    assert run.trouble == ""  # what was measured until then has come through


@pytest.mark.realtime
@pytest.mark.slow
def test_the_rig_has_no_torque_after_its_session_and_then_belongs_to_another(rig, sessions, monkeypatch):
    limited(monkeypatch, sessions=1)
    first = sessions.of(ID)
    driving(first)
    second = sessions.of(OTHER)
    assert is_off(rig)
    first.act(lambda: pytest.fail("it has ended"))
    assert "load the page again" in first.notice
    driving(second)
    assert not is_off(rig)
    sessions.close()
    assert is_off(rig)


@pytest.mark.realtime
@pytest.mark.slow
def test_the_rig_has_no_torque_when_nobody_watches(rig, sessions, monkeypatch):
    monkeypatch.setattr(live, "UNSEEN_RIG", 1.5)
    run = driving(sessions.of(ID))
    wait_until(lambda: not run.running)
    assert is_off(rig) and run.time < 50.0


@pytest.mark.realtime
@pytest.mark.slow
def test_a_fault_of_the_rig_ends_the_run_and_is_told(rig, sessions):
    run = driving(sessions.of(ID))
    rig.signal(signal.SIGSTOP)  # it does not answer any more
    finish(run)
    assert run.trouble != ""
    assert np.isfinite(run.recording("rig").position).all() and (np.diff(run.recording("rig").time) > 0).all()


@pytest.mark.realtime
@pytest.mark.slow
def test_the_rig_has_no_torque_once_the_server_is_killed(rig):
    host = Host(SERVER, rig.config)
    try:
        host.heard("running")
        assert not is_off(rig)
        host.process.kill()
        wait_until(lambda: is_off(rig))
        assert not any(event == "expired" for _, event, _ in rig.events())  # it need not come to the watchdog
    finally:
        host.close()


# ------------------------------------------------------------------------------------------------ what is missing


def follower_of(seconds: float) -> Follower:
    """What follows a run of a pendulum with an offset of its torque, as fast as this computer can."""
    follower = Follower(RATE, Smoothing.of_encoder(COUNTS, RATE))
    hidden = Plant(effects={"torque_offset": {"offset": 0.4}})
    (seen,) = simulate([(hidden, Experiment(rate=RATE, seconds=seconds, torque_noise=0.05, seed=7))])
    follower.take(list(zip(seen.time, seen.position, seen.torque, strict=True)))
    return follower


def test_what_is_missing_is_alarmed_about_added_and_taken_out():
    with pytest.raises(ValueError, match="has not been tried yet"):
        follower_of(0.1).add("torque_offset")
    follower = follower_of(8.0)
    said = follower.said
    assert said.kind == "missing" and "torque_offset" in said.group
    assert follower.events[0].alarm and follower.course[-1][1] > said.threshold
    figure = course(follower, 8.0)
    low, high = figure.layout["yaxis"]["range"]
    assert all(low <= value <= high for value in figure.data[0]["y"]) and len(follower.course) >= 3
    assert figure.layout["annotations"][0]["text"].startswith("missing: ")
    with pytest.raises(ValueError, match="effect that is run"):
        follower.add("<script>")
    leader, other = said.group[0], next(one.effect for one in said.ranking if one.effect != said.group[0])
    assert told(said, True)[2:4] == (f"Add {name(leader)}", leader)
    follower.add(other)  # what the page has shown before another led
    assert follower.said.added == (other,)
    verdict, _, _, _, no_add, no_undo = told(follower.said, True)
    assert "base + " in verdict and no_add and not no_undo
    follower.undo()
    assert follower.said.added == ()
    assert [event.text.partition(":")[0] for event in follower.events] == ["missing", "added", "taken out"]
    with pytest.raises(ValueError, match="no effect was added"):
        follower.undo()
