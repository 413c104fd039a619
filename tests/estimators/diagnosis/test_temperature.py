"""Friction that changes with the measured temperature of a pendulum, from an integrator of its own."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators import IdentificationError, add, compare, diagnose
from estimators.signals.motion import get_temperature
from pendulum_env.physics import BASE, Model
from pendulum_env.physics.friction import TemperatureDependentFriction
from pendulum_env.physics.time_varying import FrictionDrift
from pendulum_env.plant import paper_plant
from pendulum_env.recording import Recording, read_recording, write_recording

INERTIA, GRAVITY, VISCOUS, COULOMB = 0.02, 0.8, 0.06, 0.08
THINNER, ROUGHER = -0.02, 0.006  # shares of viscous and Coulomb friction by which they change [1/K]
RATE, SECONDS, STEPS = 500.0, 24.0, 16


def warmed(seed: int, is_hidden: bool = True) -> Recording:
    """A pendulum that warms up and cools down twice while it moves; the thermometer shows whole kelvins."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(RATE * SECONDS)) / RATE
    sizes, rates, phases = (rng.uniform(*own, 4) for own in ((0.5, 1.2), (1.0, 12.0), (0.0, 6.0)))
    torque = np.sin(np.outer(time, rates) + phases) @ sizes
    temperature = 25.0 + 20.0 * np.sin(2 * np.pi * time / SECONDS) ** 2
    step, q, v, path = 1 / RATE / STEPS, 0.0, 0.0, []
    for held, warmer in zip(torque.tolist(), (is_hidden * (temperature - 25.0)).tolist(), strict=True):
        path.append(q)
        viscous, dry = VISCOUS * (1 + THINNER * warmer), COULOMB * (1 + ROUGHER * warmer)
        for _ in range(STEPS):
            free = v + step * (held - GRAVITY * math.sin(q) - viscous * v) / INERTIA
            after = math.copysign(max(abs(free) - step * dry / INERTIA, 0.0), free)
            q, v = q + 0.5 * step * (v + after), after
    noisy = torque + 0.01 * rng.standard_normal(len(time))
    position = np.array(path) + 1e-5 * rng.standard_normal(len(time))
    return Recording(time, position, noisy, temperature=np.round(temperature), name=f"run {seed}")


ASKED = {kind.id: kind for kind in (TemperatureDependentFriction, FrictionDrift)}


def test_friction_by_temperature_is_named_and_told_per_kelvin(tmp_path):
    known, unseen = warmed(1), warmed(2)
    found = diagnose([known], [unseen], library=ASKED)
    assert found.selected == ("temperature_dependent_friction",) and not found.unexplained
    for part, share in (("viscous", THINNER), ("coulomb", ROUGHER)):
        own = found.model.derived[f"temperature_dependent_friction.{part}_share"]
        assert own.unit == "%/K"
        assert own.value == pytest.approx(100 * share, abs=4 * own.std + 0.02)
    before, after = found.steps[0].errors["holdout"], found.steps[-1].errors["holdout"]
    assert after.torque_rms < 0.3 * before.torque_rms and after.position_rms < 0.1 * before.position_rms
    write_recording(unseen, tmp_path / "unseen.csv")
    errors = compare(found.model, [read_recording(tmp_path / "unseen.csv")]).joint.errors
    assert errors.position_rms == pytest.approx(after.position_rms, rel=0.1)


def test_temperature_that_does_nothing_or_was_not_measured_is_not_named():
    assert diagnose([warmed(3, False)], [warmed(4, False)], library=ASKED).selected == ()
    unmeasured = [replace(warmed(seed), temperature=None) for seed in (1, 2)]
    assert "temperature_dependent_friction" not in diagnose(unmeasured[:1], unmeasured[1:], library=ASKED).selected
    warm = Model.build((*BASE, TemperatureDependentFriction()), [INERTIA, GRAVITY, VISCOUS, COULOMB, 0.0, 0.0])
    for call in (
        lambda: diagnose(unmeasured, only=["temperature_dependent_friction"]),
        lambda: add(paper_plant(), "temperature_dependent_friction", unmeasured),
        lambda: compare(warm, unmeasured),
    ):
        with pytest.raises(IdentificationError, match="needs the joint's temperature, which no recording has"):
            call()
    steady = [replace(run, temperature=np.full(len(run.time), 25.0)) for run in unmeasured]
    with pytest.raises(IdentificationError, match="run 1, run 2: nothing there shows temperature_dependent_"):
        add(paper_plant(), "temperature_dependent_friction", steady)


def test_a_thermometer_that_shows_whole_kelvins_is_read_between_them():
    time = np.arange(30_000) / 500.0
    for exact in (22.0 + 0.3 * time, 30.0 + 5.0 * np.cos(0.1 * time)):
        run = Recording(time, np.zeros(len(time)), np.zeros(len(time)), temperature=np.round(exact), name="warm")
        error = np.std(get_temperature(run) - exact)
        assert error < 0.5 * np.std(run.temperature - exact)
        assert get_temperature(replace(run, temperature=exact)) == pytest.approx(exact, abs=1e-2)
