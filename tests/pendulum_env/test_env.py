"""The environment's contract, for every backend, and its physics against an independent integrator."""

import pickle
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from benchmarks.independent_plant import Experiment, Plant, simulate
from pendulum_env.env import DirectDrivePendulum
from pendulum_env.excitation import excitation
from pendulum_env.plant import hide, paper_plant
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.recording import RecordingError, write_recording
from pendulum_env.registration import PENDULUM
from tests import slow


def paper_torque(seconds: float, seed: int = 0) -> np.ndarray:
    """As the environment takes it: of single precision."""
    time = np.arange(round(1000 * seconds)) / 1000
    return excitation("paper", np.random.default_rng(seed)).signal(time).astype(np.float32).astype(float)


def positions(env: gym.Env, torque: np.ndarray, seed: int | None = 0) -> np.ndarray:
    _, info = env.reset(seed=seed)
    run = [info["position"]]
    for value in torque:
        run.append(env.step(np.array([value], dtype=np.float32))[-1]["position"])
    return np.array(run)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "run.csv"
    env = gym.make(PENDULUM, torque_noise=0.05)
    write_recording(rollout(env, OpenLoop(excitation("paper", np.random.default_rng(0)), 1000.0), 1500, seed=0), path)
    return path


@pytest.fixture(params=["pymunk", "mujoco", "replay"])
def settings(request, file):
    if request.param == "mujoco":
        pytest.importorskip("mujoco")
    return {"backend": request.param, "recording": file if request.param == "replay" else None}


HOW = [f"id = 'pendulum_env:{PENDULUM}'", f"import pendulum_env; id = '{PENDULUM}'"]


@pytest.mark.parametrize("how", slow.but_first(HOW))
def test_gymnasium_knows_the_environment_by_its_conventions_and_nothing_is_imported_that_is_not_needed(how):
    code = (
        f"import gymnasium, sys; {how}; print('pymunk' in sys.modules, gymnasium.make(id).unwrapped.rate); "
        "from estimators import *; import pendulum_env.backends.emulators; "
        "print({'torch', 'plotly', 'pygame', 'serial', 'nidaqmx', 'grpc'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "1000.0", "set()"]


def test_gymnasiums_checker_only_recommends_a_normalised_action(settings):
    """A torque in N m is the contract; with the bound at 1 N m there is nothing left to recommend."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(gym.make(PENDULUM, **settings).unwrapped)
    assert all("symmetric and normalized space" in str(warning.message) for warning in said)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(PENDULUM, max_torque=1.0, **settings).unwrapped)


def test_spec_rebuilds_the_environment(settings):
    env = gym.make(PENDULUM, **settings)
    again = gym.make(env.spec)
    np.testing.assert_array_equal(positions(env, np.full(50, 3.0)), positions(again, np.full(50, 3.0)))


def test_same_seed_same_run_bit_for_bit():
    torque = paper_torque(1.0)

    def run(env, seed):
        env.reset(seed=seed)
        infos = [env.step(np.array([u], dtype=np.float32))[-1] for u in torque]
        return np.array([(info["torque"], info["position"]) for info in infos])

    env, other = (gym.make(PENDULUM, torque_noise=0.1, effects=["stribeck"]) for _ in range(2))
    first = run(env, 3)
    np.testing.assert_array_equal(first, run(env, 3))
    np.testing.assert_array_equal(first, run(other, 3))
    assert not np.array_equal(first, run(env, 4))


@pytest.mark.parametrize("backend", ["pymunk", "mujoco"])
@pytest.mark.parametrize("effect", ["stribeck", "actuator_lag", "dead_time", "joint_flexibility"])
def test_a_pickled_environment_goes_on_where_it_was(effect, backend):
    if backend == "mujoco":
        pytest.importorskip("mujoco")
    env, torque = gym.make(PENDULUM, backend=backend, effects=[effect]), paper_torque(1.0)
    positions(env, torque[:500])
    copy = pickle.loads(pickle.dumps(env))
    for value in torque[500:]:
        a, b = (one.step(np.array([value]))[-1]["position"] for one in (env, copy))
    assert a == pytest.approx(b, abs=1e-9)


def test_pymunk_follows_an_independent_integrator_with_an_error_of_second_order_in_the_step():
    """The paper's excitation, at the default substeps: RMS below 5e-4 rad, and in fact below 1e-5."""
    torque = paper_torque(4.0)
    plant = Plant(inertia=0.0895, gravity=2.01, viscous=0.3638, coulomb=0.9163)
    (reference,) = simulate([(plant, Experiment(rate=1000.0, seconds=4.0, counts=None, torque_noise=0.0))], [torque])
    runs = [positions(gym.make(PENDULUM, counts=0, substeps=n), torque) for n in (1, 2, 4)]
    errors = [np.sqrt(np.mean((run[: len(reference.position)] - reference.position) ** 2)) for run in runs]
    assert errors[0] < 1e-5
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.6).all(), orders


def test_measurement_is_what_was_asked_for():
    env = gym.make(PENDULUM, counts=8192, max_torque=4.0)
    _, info = env.reset(options={"position": 1.0, "velocity": 2.0})
    assert info["velocity"] == pytest.approx(2.0, abs=2 * np.pi / 8192 * 1000)
    assert (info["time"], info["torque"]) == (0.0, 0.0)
    for k in range(1, 100):
        before = info
        _, reward, terminated, _, info = env.step(np.array([9.0], dtype=np.float32))
        assert info["time"] == pytest.approx(k / 1000)
        assert info["torque"] == 4.0 and info["clipped"]
        assert info["position"] * 8192 / (2 * np.pi) == pytest.approx(round(info["position"] * 8192 / (2 * np.pi)))
        assert info["velocity"] == pytest.approx((info["position"] - before["position"]) * 1000)
        assert (reward, terminated) == (0.0, False)


