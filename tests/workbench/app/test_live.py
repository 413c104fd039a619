"""Runs in real time, short ones."""

from pathlib import Path
from threading import Event
from time import monotonic

import numpy as np
import pytest

from pendulum_env.recording import write_recording
from tests.workbench.app.plants import recorded
from workbench.app.live import Run, Setup

PATIENCE = 30.0  # [s]


def finish(run: Run) -> None:
    until = monotonic() + PATIENCE
    while run.look().running:
        assert monotonic() < until
        Event().wait(0.05)


def test_a_replay_plays_the_recording_and_knows_no_truth(tmp_path: Path) -> None:
    original = recorded("swing", 1, seconds=2.0)
    write_recording(original, tmp_path / "swing.csv")
    run = Run(Setup("replay", "paper", None, (), 60.0, 0, tmp_path / "swing.csv"))
    run.start()
    finish(run)
    look = run.look()
    assert look.trouble == "" and look.truth == {} and look.identification is not None
    again = run.recording("again")
    np.testing.assert_array_equal(again.position, original.position[:-1])
    np.testing.assert_array_equal(again.torque, original.torque[:-1])
    assert len(look.motion) <= 51 and look.motion[-1, 0] == pytest.approx(again.time[-1])


def test_a_stopped_run_is_over_and_keeps_what_it_measured() -> None:
    run = Run(Setup("pymunk", "steps", 4.0, ("stribeck=0.4",), 60.0, 1))
    run.start()
    until = monotonic() + PATIENCE
    while run.look().time < 0.5:
        assert monotonic() < until
        Event().wait(0.02)
    run.stop()
    look = run.look()
    assert not look.running and look.trouble == ""
    assert {"inertia", "stribeck"} <= set(look.truth)
    recording = run.recording("stopped")
    assert recording.rate == pytest.approx(run.rate) and np.abs(recording.torque).max() < 4.5
    run.stop()  # twice does no harm


def test_a_run_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown excitation"):
        Run(Setup("pymunk", "noise", None, (), 10.0, 0))
    with pytest.raises(ValueError, match="unknown backend"):
        Run(Setup("rig", "paper", None, (), 10.0, 0))
    with pytest.raises(ValueError, match="unknown effect"):
        Run(Setup("pymunk", "paper", None, ("glue",), 10.0, 0))
