"""Closed loop: torque that answers the motion is told from torque that was planned."""

from functools import cache

import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import identify
from estimators.checks.closed_loop import feedback
from pendulum_env.recording import Recording

PLANNED = ("two_tone", "multisine", "prbs", "steps", "filtered_noise")
NOISE = {"pd_loop": 0.02, "noisy pd_loop": 0.1} | dict.fromkeys(PLANNED, 0.02)  # of the torque [N m]


@cache
def recordings() -> dict[str, Recording]:
    """All at once, as a simulation of many takes little longer than one."""
    of_all = {"rate": 500.0, "seconds": 12.0, "seed": 2, "counts": 8192}
    experiments = [
        Experiment(excitation=name.split()[-1], torque_noise=noise, **of_all) for name, noise in NOISE.items()
    ]  # type: ignore[arg-type]
    runs = simulate([(Plant(), experiment) for experiment in experiments])
    return {name: Recording(name, r.time, r.position, r.torque) for name, r in zip(NOISE, runs, strict=True)}


def test_a_controller_is_told_with_the_gain_by_which_it_answers():
    recording = recordings()["pd_loop"]
    (found,) = feedback([recording])
    # 12 N m/rad, and 1.2 N m s/rad on a velocity filtered at 30 Hz, of which a sample passes 1 - exp(-2 pi 30 / 500)
    assert found.gain == pytest.approx(-(12 + 1.2 * 500 * 0.314), rel=0.2)
    assert "pd_loop: torque answers the motion" in found.text
    assert any("answers the motion" in doubt.text for doubt in identify([recording]).doubts)


@pytest.mark.parametrize("excitation", PLANNED)
def test_planned_torque_answers_nothing(excitation):
    assert feedback([recordings()[excitation]]) == []


def test_noise_of_the_torque_channel_does_not_hide_a_controller():
    assert len(feedback([recordings()["noisy pd_loop"]])) == 1
