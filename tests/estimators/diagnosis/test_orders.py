"""Cogging of several orders, as motors without gears have it, from a rotor of its own integrator."""

from math import cos, sin

import numpy as np
import pytest

from estimators import diagnose
from estimators.search_hints import is_possible
from pendulum_env.physics import Samples
from pendulum_env.physics.potential import Cogging
from pendulum_env.recording import Recording
from tests import slow
from tests.runge_kutta import step_runge_kutta

INERTIA, VISCOUS, NOISE = 2e-4, 4e-4, 5e-4  # of a motor of the size of a palm, in SI units
RATE, SECONDS, STEPS = 500.0, 12.0, 10


def turned(cogging: dict[int, tuple[float, float]], seed: int) -> Recording:
    """A rotor that a multisine turns round and round, with sine and cosine of torque by order [N m]."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(RATE * SECONDS)) / RATE
    tones = np.arange(1, 25) / SECONDS
    phases = rng.uniform(0, 2 * np.pi, len(tones))
    wave = np.sin(2 * np.pi * np.outer(time, tones) + phases).sum(axis=1)
    torque = 0.05 * wave / np.abs(wave).max()

    path, step, x = np.empty(len(time)), 1 / RATE / STEPS, [0.0, 0.0]
    for k, held in enumerate(torque.tolist()):
        path[k] = x[0]

        def rate(t: float, q: float, v: float, held: float = held) -> tuple[float, float]:
            cogs = sum(s * sin(n * q) + c * cos(n * q) for n, (s, c) in cogging.items())
            return v, (held - VISCOUS * v - cogs) / INERTIA

        for _ in range(STEPS):
            x = step_runge_kutta(rate, 0.0, x, step)
    return Recording(time, path, torque + NOISE * rng.standard_normal(len(time)), name=f"rotor {seed}")


ONE = {7: (0.012, -0.004)}
SEVERAL = ONE | {28: (0.005, 0.003)}


@pytest.mark.parametrize("cogging", slow.but([SEVERAL], [ONE, SEVERAL]), ids=["one order", "two orders"])
def test_every_order_of_a_motors_cogging_is_found_and_no_other(cogging):
    some = ("cogging", "torque_ripple", "position_dependent_friction", "stribeck")
    found = diagnose([turned(cogging, 1)], [turned(cogging, 2)], only=some)
    assert found.selected == ("cogging",)
    term = next(term for term in found.model.terms if term.id == "cogging")
    assert sorted(n for n in term.nonlinear_values.values() if n) == sorted(cogging)
    ends = {term.nonlinear_values[name]: name.removeprefix("order") for name in term.nonlinear_values}
    for n, both in cogging.items():
        for part, value in zip(("sin", "cos"), both, strict=True):
            estimate = found.model.estimates[f"cogging.{part}{ends[n]}"]
            assert estimate.value == pytest.approx(value, abs=4 * estimate.std + 1e-4)


def test_further_orders_are_of_waves_that_come_again():
    some = np.linspace(0.0, 1.0, 50)
    for turns, comes_again in ((0.4, False), (0.5, True)):
        x = Samples(some, 2 * np.pi * turns * some, 0 * some, 0 * some)
        assert is_possible(Cogging(7.0), x)
        assert is_possible(Cogging(7.0, 28.0), x) == comes_again
    assert Cogging(7.0, 7.0).fault and not Cogging(7.0, 28.0).fault
