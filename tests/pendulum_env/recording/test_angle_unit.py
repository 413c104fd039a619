"""The unit of an angle follows from gravity, also where noise hides the acceleration or the motion is short."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from pendulum_env.recording.angle_unit import AccelerationFits, suspect_radians, suspect_unit

UNITS = {"rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi}  # [rad]
COARSE = {"counts": 4096, "torque_noise": 0.01}
MOTIONS = {
    "wide": Experiment(rate=200.0, seconds=12.0, excitation="chirp", scale=1.3),
    "slow under a controller": Experiment(rate=500.0, seconds=20.0, excitation="triangle", scale=0.6, **COARSE),
    "steps": Experiment(rate=1000.0, seconds=10.0, excitation="steps", **COARSE),
    "two tones": Experiment(rate=100.0, seconds=15.0, excitation="two_tone", **COARSE),
}


@pytest.fixture(scope="module", params=MOTIONS)
def run(request):
    (found,) = simulate([(Plant(), MOTIONS[request.param])])
    return found


@pytest.mark.parametrize("unit", UNITS)
def test_the_unit_follows_from_gravity(run, unit):
    rate, angle = run.experiment.rate, run.position / UNITS[unit]
    suspicion = suspect_unit(angle, run.torque, rate)
    assert (suspicion.unit if suspicion else "rad") == unit
    if unit != "rad" and np.ptp(run.position) > np.pi:  # in a small swing a spring explains as much
        assert suspect_radians(run.position * UNITS[unit], run.torque, rate, 1 / UNITS[unit]) is not None


def test_a_wheel_has_no_unit():
    for run in simulate([(Plant(gravity=0.0), experiment) for experiment in MOTIONS.values()]):
        for factor in UNITS.values():
            assert suspect_unit(run.position / factor, run.torque, run.experiment.rate) is None


def test_gravity_with_cogging_is_not_gravity_over_turns():
    plant = Plant(effects={"cogging": {"cog_n": 6.0, "cog_s": 3.6, "cog_c": 1.6}})
    motions = [Experiment(rate=200.0, seconds=12.0, excitation=signal) for signal in ("chirp", "multisine", "two_tone")]
    for run in simulate([(plant, motion) for motion in motions]):
        assert suspect_unit(run.position, run.torque, run.experiment.rate) is None


def test_the_torque_is_averaged_as_the_acceleration():
    """A rotor under held torque, without friction, has no misfit at any rate beside the noise of its encoder."""
    rate, rng = 1000.0, np.random.default_rng(0)
    torque = np.cumsum(rng.normal(size=8000)) * 0.3
    torque -= np.convolve(np.pad(torque, 500, "edge"), np.ones(1001) / 1001, "valid")
    speed = np.r_[0.0, np.cumsum(torque) / rate]
    position = np.r_[0.0, np.cumsum(speed[:-1] + 0.5 * torque / rate) / rate][:-1]
    for half in (4, 10, 20):
        fits = AccelerationFits.from_motion(position, torque, rate, half)
        assert fits.compute_misfit() < 2e-3 * np.std(fits.acceleration)
