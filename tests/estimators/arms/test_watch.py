"""An arm is watched as a pendulum is: what changed is told with its joint. Its motion is that of SciPy's integrator."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.two_link import Multisine, TwoLink
from estimators.arms.online import ArmBinner
from estimators.online import Verdict, Watch
from estimators.signals.measurements import Smoothing
from estimators.wrappers import WatchModel, WatchModelVector
from pendulum_env.arms.joints import Links, friction
from pendulum_env.arms.model import ArmModel
from pendulum_env.physics import BASE, Model
from pendulum_env.registration import ARM, PENDULUM
from tests.two_link import Hidden

RATE, COUNTS, CHANGE = 500.0, 65_536, 7.0


@pytest.fixture(scope="module")
def before():
    """An arm up to the change, and where it is then."""
    time, signal = np.arange(0.0, CHANGE + 1e-9, 1 / RATE), Multisine.paper(0, (5.0, 2.5))
    return time, signal, *TwoLink().simulate(signal, time)


def watched(body, before, after: TwoLink) -> Verdict:
    time, signal, position, velocity = before
    later = np.arange(time[-1], 12.0, 1 / RATE)
    then, _ = after.simulate(signal, later, tuple(position[-1]), tuple(velocity[-1]))
    time, position = np.r_[time, later[1:]], np.r_[position, then[1:]]
    torque = signal.held(time - 1 / RATE, 1 / RATE) + 0.02 * np.random.default_rng(0).normal(size=position.shape)
    step = 2 * np.pi / COUNTS
    terms, smoothing = (Links(body), *friction(body)), Smoothing.of_encoder(COUNTS, RATE)
    watch = Watch(RATE, terms, calibrate=4.0, binner=ArmBinner(terms, smoothing, RATE))
    for k, t in enumerate(time):
        (said,) = watch.take(np.array([t]), step * np.round(position[k : k + 1] / step), torque[k : k + 1])
        assert t > CHANGE or not said.alarms
    return said


def test_an_arm_that_holds_is_no_alarm(body, before):
    said = watched(body, before, TwoLink())
    assert said.kind == "predicts" and said.alarms == 0


def test_friction_that_changes_at_a_joint_is_a_value_of_that_joint(body, before):
    said = watched(body, before, replace(TwoLink(), viscous=(0.3638, 0.5)))
    assert said.kind == "value" and list(said.changes) == ["viscous@elbow"]
    assert said.changes["viscous@elbow"][0] == pytest.approx(0.1362, rel=0.05)
    assert said.since == pytest.approx(CHANGE, abs=0.3)


def test_what_no_value_explains_is_structure_at_its_joint(body, before):
    said = watched(body, before, Hidden(cogging=(0.0, 0.3)))
    assert said.kind == "structure"
    assert all(place.endswith("@elbow") for place in said.where) and said.where


def test_the_wrapper_takes_links_from_the_environment_and_a_model_of_the_same_arm(body, tmp_path):
    env = WatchModel(gym.make(ARM, rate=500), calibrate=1.0)
    env.reset(seed=0)
    for k in range(1200):
        *_, info = env.step(np.array([5 * np.sin(k / 40) + 3 * np.sin(k / 220), 2.5 * np.sin(k / 35)]))
    assert info["watch"].kind == "predicts"
    arm = gym.make(ARM, rate=500)
    ArmModel.build((Links(body), *friction(body)), np.ones(10)).save(tmp_path / "arm.json")
    assert WatchModel(arm, ArmModel.load(tmp_path / "arm.json", body)).reset(seed=0)[1]["watch"].kind == "calibrating"
    Model.build(BASE, np.ones(4)).save(tmp_path / "pendulum.json")
    with pytest.raises(ValueError, match="no model of an arm"):
        WatchModel(arm, tmp_path / "pendulum.json")
    with pytest.raises(ValueError, match="what is watched is a pendulum"):
        WatchModel(gym.make(PENDULUM), ArmModel.load(tmp_path / "arm.json", body))
    with pytest.raises(ValueError, match="viscous is at none of the joints"):
        WatchModel(arm, terms=["viscous"])
    with pytest.raises(ValueError, match="no-such"):
        WatchModel(arm, robot="no-such.urdf")
    with pytest.raises(ValueError, match="one by one"):
        WatchModelVector(gym.make_vec(ARM, num_envs=2))
