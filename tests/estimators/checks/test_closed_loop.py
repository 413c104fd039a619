"""Closed loop: torque that answers the motion is told from torque that was planned."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import identify
from estimators.checks.closed_loop import Feedback, find_feedback, is_consistent
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.weak_form.floors import compute_noise_floor
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, simulate
from pendulum_env.recording import Recording, read_recording
from tests.cases import recorded

PLANNED = ("two_tone", "multisine", "prbs", "steps", "filtered_noise")


def run(excitation: str, torque_noise: float = 0.02) -> Recording:
    experiment = Experiment(500.0, 12.0, excitation, seed=2, counts=8192, torque_noise=torque_noise)
    return recorded(Plant(), experiment)[0]


def test_a_controller_is_told_with_the_gain_by_which_it_answers():
    assert len(find_feedback([run("pd_loop", 0.1)])) == 1  # noise of the torque channel does not hide it
    recording = run("pd_loop")
    (found,) = find_feedback([recording])
    # 12 N m/rad, and 1.2 N m s/rad on a velocity filtered at 30 Hz, of which a sample passes 1 - exp(-2 pi 30 / 500)
    assert found.gain.value == pytest.approx(-(12 + 1.2 * 500 * 0.314), rel=0.2)
    assert isinstance(found, Feedback) and found.recordings == ("run 1",)
    assert any(isinstance(own, Feedback) for own in identify([recording]).findings)


def test_recordings_of_one_controller_are_one_finding():
    recordings = [replace(run("pd_loop"), name="first"), replace(run("pd_loop"), name="second"), run(PLANNED[0])]
    (found,) = find_feedback(recordings)
    assert found.recordings == ("first", "second")
    assert found.gain == find_feedback(recordings[:1])[0].gain


@pytest.mark.parametrize("excitation", PLANNED)
def test_planned_torque_answers_nothing(excitation):
    assert find_feedback([run(excitation)]) == []


@pytest.mark.parametrize(("rate", "decimals", "delay"), [(200, 3, 0.1), (300, 3, 0.1), (500, 3, 0.3), (100, 2, 0.3)])
def test_rounded_stamps_of_uneven_samples_are_no_feedback(rate, decimals, delay):
    """Errors of the stamps shift torque and position of a row together, as a controller would."""
    count, steps, rng = 15 * rate, 20, np.random.default_rng(1)
    time = np.arange(count * steps) / (rate * steps)
    torque = np.repeat(excitation("multisine", 1, 15).signal(time[::steps]), steps)
    motion = simulate(BASE, np.array([0.0895, 2.01, 0.3638, 0.9163]), 1 / (rate * steps), torque, 0.0, 0.0)
    late = np.clip(np.abs(rng.normal(0.0, delay, count)), 0.0, 0.95)  # of a period
    rows = np.arange(count) * steps + (late * steps).astype(int)
    position = motion.position[rows, 0]
    log = {"time": np.round(time[rows], decimals), "position": position, "torque": torque[rows]}
    assert find_feedback([read_recording(log)]) == []


@pytest.mark.parametrize(("share", "floors", "consistent"), [(0.1, 9.0, False), (0.3, 9.0, True), (0.1, 1.0, True)])
def test_a_small_part_of_a_residual_with_structure_is_no_delay(share, floors, consistent):
    """An unknown law leaves nine noise floors: a delay that explains a tenth of their power is a part of this law."""
    (recording,) = recorded(Plant(), Experiment(rate=500.0, seconds=12.0, excitation="multisine"))
    data = RegressionData.from_recordings([recording]).data
    noise = np.random.default_rng(0).standard_normal(len(data.weights))
    inertia = fit_terms(RegressionData.from_recordings([recording]), BASE)[0].theta[0]
    residual = floors * compute_noise_floor(data.windows, inertia) * noise
    assert is_consistent([recording], data, residual, residual / np.sqrt(1 - share), 10) == consistent
