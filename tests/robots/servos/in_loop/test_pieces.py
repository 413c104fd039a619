"""Searches over long recordings take pieces of them; final fits and errors are those of whole recordings."""

import numpy as np
import pytest

from pendulum_env.recording import Recording
from robots.servos import ServoDrive
from robots.servos.in_loop.pieces import select_pieces
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.settings import LOOP

RATE = 50.0


def record(seconds, size=0.5):
    time = np.arange(int(seconds * RATE)) / RATE
    position = size * np.sin(1.3 * time)
    drive = ServoDrive(output="torque", kp=2.0, goal="held")
    return Recording(time, position, 0.1 * np.cos(time), reference=position + 0.05, drive=drive, is_checked=True)


def test_short_recordings_stay_whole():
    recordings = (record(40.0), record(20.0))
    assert select_pieces(recordings) is recordings
    assert Rollouts.from_pieces(recordings).steps == LOOP.simulation.steps


def test_pieces_of_long_recordings_are_spread_and_equally_long():
    recordings = (record(600.0), record(900.0))
    pieces = select_pieces(recordings)
    assert sum(map(len, pieces)) == pytest.approx(LOOP.search.count, rel=0.1)
    assert {len(segment) for piece in pieces for segment in piece.segments} == {round(LOOP.search.piece * RATE)}
    for piece, whole in zip(pieces, recordings, strict=True):
        gaps = np.diff([segment.time[0] for segment in piece.segments])
        assert np.ptp(gaps) < 0.1 and piece.time[0] > whole.time[0] and piece.time[-1] < whole.time[-1]
        np.testing.assert_array_equal(piece.position, np.interp(piece.time, whole.time, whole.position))


def test_final_fits_have_the_whole_recordings():
    recordings = (record(600.0),)
    rollouts = Rollouts.from_pieces(recordings)
    assert len(rollouts.recordings[0]) < len(recordings[0])
    assert rollouts.fine.recordings == recordings and rollouts.fine.steps == LOOP.search.fine_steps
    assert Rollouts.from_pieces((record(40.0),)).fine.steps == LOOP.simulation.fine_steps


def test_recordings_at_rest_do_not_hide_the_error_of_others():
    moving, resting = record(20.0), record(20.0, size=0.0)
    alone, both = (Rollouts(own).positions for own in ((moving,), (moving, resting)))
    error = 1e-3 * np.random.default_rng(0).normal(size=len(alone.measured))
    exact = np.zeros(len(both.measured) - len(error))
    structure = both.measure_structure(np.r_[error, exact])
    assert structure.rms == pytest.approx(alone.measure_structure(error).rms) == pytest.approx(1e-3, rel=0.1)
