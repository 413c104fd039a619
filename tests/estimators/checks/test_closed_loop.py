"""Closed loop: torque that answers the motion is told from torque that was planned."""

from dataclasses import replace

import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import identify
from estimators.checks.closed_loop import find_feedback
from estimators.findings import Kind
from pendulum_env.recording import Recording
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
    assert found.numbers["gain"].value == pytest.approx(-(12 + 1.2 * 500 * 0.314), rel=0.2)
    assert found.kind is Kind.FEEDBACK and found.recordings == ("run 1",)
    assert any(own.kind is Kind.FEEDBACK for own in identify([recording]).findings)


def test_recordings_of_one_controller_are_one_finding():
    recordings = [replace(run("pd_loop"), name="first"), replace(run("pd_loop"), name="second"), run(PLANNED[0])]
    (found,) = find_feedback(recordings)
    assert found.recordings == ("first", "second")
    assert found.numbers == find_feedback(recordings[:1])[0].numbers


@pytest.mark.parametrize("excitation", PLANNED)
def test_planned_torque_answers_nothing(excitation):
    assert find_feedback([run(excitation)]) == []
