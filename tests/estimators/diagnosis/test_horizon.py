"""Free-running motion over seconds: errors of models, and a refit to it, on a plant that shares no model code.

A carriage under a PD controller, whose recorded force drives the simulation. Steps of 0.2 ms with dry friction by
Moreau's rule.
"""

import json
import math

import numpy as np
import pytest

from estimators import compare, diagnose
from estimators.diagnosis import horizon as refits
from estimators.simulation import output_error
from pendulum_env.physics import BASE, Model
from pendulum_env.recording import Recording, read_recording
from tests.cases import diagnosed, recording
from tools.prose import ROOT

MASS, VISCOUS, DRY = 95.0, 200.0, 20.0  # kg, N s/m, N
STRIBECK, SLOW = 3.0, 0.05  # N, m/s
RATE, INNER = 500.0, 10
EMPS = ROOT.parent / "shared" / "data" / "emps" / "emps.csv.gz"
TRUE = Model.build(BASE, [MASS, 0.0, VISCOUS, DRY])
AXIS = {"fixed": {"gravity": 0.0}, "only": ["spring"]}


def dry_friction(force: float, free: float, dry: float) -> float:
    """Velocity [m/s] after a step, by that without dry friction and the largest change that it can make."""
    return math.copysign(max(0.0, abs(free) - dry), free)


def stepped(state: tuple[float, float], force: float, stribeck: float) -> tuple[float, float]:
    """Position and velocity a sample later."""
    h, (q, v) = 1 / RATE / INNER, state
    for _ in range(INNER):
        dry = DRY + stribeck * math.exp(-((v / SLOW) ** 2))
        v = dry_friction(force, v + h * (force - VISCOUS * v) / MASS, h * dry / MASS)
        q += h * v
    return q, v


def driven(name: str, goal: np.ndarray, seed: int, stribeck: float = 0.0, encoder: float = 1e-6) -> Recording:
    """Log of the carriage as it follows a goal [m]."""
    state, log, speed = (0.0, 0.0), [], np.gradient(goal) * RATE
    for q_goal, v_goal in zip(goal.tolist(), speed.tolist(), strict=True):
        force = min(max(32_000 * (q_goal - state[0]) + 2916 * (v_goal - state[1]), -150.0), 150.0)
        log.append((state[0], force))
        state = stepped(state, force, stribeck)
    position, force = np.array(log).T
    force = force + 0.05 * np.random.default_rng(seed).standard_normal(len(force))
    return Recording(np.arange(len(goal)) / RATE, np.round(position / encoder) * encoder, force, name=name)


def moves(seconds: float, seed: int) -> np.ndarray:
    """From place to place, each within a second."""
    rng, time = np.random.default_rng(seed), np.arange(round(seconds * RATE)) / RATE
    ends, places = np.cumsum(rng.uniform(1.2, 2.2, 40)), np.append(0.0, rng.uniform(-0.2, 0.2, 41)[1:])
    k = np.searchsorted(ends, time)
    share = np.clip(time - np.append(0.0, ends)[k], 0, 1)
    share = 3 * share**2 - 2 * share**3
    return places[np.maximum(k - 1, 0)] * (1 - share) + places[k] * share


def pulses(seconds: float) -> np.ndarray:
    """A slow wave with pulses on it."""
    time = np.arange(round(seconds * RATE)) / RATE
    wave = np.sin(2 * np.pi * time / 1.7)
    return 0.05 * np.sin(2 * np.pi * time / 5) + 0.03 * np.sign(wave) * np.minimum(1, 4 * np.abs(wave))


@pytest.fixture(scope="module")
def with_stribeck() -> tuple[Recording, Recording]:
    return driven("moves", moves(16, 0), 0, STRIBECK), driven("pulses", pulses(12), 50, STRIBECK)


def test_the_usual_horizon_gives_the_usual_errors(with_stribeck):
    usual, given = compare(TRUE, with_stribeck), compare(TRUE, with_stribeck, horizon=1.0)
    assert given.json() == usual.json()


def test_errors_over_a_horizon_are_those_of_an_independent_integrator(with_stribeck):
    log = with_stribeck[1]
    found = compare(TRUE, log, horizon=8.0)
    path = found.recordings[0].simulated_position
    (run,) = np.split(np.flatnonzero(np.isfinite(path)), 1)
    state = log.position[run[0]], float(np.gradient(log.position, log.time)[run[0]])
    expected = []
    for force in log.torque[run[:-1]].tolist():
        state = stepped(state, force, 0.0)
        expected.append(state[0])
    assert len(run) == 8 * RATE + 1
    error = np.sqrt(np.mean((np.array(expected) - log.position[run[1:]]) ** 2))
    assert found.errors.position_rms == pytest.approx(error, rel=0.1)
    assert found.horizon == 8.0 and found.json()["horizon"] == 8.0