@pytest.mark.parametrize("most", [0.1, 0.7, 15.0])  # single precision rounds the first up and the second down
def test_clipped_is_what_the_bound_took_from_and_nothing_else(most):
    env = gym.make(PENDULUM, max_torque=most)
    assert not env.reset()[1]["clipped"]
    for action in (env.action_space.high, env.action_space.low, [most], [0.5 * most]):
        assert not env.step(np.asarray(action))[-1]["clipped"]
    for action in (1.01 * most, -1.01 * most):
        assert env.step(np.array([action]))[-1]["clipped"]


def test_replay_plays_the_recording_and_says_that_it_ignores_the_action(file):
    env = gym.make(PENDULUM, backend="replay", recording=file)
    played = rollout(env, OpenLoop(excitation("steps", np.random.default_rng(1)), 1000.0), 10_000)
    again = rollout(env, OpenLoop(excitation("prbs", np.random.default_rng(1)), 1000.0), 10_000)
    np.testing.assert_array_equal(played.torque, again.torque)
    assert len(played) == 1499  # after the last sample no torque is known
    info = env.reset()[1]
    assert info["follows"] is False
    with pytest.raises(ValueError, match="starts as it is"):
        env.reset(options={"position": 1.0})


def test_an_identified_model_can_be_the_plant(tmp_path):
    plant = hide(paper_plant({"inertia": 0.2}), "cogging=0.3,0.1,12")
    plant.save(tmp_path / "model.json")
    torque = paper_torque(0.5)
    by_file = positions(gym.make(PENDULUM, model=tmp_path / "model.json"), torque)
    by_words = positions(gym.make(PENDULUM, theta={"inertia": 0.2}, effects=["cogging=0.3,0.1,12"]), torque)
    np.testing.assert_array_equal(by_file, by_words)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"backend": "pymonk"}, ValueError, "did you mean pymunk"),
        ({"theta": [1.0, 2.0]}, TypeError, "give parameters by name"),
        ({"rate": "200"}, ValueError, "rate of a pendulum cannot be '200': give a positive number"),
        ({"substeps": 1.5}, ValueError, "substeps of a pendulum cannot be 1.5"),
        ({"counts": -1}, ValueError, "numbers from zero on"),
        ({"velocity": "exact"}, ValueError, "unknown velocity"),
        ({"backend": "replay"}, ValueError, "needs a recording"),
        ({"backend": "replay", "recording": "r.csv", "effects": ["stribeck"]}, ValueError, "leave out effects"),
        ({"backend": "replay", "recording": "r.csv", "rate": 500}, ValueError, "leave out .* rate"),
        ({"backend": "replay", "recording": "nowhere.csv"}, RecordingError, "there is no such file"),
        ({"render_mode": "ansi"}, ValueError, "unknown render_mode"),
    ],
)
def test_bad_arguments_are_refused_with_a_remedy(arguments, error, text):
    with pytest.raises(error, match=text):
        DirectDrivePendulum(**arguments)


def test_bad_actions_and_options_are_refused():
    env = gym.make(PENDULUM).unwrapped
    with pytest.raises(gym.error.ResetNeeded, match="call reset before step"):
        env.step(np.zeros(1))
    env.reset()
    for action in (3.0, np.zeros((1, 2)), np.zeros(0), np.array([np.nan])):
        with pytest.raises(ValueError, match=r"the action is .*it needs \(1,\), a torque in N m"):
            env.step(action)
    for options in ({"position": np.nan}, {"position": "up"}, {"velocity": [1.0, 2.0]}, {"positon": 1}):
        with pytest.raises(ValueError, match="did you mean position" if "positon" in options else "cannot"):
            env.reset(options=options)


def test_picture_shows_the_arm_where_it_is():
    env = gym.make(PENDULUM, render_mode="rgb_array")
    pictures = {}
    for angle in (0.0, np.pi / 2, np.pi):
        env.reset(options={"position": angle})
        pictures[angle] = env.render()
    height, width, _ = pictures[0.0].shape

    def center_of_arm(picture):
        blue = (picture[..., 2].astype(int) - picture[..., 0]) > 60
        rows, columns = np.nonzero(blue)
        return columns.mean() - width / 2, rows.mean() - height / 2

    assert center_of_arm(pictures[0.0])[1] > center_of_arm(pictures[np.pi / 2])[1] > center_of_arm(pictures[np.pi])[1]
    assert center_of_arm(pictures[np.pi / 2])[0] > 40 > abs(center_of_arm(pictures[0.0])[0])


def test_a_window_opens_and_closes():
    env = gym.make(PENDULUM, render_mode="human")
    positions(env, np.full(50, 2.0))
    env.close()
    env.close()


def test_a_signal_for_another_rate_is_refused():
    with pytest.raises(ValueError, match="laid out for 1000 Hz, the environment runs at 200 Hz"):
        rollout(gym.make(PENDULUM, rate=200.0), OpenLoop(excitation("paper", np.random.default_rng(0)), 1000.0), 10)
