"""The MuJoCo backend's physics: its friction is regularised, and that is all that differs as steps become short."""

import sys

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.backends import BACKENDS, Sensor, Setup, Start
from pendulum_env.excitation import excitation
from pendulum_env.physics import effects
from pendulum_env.plant import PAPER, hide, paper_plant
from pendulum_env.registration import PENDULUM

mujoco = pytest.importorskip("mujoco")

# than a run that is quick ends
SOONER = {"payload_change": "payload_change=0.02,0.4,0.3", "hard_stop": "hard_stop:upper=0.3"}
TORQUE = np.r_[0.0, excitation("paper", np.random.default_rng(0)).signal(np.arange(2000) / 1000)]


def positions(backend, torque, model=None, substeps=1) -> np.ndarray:
    joint = BACKENDS[backend](Setup(model or paper_plant(), 1000.0, substeps, Sensor(counts=0)))
    return np.array([joint.enable(Start()).position, *(joint.exchange(value).position for value in torque.tolist())])


def test_a_stuck_joint_creeps_as_the_regularised_law_says():
    held = 0.5  # [N m], less than friction
    crept = np.diff(positions("mujoco", np.full(500, held))[-101:]).mean() / 1e-3  # [rad/s]
    assert crept == pytest.approx((1 - 0.9999) * 0.002 * held / (2 * PAPER["inertia"]), rel=0.01)
    assert np.ptp(positions("pymunk", np.full(500, held))) == 0.0


def test_the_motion_is_off_by_the_documented_figure_and_converges_to_set_valued_friction():
    exact = positions("pymunk", TORQUE, substeps=4)
    errors = [np.std(positions("mujoco", TORQUE, substeps=count) - exact) / np.std(exact) for count in (1, 2, 4)]
    assert errors[0] < 0.003
    np.testing.assert_allclose(np.divide(errors[:2], errors[1:]), 2.0, rtol=0.2)  # first order


@pytest.mark.parametrize("effect", effects())
def test_every_effect_moves_it_as_it_moves_the_other_engine(effect):
    model, torque = hide(paper_plant(), SOONER.get(effect, effect)), TORQUE[:600]
    exact = positions("pymunk", torque, model)
    assert np.std(positions("mujoco", torque, model) - exact) < 0.01 * np.std(exact)


def test_without_mujoco_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModuleNotFoundError, match=r"pendulum-ident\[export\]"):
        gym.make(PENDULUM, backend="mujoco")
