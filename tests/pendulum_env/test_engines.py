"""Engines: each moves by every effect as the model does; of MuJoCo, friction is regularised, and that is all."""

import sys
from functools import partial
from importlib.util import find_spec

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.backends import BACKENDS, Sensor, Setup, Simulator, Start
from pendulum_env.backends.rigid_body import RigidBody, make_body
from pendulum_env.backends.simulator import SteppedBody
from pendulum_env.excitation import excitation
from pendulum_env.physics import Model, effects
from pendulum_env.physics.joints import is_possible_at_joint
from pendulum_env.physics.simulation import TorqueBalance
from pendulum_env.plant import PAPER, hide, paper_plant
from pendulum_env.registration import PENDULUM
from robots.arms.planar import GRAVITY, Link, PlanarBodies
from tests.terms import Clipped, Table

with_mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed")
# moments and stops that the run meets
SOONER = {"payload_change": "payload_change=0.02,0.4,0.3", "hard_stop": "hard_stop:upper=0.3"}
MAKERS = {**BACKENDS, "NumPy": partial(Simulator, make_engine=lambda balance, longest: SteppedBody(balance))}
TORQUE = excitation("paper", np.random.default_rng(0)).signal(np.arange(2000) / 1000).astype(np.float32).astype(float)


def positions(backend, torque, model=None, substeps=1) -> np.ndarray:
    joint = MAKERS[backend](Setup(model or paper_plant(), 1000.0, substeps, Sensor(counts=0)))
    return np.array([joint.enable(Start()).position, *(joint.exchange(value).position for value in torque.tolist())])


def batch(torque, model=None) -> np.ndarray:
    """Of the second of three pendulums at once, whose neighbours are driven otherwise."""
    many = gym.make_vec(PENDULUM, num_envs=3, counts=0, model=model)
    start = many.reset(seed=0)[1]
    rows = np.outer(torque, [0.5, 1.0, -0.7]).astype(np.float32)
    return np.array([start["position"][1], *(many.step(row[:, None])[-1]["position"][1] for row in rows)])


def arm(torque, model) -> np.ndarray:
    """Of one link, whose inertia and weight are those of a body."""
    mass, center = PAPER["gravity"] / (GRAVITY * 0.2), 0.2
    link = Link(mass, 0.4, center, PAPER["inertia"] - mass * center**2)
    bodies, path = PlanarBodies([link], [Model(model.terms[2:], model.estimates)], 1e-3, 1), [0.0]
    bodies.start(np.zeros(1), np.zeros(1))
    for value in torque:
        bodies.advance(np.array([value]))
        path.append(bodies.position[0])
    return np.array(path)


ENGINES = {  # each with the error that it may have [rad]
    "pymunk": (partial(positions, "pymunk"), 2e-5),
    "NumPy": (partial(positions, "NumPy"), 1e-8),
    "mujoco": (partial(positions, "mujoco"), 3e-3),
    "batch": (batch, 1e-8),
    "arm": (arm, 1.5e-3),
}


def free() -> np.ndarray:
    return paper_plant().simulate(1e-3, TORQUE, 0.0, 0.0).position[:, 0]


@pytest.mark.parametrize("effect", [None, *effects()])
def test_every_effect_moves_every_engine_as_it_moves_the_model(effect):
    model = paper_plant() if effect is None else hide(paper_plant(), SOONER.get(effect, effect))
    expected = model.simulate(1e-3, TORQUE, 0.0, 0.0).position[:, 0]
    assert effect is None or np.std(expected - free()) > 4e-3
    for name, (run, error) in ENGINES.items():
        if {"mujoco": find_spec("mujoco"), "arm": effect is None or is_possible_at_joint(effects()[effect])}.get(
            name, True
        ):
            path = run(TORQUE[: 600 if name == "NumPy" else None], model)  # NumPy takes its time
            assert np.sqrt(np.mean((path - expected[: len(path)]) ** 2)) < error, name


def test_a_plant_whose_law_is_no_formula_moves_all_the_same():
    tables, formulas = (paper_plant().add(kind(), [0.7]) for kind in (Table, Clipped))
    assert isinstance(make_body(TorqueBalance(tables.terms, tables.theta), 1e-3), SteppedBody)
    assert isinstance(make_body(TorqueBalance(formulas.terms, formulas.theta), 1e-3), RigidBody)
    paths = [positions("pymunk", TORQUE, plant) for plant in (tables, formulas)]
    assert np.ptp(paths[0]) > 1.0
    np.testing.assert_allclose(*paths, rtol=0, atol=1e-5)


@with_mujoco
def test_a_stuck_joint_creeps_as_the_regularised_law_says():
    held = 0.5  # [N m], less than friction
    crept = np.diff(positions("mujoco", np.full(500, held))[-101:]).mean() / 1e-3  # [rad/s]
    assert crept == pytest.approx((1 - 0.9999) * 0.002 * held / (2 * PAPER["inertia"]), rel=0.01)
    assert np.ptp(positions("pymunk", np.full(500, held))) == 0.0


@with_mujoco
def test_the_motion_is_off_by_the_documented_figure_and_converges_to_set_valued_friction():
    exact = positions("pymunk", TORQUE, substeps=4)
    errors = [np.std(positions("mujoco", TORQUE, substeps=count) - exact) / np.std(exact) for count in (1, 2, 4)]
    assert errors[0] < 0.003
    np.testing.assert_allclose(np.divide(errors[:2], errors[1:]), 2.0, rtol=0.2)  # first order


def test_without_mujoco_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModuleNotFoundError, match=r"pendulum-ident\[export\]"):
        gym.make(PENDULUM, backend="mujoco")
