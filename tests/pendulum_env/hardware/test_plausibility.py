"""What no arm can have done is seen soon, and what arms do is not, in samples of a simulation that knows no watch."""

import functools
import math

import numpy as np
import pytest

from pendulum_env.backends.hardware.config import PlantRanges
from pendulum_env.backends.hardware.plausibility import PlausibilityCheck
from pendulum_env.excitation import EXCITATIONS, excitation
from pendulum_env.physics.simulation import simulate
from pendulum_env.plant import hide, paper_plant

STEP = 2 * math.pi / 1_024_000  # [rad]
NOISE = {500.0: 5e-5, 250.0: 5e-5, 100.0: 3e-4}  # [s] of a reading's time, by rate [Hz]
SOON = 0.3  # [s]
NAMES = tuple(EXCITATIONS)
AMPLITUDES = {500.0: (2.0, 3.5, 6.0), 250.0: (2.0, 3.5, 6.0), 100.0: (3.5, 6.0)}  # [N m]; the slowest sees less
ROUGH = PlantRanges()  # what is known without a word
MISREADINGS = {  # angle that an encoder tells, from that since a moment [rad] and the time since then [s]
    "frozen": lambda moved, passed: 0.0,
    "inverted": lambda moved, passed: -moved,
    "jump": lambda moved, passed: moved + 0.5,
    "drift": lambda moved, passed: moved + 3.0 * passed,
}
SECONDS, BEGIN = 4.0, 1.0  # [s] of a run, and until something goes wrong
rates = pytest.mark.parametrize("rate", NOISE)


def stopped(position, command, rate, plant=ROUGH, noise=None, took=lambda k: 0.0):
    """Time after which the watch had something to say [s]; inf if it never had."""
    watch = PlausibilityCheck(plant, STEP, NOISE[rate] if noise is None else noise)
    position = [float(q) for q in position]
    watch.check_measurement(0.0, position[0])
    for k, torque in enumerate(command.tolist()):
        watch.add_command(torque)
        if watch.check_measurement((k + 1) / rate, position[k + 1], took(k)):
            return (k + 1) / rate
    return math.inf


@functools.cache
def runs(rate, gain=1.0, names=NAMES, amplitudes=None, spread=0.0, effect=None):
    """Of every excitation at every amplitude: commands and velocities (B, N + 1), and positions as they are read.

    The drive gives `gain` times the torque from `BEGIN` on.
    """
    rng = np.random.default_rng(3)
    steps = round(SECONDS * rate)
    time = np.arange(steps) / rate
    command = np.stack(
        [
            excitation(name, rng, SECONDS, amplitude).signal(time)
            for name in names
            for amplitude in amplitudes or AMPLITUDES[rate]
        ],
        axis=1,
    )
    plant = paper_plant() if effect is None else hide(paper_plant(), effect)
    batch = command.shape[1]
    theta = plant.theta[:, None] * rng.uniform(1 - spread, 1 + spread, (len(plant.theta), batch))
    acting = command * np.where(time < BEGIN, 1.0, gain)[:, None]
    way = simulate(plant.terms, theta, 1.0 / rate, acting, rng.uniform(-0.2, 0.2, batch), 0.0)
    read = way.position + way.velocity * rng.normal(0.0, NOISE[rate], way.position.shape)
    return list(zip(command.T, np.round(read / STEP).T * STEP, way.velocity.T, strict=True))


def turning(velocity, rate):
    """First sample after `BEGIN` at which the arm turns quickly, for that torque."""
    after = np.abs(velocity[round(BEGIN * rate) :])
    return round(BEGIN * rate) + int(np.argmax(after > 0.6 * after.max()))


@rates
def test_sound_runs_of_arms_that_are_roughly_known_are_let_pass(rate):
    """At 0.5 and 1.2 N m they stick most of the time; `benchmarks.rig_faults` goes on for a million samples."""
    for command, position, _ in runs(rate, amplitudes=(0.5, 1.2, 3.5, 6.0), spread=0.25):
        assert stopped(position, command, rate) == math.inf


