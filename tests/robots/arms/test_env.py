from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import pendulum_env  # noqa: F401  (makes the environments known)
from benchmarks.two_link import Multisine, TwoLink
from robots.arms.body import read_body
from robots.arms.planar import TWO_LINK, Link

ID = "pendulum_env/PlanarArm-v0"
ARM = TwoLink()
FREE = tuple(replace(link, viscous=0.0, coulomb=0.0) for link in TWO_LINK)


def test_the_arm_moves_as_the_textbook_integrated_between_events():
    """The paper's friction and amplitude; stronger torque makes the arm tumble, which is chaotic."""
    time = np.arange(0, 4, 1e-3)
    signal = Multisine.paper(0, (3.0, 1.5))
    told, _ = ARM.simulate(signal, time)
    env = gym.make(ID, counts=0).unwrapped
    positions = [env.reset()[1]["position"]]
    for torque in signal.held(time, 1e-3)[:-1]:
        positions.append(env.step(torque)[4]["position"])
    assert np.ptp(told, axis=0).min() > 1.0
    assert np.sqrt(np.mean((np.array(positions) - told) ** 2, axis=0)).max() < 1e-3


def test_a_joint_sticks_exactly_where_friction_can_hold_it():
    env = gym.make(ID, counts=0).unwrapped
    env.reset()
    for _ in range(300):
        info = env.step(np.array([0.9, 0.0]))[4]
    assert np.abs(info["position"]).max() < 1e-5
    for _ in range(300):
        info = env.step(np.array([1.2, 0.0]))[4]
    assert info["position"][0] > 0.01


def test_an_effect_at_a_joint_acts_there():
    runs = []
    for effects in ((), "torque_offset@elbow=0.5", "torque_offset@shoulder=0.5"):
        env = gym.make(ID, links=FREE, effects=effects).unwrapped
        env.reset()
        for _ in range(50):
            info = env.step(np.array([0.0, 0.5]))[4]
        runs.append(info["position"])
    assert np.abs(runs[0]).max() > 0.01
    assert np.abs(runs[1]).max() < 1e-4  # takes the elbow's torque away
    assert abs(runs[2][0] - runs[0][0]) > 1e-3


def test_joints_have_a_name_each_which_may_be_any(tmp_path):
    (tmp_path / "arm.urdf").write_text(gym.make(ID, joints=("a&b", "<elbow>")).unwrapped.urdf)
    assert read_body(tmp_path / "arm.urdf").joints == ("a&b", "<elbow>")
    for joints in (("elbow",), ("elbow", "elbow"), ("a", "b", "c")):
        with pytest.raises(ValueError, match="2 links needs as many joints of different names"):
            gym.make(ID, joints=joints)


@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
def test_the_environment_passes_gymnasiums_checks():
    check_env(gym.make(ID, render_mode="rgb_array").unwrapped, skip_render_check=False)
    env = gym.make(ID, links=(Link(), Link(), Link()), torque_noise=0.1)
    assert env.action_space.shape == (3,) and env.observation_space.shape == (9,)
    env.reset(seed=3)
    first = env.step(np.ones(3, dtype=np.float32))[4]["torque"]
    env.reset(seed=3)
    assert np.array_equal(env.step(np.ones(3, dtype=np.float32))[4]["torque"], first)


def test_clipped_is_said_of_each_joint_and_many_arms_step_together():
    env = gym.make(ID, max_torque=2.0)
    assert env.reset()[1]["clipped"].tolist() == [False, False]
    assert env.step(np.array([-2.5, 2.0]))[-1]["clipped"].tolist() == [True, False]
    envs = gym.make_vec(ID, num_envs=3)
    envs.reset(seed=0)
    assert envs.step(np.ones((3, 2), dtype=np.float32))[0].shape == (3, 6)
    envs.close()


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (lambda _: gym.make(ID, effects="stribek@elbow"), "unknown effect 'stribek': did you mean stribeck"),
        (lambda _: gym.make(ID, effects="stribeck@elbo"), "unknown joint 'elbo': did you mean elbow"),
        (lambda _: gym.make(ID, effects="stribeck"), "should say at which joint"),
        (lambda _: gym.make(ID, effects="backlash@elbow"), "cannot sit at a joint of an arm"),
        (lambda _: gym.make(ID, rate=0.0), "rate of an arm cannot be 0"),
        (lambda env: env.step(np.zeros(3)), "action of an arm with 2 joints needs as many numbers"),
        (lambda env: env.reset(options={"positon": [0, 0]}), "unknown option of reset 'positon'"),
    ],
)
def test_arguments_actions_and_options_that_make_no_sense_are_refused(asked, told):
    env = gym.make(ID).unwrapped
    env.reset()
    with pytest.raises(ValueError, match=told):
        asked(env)
