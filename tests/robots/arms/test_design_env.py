"""The task of choosing an arm's motion: Gymnasium's contract, its reward, a training, and the policy that ships."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO

from agents import ARM_DESIGN, Network, load
from agents.config import Config
from agents.training import make_task, train
from benchmarks import six_joint
from benchmarks.arm_excitation import deviation, random_fourier
from robots.arms.body import parse_body
from robots.arms.design_env import TORQUE, ArmExcitationDesign, plan_motion
from robots.arms.env import PlanarArm
from robots.arms.excitation import INFORMATION_PRIOR, design_excitation
from robots.arms.limits import find_limits
from robots.arms.reference import KNOT_PERIOD
from workbench.cli import main

SMALL = {"constraint": "arm", "steps": 400, "pendulums": 8, "rollout": 10, "batch": 40, "epochs": 1, "checkpoint": 200}


def test_an_environment_without_pictures_takes_no_render_mode():
    env = gym.make(ARM_DESIGN, render_mode=None)
    assert env.reset(seed=0)[0] in env.observation_space
    with pytest.warns(UserWarning, match="rgb_array"):  # which stable-baselines3 tries first
        PPO("MlpPolicy", ARM_DESIGN, n_steps=4, batch_size=4)
    with pytest.raises(TypeError, match="leave it out"):
        ArmExcitationDesign(render_mode="human")


def test_the_reward_is_the_fall_of_the_standard_errors_and_an_episode_ends():
    env = gym.make(ARM_DESIGN, seconds=3.0)
    env.reset(seed=0)
    rng, paid, steps, done = np.random.default_rng(0), 0.0, 0, False
    while not done:
        _, reward, terminated, done, info = env.step(rng.uniform(-1, 1, 2).astype(np.float32))
        paid, steps = paid + reward, steps + 1
        assert not terminated
    assert steps == round(3.0 / KNOT_PERIOD)
    assert paid == pytest.approx(-0.5 * np.log(np.mean([*info["variances"].values()]) * INFORMATION_PRIOR))


def test_a_training_ends_in_a_policy_that_plays_whole_motions(tmp_path):
    network = train(Config.from_settings(SMALL), folder=tmp_path)
    network.save(tmp_path / "arm.npz")
    loaded, body = Network.load(tmp_path / "arm.npz"), parse_body(PlanarArm().urdf)
    motions = [plan_motion(policy, body, find_limits(body, max_torque=TORQUE), 2.0) for policy in (network, loaded)]
    np.testing.assert_allclose(motions[0].speeds, motions[1].speeds, atol=1e-6)
    assert len(motions[0].speeds) >= 21 and not motions[0].speeds[-1].any()
    np.testing.assert_array_equal(train(Config.from_settings(SMALL)).weights[0], network.weights[0])


def test_nothing_is_to_be_expected_after_the_end_of_a_motion():
    """As return is not discounted, a value beyond the end, of which no reward tells, would make up what it likes."""
    task = make_task(Config.from_settings(SMALL))
    task.reset(seed=0)
    ends = False
    while not ends:
        _, _, terminated, truncated, _ = task.step(np.zeros((8, 2), dtype=int))
        ends = terminated.all()
        assert not truncated.any() and ends == terminated.any()


@pytest.mark.parametrize(("limits", "seconds"), [({}, 5.0), ({"max_angle": 1.5, "max_speed": 3.0}, 8.0)])
def test_the_policy_that_ships_teaches_as_much_as_planning_and_more_than_series(limits, seconds):
    body, limits = parse_body(PlanarArm().urdf), {"max_torque": TORQUE, **limits}
    motion = plan_motion(load("arm"), body, find_limits(body, **limits), seconds)
    series = random_fourier(body, seconds, np.random.default_rng(0), **limits)
    assert deviation(motion, seconds) < 0.7 * deviation(series, seconds)
    assert deviation(motion, seconds) < 1.05 * deviation(design_excitation(body, seconds, **limits), seconds)
    are_kept(motion, find_limits(body, **limits))


def are_kept(motion, limits):
    q, v, a = motion(np.linspace(0, motion.seconds, 2000))
    torque = motion.body.torque(q, v, a) @ motion.body.values
    assert (q >= limits.low - 1e-9).all()
    bounded = (v, limits.speed), (a, limits.acceleration), (torque, limits.torque)
    for moved, most in ((q, limits.high), *((np.abs(own), most) for own, most in bounded)):
        assert (moved <= most + 1e-6).all()


@pytest.mark.parametrize(
    "asked", [(0.5, 0.5, 12.0, 40.0), (None, 2.0, 12.0, 150.0), (None, 4.0, 12.0, 500.0), (None, None, 6.0, None)]
)
def test_limits_are_kept_however_large_acceleration_and_small_torque_may_be(asked):
    body = parse_body(PlanarArm().urdf)
    names = ("max_angle", "max_speed", "max_torque", "max_acceleration")
    asked = {name: own for name, own in zip(names, asked, strict=True) if own is not None}
    limits = find_limits(body, **asked)
    for motion in (plan_motion(load("arm"), body, limits, 5.0), design_excitation(body, 5.0, **asked)):
        are_kept(motion, limits)


def test_a_motion_is_the_best_of_many_that_are_drawn_and_the_same_each_time():
    policy, body = load("arm"), parse_body(PlanarArm().urdf)
    first, again = (plan_motion(policy, body, find_limits(body), 2.0) for _ in range(2))
    np.testing.assert_array_equal(first.speeds, again.speeds)

    class Sure:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return policy.predict(observation, state, episode_start, deterministic=True)

    assert deviation(first, 2.0) < deviation(plan_motion(Sure(), body, find_limits(body), 2.0), 2.0)


def test_a_policy_of_another_arm_is_refused():
    with pytest.raises(ValueError, match=r"the policy \(arm\) was trained on observations of"):
        plan_motion(load("arm"), six := six_joint.body(), find_limits(six), 1.0)


@pytest.mark.parametrize("asked", [[], ["--excitation", "rl"]])
def test_record_lets_an_arm_follow_such_a_motion(tmp_path, capsys, asked):
    robot = tmp_path / "arm.urdf"
    robot.write_text(PlanarArm().urdf)
    arm = ["record", "--robot", str(robot), *asked, "--seconds", "2", "--amplitude", "12"]
    assert main([*arm, "-o", str(tmp_path / "a.csv")]) == 0
    assert "from rest to rest" in capsys.readouterr().out
    assert main([*arm, "--policy", "peak", "-o", str(tmp_path / "b.csv")]) != 0
    assert "policy" in capsys.readouterr().err