def test_an_incomplete_model_follows_held_out_motion_better_after_the_refit(with_stribeck, tmp_path):
    train, unseen = with_stribeck
    found, plain = diagnose([train], [unseen], **AXIS, horizon=10.0), diagnose([train], [unseen], **AXIS)
    refit = found.refit
    old, new = (step.errors["holdout"] for step in (refit.before, refit.after))
    assert refit.is_kept and not refit.is_interrupted
    assert new.position_rms < 0.85 * old.position_rms
    assert new.torque_rms < 1.1 * old.torque_rms
    assert [one.verdict for one in found.candidates] == [one.verdict for one in plain.candidates]
    assert refit.before.model.theta == pytest.approx(plain.model.theta)
    assert found.model.theta == pytest.approx(refit.after.model.theta)
    assert compare(found, unseen, horizon=10.0).errors.position_rms == pytest.approx(new.position_rms, rel=0.1)
    found.model.save(tmp_path / "model.json")
    assert Model.load(tmp_path / "model.json").theta == pytest.approx(found.model.theta)
    data = found.json()["horizon"]
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert [gate["passed"] for gate in data["gates"]] == [True, True]
    assert data["seconds"] == 10.0 and data["kept"] and data["after"]["errors"]["holdout"] == new.json()


@pytest.mark.slow
@pytest.mark.skipif(not EMPS.is_file(), reason="the recording of the benchmark is not on this machine")
@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0)])
def test_a_refit_that_raises_the_torque_error_of_other_motion_is_not_kept(order):
    """A third of the recording is fitted, another one decides, and the last one is unseen."""
    log = read_recording(EMPS, columns={"position": "position:m", "torque": "torque:N"})
    edges = np.linspace(0, len(log.time), 4).astype(int).tolist()
    train, decides, unseen = (log.slice(edges[k], edges[k + 1]) for k in order)
    refit = diagnose([train], [decides], fixed={"gravity": 0.0}, only=["viscous_asymmetry"], horizon=5.0).refit
    old, new = (step.errors["holdout"] for step in (refit.before, refit.after))
    assert new.position_rms < old.position_rms and not refit.is_kept
    old, new = (compare(step.model, unseen, horizon=5.0).errors for step in (refit.before, refit.after))
    assert new.torque_rms > 1.1 * old.torque_rms


def test_a_coarse_encoder_does_not_hide_dry_friction():
    train, unseen = driven("moves", moves(16, 2), 2, encoder=1e-3), driven("pulses", pulses(12), 52, encoder=1e-3)
    found = diagnose([train], [unseen], **AXIS, horizon=10.0)
    assert found.model["coulomb"].value == pytest.approx(DRY, rel=0.01)


def test_a_complete_model_is_not_refitted_and_has_the_errors_of_compare():
    found = diagnose([recording("steps")], horizon=1.0)
    known = diagnosed("steps")
    assert found.refit.after is None and not found.refit.is_kept
    assert found.refit.before.errors["holdout"].position_rms == pytest.approx(
        known.steps[-1].errors["holdout"].position_rms
    )
    assert found.model.theta == pytest.approx(known.model.theta)


def test_an_interrupted_refit_keeps_what_was_reached(with_stribeck, monkeypatch):
    calls, minimise = [], output_error.minimise

    def interrupted(*arguments):
        calls.append(minimise(*arguments))
        if len(calls) == 3:
            raise KeyboardInterrupt
        return calls[-1]

    monkeypatch.setattr(refits.output_error, "minimise", interrupted)
    refit = diagnose(*([one] for one in with_stribeck), **AXIS, horizon=10.0).refit
    assert refit.is_interrupted
    assert refit.after.model.theta == pytest.approx(calls[1].theta)


@pytest.mark.parametrize("horizon", [0.0, -1.0, math.nan, math.inf])
def test_a_horizon_is_a_length_of_time(horizon):
    with pytest.raises(ValueError, match="horizon"):
        compare(TRUE, recording("steps"), horizon=horizon)
    with pytest.raises(ValueError, match="horizon"):
        diagnose(recording("steps"), horizon=horizon)


def test_a_horizon_is_within_the_recording_and_within_what_is_held_out():
    log = recording("steps")
    with pytest.raises(ValueError, match=log.name):
        compare(TRUE, log, horizon=1.1 * log.duration)
    with pytest.raises(ValueError, match="hold other recordings out"):
        diagnose(log, horizon=0.5 * log.duration)
