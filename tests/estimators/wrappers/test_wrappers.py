"""Estimating wrappers: what they add to info, in every order that makes sense, for one pendulum and for many."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import Autoreset, NormalizeObservation, RescaleAction, TimeLimit

from estimators.regression.recursive import compute_history
from estimators.schemes import six
from estimators.signals.measurements import Smoothing, measure_with_unfiltered
from estimators.wrappers import (
    DiagnoseOnline,
    DiagnoseOnlineVector,
    EstimateParameters,
    EstimateParametersVector,
    InformationReward,
    InformationRewardVector,
)
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE
from pendulum_env.plant import PAPER
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import RandomizePlant, RecordMeasurements

POLICY = OpenLoop(excitation("paper", np.random.default_rng(0)), 1000.0)


def last_info(env, steps, seed=0):
    infos = []
    rollout(env, POLICY, steps, seed=seed, watch=infos.append)
    return infos[-1]


def test_estimates_while_it_runs_are_those_of_the_recording_and_converge_to_the_plant():
    """To 1e-9, beside another estimator that a wrapper inside has."""
    env = EstimateParameters(gym.make(PENDULUM, torque_noise=0.02), schemes=six.PAPER[3:4], forgetting=0.999)
    smoothing, schemes = (
        Smoothing.from_encoder(1_024_000, 1000.0),
        ["dynamic", "filtered_dynamic", "energy", "hamiltonian"],
    )
    env = EstimateParameters(env, schemes=schemes, smoothing=smoothing, counts=0)  # no noise is subtracted
    infos = []
    recording = rollout(env, POLICY, 4000, seed=0, watch=infos.append)
    for last in (500, 3500):
        # the wrapper sees the start as sample 0, and each later sample one step later than it is indexed
        info = infos[last + smoothing.reach + env.estimator.delay - 1]
        assert set(info["estimates"]) == {"filtered_power", *(scheme.id for scheme in env.schemes)}
        for scheme in env.schemes:
            equations, usable = scheme.regression(measure_with_unfiltered(recording, smoothing), BASE)
            theta = compute_history(equations, usable, np.array([last])).theta[0]
            np.testing.assert_allclose([*info["estimates"][scheme.id]["theta"].values()], theta, rtol=1e-9)
    assert info["parameters"] == tuple(PAPER) and 0 < info["time"] - info["estimates_time"] < 0.05
    there = pickle.loads(pickle.dumps(info))["estimates"]["dynamic"]  # in another process
    assert list(there) == list(info["estimates"]["dynamic"])
    for told in info["estimates"].values():
        assert told["theta"] == pytest.approx(info["plant"], rel=0.01)  # both by name
        np.testing.assert_array_equal([*told["std"].values()], np.sqrt(np.diag(told["covariance"])))
        assert all(told["std"][name] < 0.02 * value for name, value in told["theta"].items())
        assert abs(told["prediction_error"]) < 1


def test_printed_estimates_are_short_and_have_errors_where_there_are_data():
    env = EstimateParameters(gym.make(PENDULUM))
    _, info = env.reset(seed=0)
    assert len(repr(info)) < 1000 and "±" not in repr(info)
    estimate = last_info(env, 1000)["estimates"]["energy"]
    assert len(repr(estimate)) < 200
    for name, value, std in zip(PAPER, estimate["theta"].values(), estimate["std"].values(), strict=True):
        printed, error = map(float, estimate.format()[name].split("±"))
        assert printed == pytest.approx(value, abs=0.1 * std) and error == pytest.approx(std, rel=0.05)
        assert f"{name} {estimate.format()[name]}" in repr(estimate)


def test_every_wrapper_works_in_every_place(tmp_path):
    makers = [
        lambda env: RandomizePlant(env, 0.2),
        lambda env: RecordMeasurements(env, tmp_path / "run.csv", overwrite=True),
        EstimateParameters,
        lambda env: TimeLimit(env, 100),
        lambda env: RescaleAction(env, np.float32(-1), np.float32(1)),
    ]
    estimates = []
    for first in range(5):
        env = gym.make(PENDULUM, max_episode_steps=-1)
        for make in (*makers[first:], *makers[:first]):
            env = make(env)
        env = InformationReward(env)
        env.reset(seed=4)
        total, truncated = 0.0, False
        while not truncated:
            _, reward, _, truncated, info = env.step(np.array([0.3], dtype=np.float32))
            total += reward
        env.close()
        assert total > 0
        estimates.append([*info["estimates"]["filtered_dynamic"]["theta"].values()])
    np.testing.assert_allclose(estimates, [estimates[0]] * len(estimates), rtol=1e-9)


def test_spec_rebuilds_the_wrapped_environment():
    env = InformationReward(
        EstimateParameters(
            RandomizePlant(gym.make(PENDULUM, effects=["stribeck"]), 0.1),
            schemes=["energy", "dynamic"],
            terms=["inertia", "gravity", "viscous", "coulomb", "stribeck"],
            forgetting=0.999,
            in_observation=True,
        )
    )
    again = gym.make(env.spec)
    assert str(again) == str(env)
    assert again.observation_space == env.observation_space
    a, b = last_info(env, 1500), last_info(again, 1500)
    assert a["estimates"]["energy"]["theta"] == b["estimates"]["energy"]["theta"]
    assert len(a["estimates"]["energy"]["theta"]) == 5
    assert gym.envs.registration.EnvSpec.from_json(env.spec.to_json()) == env.spec


def test_wrapped_environment_passes_the_checker_and_can_be_pickled():
    env = EstimateParameters(gym.make(PENDULUM, max_torque=1.0), in_observation=True)
    observation, _ = env.reset(seed=0)
    assert observation.shape == (3 + 2 * 6 * 4,) and observation.dtype == np.float32
    for k in range(300):
        observation, *_ = env.step(np.array([np.sin(k / 20)], dtype=np.float32))
        assert env.observation_space.contains(observation)
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(env, skip_render_check=True)
    copy = pickle.loads(pickle.dumps(env))
    action = np.array([0.5], dtype=np.float32)
    for _ in range(100):
        a, b = env.step(action)[0], copy.step(action)[0]
    np.testing.assert_allclose(a, b, rtol=1e-5)
    assert NormalizeObservation(env).reset(seed=0)[0].shape == observation.shape


def test_reward_is_the_growth_of_the_information():
    env = InformationReward(EstimateParameters(gym.make(PENDULUM)), prior=1e-3)

    def gained(steps):
        env.reset(seed=0)
        taken = [env.step(POLICY.predict(np.zeros(3), (k,))[0]) for k in range(steps)]
        return np.array([reward for _, reward, *_ in taken]), np.array([info["regressor"] for *_, info in taken])

    rewards, rows = gained(2000)
    information = 1e-3 * np.eye(4) + rows.T @ rows
    assert (rewards >= 0).all()
    assert rewards.sum() == pytest.approx(np.linalg.slogdet(information)[1] - 4 * np.log(1e-3), rel=1e-9)
    np.testing.assert_allclose(gained(400)[0], rewards[:400], rtol=1e-9, atol=1e-9)  # all begins anew
    env.reset()
    assert sum(env.step(np.zeros(1, dtype=np.float32))[1] for _ in range(200)) == 0  # at rest


def test_a_coarse_encoder_is_smoothed_as_it_needs_also_in_a_replay(tmp_path):
    env = RecordMeasurements(gym.make(PENDULUM, counts=8192, torque_noise=0.02), tmp_path / "run.csv")
    live = last_info(EstimateParameters(env, schemes="filtered_dynamic"), 8000)
    env.close()
    replay = EstimateParameters(gym.make(PENDULUM, backend="replay", recording=tmp_path / "run.csv"))
    for info in (live, last_info(replay, 10_000)):
        for told in info["estimates"].values():
            for name, value in PAPER.items():
                np.testing.assert_allclose(told["theta"][name], value, rtol=0.02)


def test_wrong_use_is_explained():
    foreign, env = gym.make("Pendulum-v1"), gym.make(PENDULUM)
    for made, why in (
        (lambda: last_info(EstimateParameters(env, rate=500.0), 10), r"samples come every 0\.001 s, not at 500 Hz"),
        (lambda: EstimateParameters(env, schemes=["dynamic", "dynamic"]), "a scheme is named twice"),
        (lambda: EstimateParameters(env, terms=["inertia", "inertia"]), "a term is named twice"),
        (lambda: EstimateParameters(env, schemes=["dynamics"]), "did you mean dynamic"),
        (lambda: EstimateParameters(env, forgeting=0.9), "did you mean forgetting"),
        (lambda: EstimateParameters(env, terms=["inertia", "stribek"]), "unknown effect 'stribek'"),
        (lambda: EstimateParameters(foreign), "pass rate"),
        (lambda: EstimateParameters(foreign, rate=100.0).reset(), "with time, position and torque"),
        (lambda: InformationReward(env), "in EstimateParameters first"),
        (lambda: InformationReward(env, prior=0.0), "give a small positive number"),
    ):
        with pytest.raises(ValueError, match=why):
            made()


def learning(mode, autoreset, steps=120):
    """Infos of two pendulums under the same torques, with an effect, estimated and diagnosed in either vector."""
    settings = {"num_envs": 2, "max_episode_steps": 100, "counts": 0, "effects": ["stribeck=0.2"], "rate": 200.0}
    schemes = ["dynamic", "energy"]
    if mode == "sync":
        env = gym.make_vec(
            PENDULUM,
            vectorization_mode="sync",
            wrappers=[lambda env: EstimateParameters(env, schemes), InformationReward, DiagnoseOnline],
            vector_kwargs={"autoreset_mode": autoreset},
            **settings,
        )
    else:
        env = gym.make_vec(PENDULUM, autoreset_mode=autoreset, **settings)
        env = DiagnoseOnlineVector(InformationRewardVector(EstimateParametersVector(env, schemes)))
    infos = [env.reset(seed=4, options={"position": 0.3})[1]]
    rewards = []
    for k in range(steps):
        torque = 3.0 * np.sin(0.05 * k + np.arange(2)) + 3.0
        _, reward, _, _, info = env.step(torque[:, None].astype(np.float32))
        infos.append(info)
        rewards.append(reward)
    return infos, np.array(rewards)


def assert_same_layout(one, other, of_values=True, where="info"):
    """Names, shapes and types are equal, and numbers nearly so."""
    assert one.keys() == other.keys(), where
    for name in one.keys() - {"final_obs"}:  # which Gymnasium keeps one by one
        a, b, at = one[name], other[name], f"{where}.{name}"
        if isinstance(a, dict):
            assert_same_layout(a, b, of_values, at)
            continue
        assert a.shape == b.shape and a.dtype == b.dtype, at
        if a.dtype != object and of_values:
            np.testing.assert_allclose(a, b, rtol=0.02, atol=1e-3, err_msg=at)
        elif name == "parameters":
            assert [*a] == [*b]


@pytest.mark.parametrize("autoreset", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_native_and_sync_vectors_tell_the_same_in_one_layout(autoreset):
    (native, paid_natively), (sync, paid_in_sync) = (learning(mode, autoreset) for mode in ("native", "sync"))
    for k, (one, other) in enumerate(zip(native, sync, strict=True)):
        # after a reset within a step, the native ones begin with the next sample
        assert_same_layout(one, other, of_values=k <= 100 or autoreset is AutoresetMode.NEXT_STEP)
    np.testing.assert_allclose(paid_natively[:100], paid_in_sync[:100], rtol=1e-2, atol=1e-2)


def test_an_environment_that_resets_itself_starts_estimation_and_reward_anew():
    """Below the wrappers, by Gymnasium's `Autoreset`, as above them."""
    inside = InformationReward(EstimateParameters(Autoreset(gym.make(PENDULUM, max_episode_steps=200))))
    outside = Autoreset(InformationReward(EstimateParameters(gym.make(PENDULUM, max_episode_steps=200))))
    runs = []
    for env in (inside, outside):
        env.reset(seed=0)
        steps = [env.step(np.array([3.0], dtype=np.float32)) for _ in range(350)]
        runs.append([(reward, info["estimates_time"]) for k, (_, reward, *_, info) in enumerate(steps) if k != 200])
    np.testing.assert_allclose(*runs)


@pytest.mark.parametrize("mode", ["sync", "vector_entry_point"])
def test_estimates_are_in_the_last_observations_of_episodes_too(mode):
    settings = {"vector_kwargs": {"autoreset_mode": "SameStep"}} if mode == "sync" else {"autoreset_mode": "SameStep"}
    env = gym.make_vec(PENDULUM, num_envs=2, max_episode_steps=100, vectorization_mode=mode, **settings)
    env = EstimateParametersVector(env, schemes="dynamic", in_observation=True)
    env.reset(seed=0)
    for _ in range(100):
        observation, *_, info = env.step(np.full((2, 1), 3.0, dtype=np.float32))
    assert env.observation_space.contains(observation)
    theta = info["final_info"]["estimates"]["dynamic"]["theta"]
    for last, *estimates in zip(info["final_obs"], *(theta[name] for name in PAPER), strict=True):
        np.testing.assert_allclose(last[3:7], estimates, rtol=1e-6)