@pytest.mark.parametrize("effect", ["stribeck", "coulomb_asymmetry", "quadratic_drag", "cogging", "dead_time=0.005"])
def test_small_effects_that_nobody_knows_of_are_let_pass(effect):
    for command, position, _ in runs(250.0, names=("steps", "paper"), amplitudes=(5.0,), effect=effect):
        assert stopped(position, command, 250.0) == math.inf


@pytest.mark.parametrize(
    ("how", "rate"),
    [*((how, rate) for how in ("frozen", "inverted", "jump") for rate in NOISE), ("drift", 500.0), ("drift", 250.0)],
)
def test_an_encoder_that_tells_something_else_is_seen_soon(how, rate):
    """From the moment at which it does, while the arm turns."""
    for command, position, velocity in runs(rate):
        start = turning(velocity, rate)
        moved = [(q - position[start], k / rate) for k, q in enumerate(position[start:])]
        told = [MISREADINGS[how](*row) + position[start] for row in moved]
        at = stopped([*position[:start], *told], command, rate)
        assert start / rate <= at < start / rate + SOON


def test_half_the_counts_are_seen_when_they_begin_in_fast_motion():
    """From rest on, they are those of an arm of twice the inertia, which shows with a smaller `share`."""
    for command, position, velocity in runs(500.0, names=("prbs", "paper"), amplitudes=(6.0,)):
        start = turning(velocity, 500.0)
        told = position[start] + 0.5 * (position[start:] - position[start])
        assert start / 500 <= stopped([*position[:start], *told], command, 500.0) < start / 500 + SOON
        assert stopped(0.5 * position, command, 500.0, PlantRanges(share=0.1)) < 1.0


@pytest.mark.parametrize(
    ("gain", "rate"), [(3.0, 500.0), (3.0, 250.0), *((-1.0, rate) for rate in NOISE)]
)  # at 100 Hz, three times the torque takes longer to show
def test_a_drive_that_gives_another_torque_is_seen_soon(gain, rate):
    """From the first command after it that is to move the arm."""
    for command, position, _ in runs(rate, gain):
        after = np.abs(command[round(BEGIN * rate) :])
        strong = BEGIN + int(np.argmax(after > 0.8 * after.max())) / rate
        assert BEGIN <= stopped(position, command, rate) < strong + SOON


def test_half_a_newton_metre_does_not_hide_an_encoder_that_runs_away():
    ((command, position, _),) = runs(500.0, names=("paper",), amplitudes=(0.5,))
    assert np.ptp(position) < 0.1  # friction holds the arm
    for speed in (1.0, -3.0):
        told = position + speed * np.maximum(0.0, np.arange(len(position)) / 500.0 - 1.0)
        assert 1.0 <= stopped(told, command, 500.0) < 1.0 + SOON


def test_counts_that_stand_still_are_those_of_an_arm_that_sticks_until_friction_cannot_hold_it():
    ramp = np.arange(3000) / 1000.0  # [N m] over as many samples of 1 ms
    torque = stopped(np.zeros(3001), ramp, 1000.0, PlantRanges(coulomb=1.0, share=0.5, slack=0.3), noise=0.0)  # 1 N m/s
    assert 1.5 + 0.3 < torque * 1.15 < 2.6  # with the gain that is allowed, and as much as spans and delay take


def test_a_reading_that_took_long_is_believed_less():
    """Its time is known no better: what no motion could be, read at once, may be one that was read late."""
    ((command, position, velocity),) = runs(500.0, names=("paper",), amplitudes=(6.0,))
    late = slice(turning(velocity, 500.0) + 1, turning(velocity, 500.0) + 4)
    told = position.copy()
    told[late] += 4e-3 * velocity[late]
    for took, fine in ((0.0, False), (10e-3, True)):
        at = stopped(told, command, 500.0, took=lambda k, took=took: took * (late.start <= k + 1 < late.stop))
        assert (at == math.inf) is fine
