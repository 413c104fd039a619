"""Parameters of a simulated plant: told in `info`, changed by a reset, or while it runs."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.plant import PAPER
from pendulum_env.recording import write_recording
from pendulum_env.registration import ARM, DESIGN, PENDULUM

FREE = {"gravity": 0.0, "coulomb": 0.0, "inertia": 0.1, "viscous": 0.2}  # I q'' + b q' = 0
START = {"position": 0.0, "velocity": 5.0}


@pytest.fixture(params=["pymunk", "mujoco", "vector"])
def make(request):
    """Make one pendulum by a backend, or a batch of two."""
    if request.param == "mujoco":
        pytest.importorskip("mujoco")
    if request.param == "vector":
        return lambda **given: gym.make_vec(PENDULUM, num_envs=2, **given)
    return lambda **given: gym.make(PENDULUM, backend=request.param, **given)


def run(env, torque, options=None, changes=None) -> dict[str, np.ndarray]:
    """Position, velocity and parameters at the reset and after each step, of the first pendulum of a batch.

    Parameters change after so many steps.
    """
    shape = env.action_space.shape
    infos = [env.reset(seed=0, options=options)[1]]
    for k, value in enumerate(torque):
        if k in (changes or {}):
            env.unwrapped.set_parameters(changes[k])
        infos.append(env.step(np.full(shape, value, dtype=np.float32))[-1])

    def series(values):
        return np.array([np.ravel(value)[0] for value in values])

    parameters = [name for name in infos[0]["plant"] if not name.startswith("_")]
    return {name: series(info[name] for info in infos) for name in ("position", "velocity")} | {
        name: series(info["plant"][name] for info in infos) for name in parameters
    }


def test_friction_that_changes_in_mid_run_slows_a_free_joint_as_the_closed_form_says(make):
    """v = v0 exp(-b t / I), with b three times as large from 0.3 s on."""
    env = make(theta=FREE, counts=0, velocity="ideal")
    for _ in range(2):  # the next episode begins with the parameters that the plant was made with
        seen = run(env, np.zeros(600), START, {300: {"viscous": 0.6}})
        time = np.arange(601) / 1000
        exponent = np.where(time < 0.3, 2.0 * time, 0.6 + 6.0 * (time - 0.3))
        np.testing.assert_allclose(seen["velocity"], 5.0 * np.exp(-exponent), rtol=0.01)
        np.testing.assert_array_equal(seen["viscous"], np.where(np.arange(601) < 301, 0.2, 0.6))


def test_a_reset_changes_linear_and_shape_parameters_for_later_episodes(make):
    env = make(effects=["dead_time=0.02"], counts=0)
    for options in ({"theta": {"dead_time.dead_time": 0.05, "coulomb": 0.5}}, None):
        seen = run(env, np.full(80, 0.6), options)
        assert np.flatnonzero(seen["position"])[0] in (51, 52)  # 0.6 N m overcome 0.5 N m as soon as they arrive
        assert (seen["coulomb"] == 0.5).all()


@pytest.mark.parametrize("effect", ["presliding", "joint_flexibility", "actuator_lag", "dead_time", "backlash"])
def test_states_of_effects_live_on_when_a_parameter_changes(make, effect):
    torque = 3.0 * np.sin(12.07 * np.arange(400) / 1000) + 2.0
    slightly = {100 * k: {"viscous": PAPER["viscous"] * (1 + 1e-12 * k)} for k in (1, 2, 3)}
    with_changes, without = (run(make(effects=[effect], counts=0), torque, changes=one) for one in (slightly, None))
    np.testing.assert_allclose(with_changes["position"], without["position"], atol=1e-7)


def test_pendulums_of_a_batch_may_differ_in_every_parameter():
    options = {"theta": {"stribeck": [0.2, 0.6], "stribeck.stribeck_velocity": [0.2, 2.0], "gravity": [1.0, 3.0]}}
    settings = {"effects": ["stribeck"], "counts": 0}
    env = gym.make_vec(PENDULUM, num_envs=2, **settings)
    infos = [env.reset(options=options)[1]] + [env.step(np.full((2, 1), 4.0, dtype=np.float32))[-1] for _ in range(400)]
    for k in range(2):
        own = {"theta": {name: value[k] for name, value in options["theta"].items()}}
        alone = run(gym.make(PENDULUM, **settings), np.full(400, 4.0), own)
        np.testing.assert_allclose([info["position"][k] for info in infos], alone["position"], atol=1e-5)
        np.testing.assert_array_equal([info["plant"]["stribeck"][k] for info in infos], alone["stribeck"])


def test_the_plant_of_an_info_is_the_plant_of_a_reset(make):
    settings = {"effects": ["stribeck", "cogging"]}
    changed = {"theta": {"stribeck.stribeck_velocity": 0.8, "cogging.order": 9, "gravity": 1.0}}
    plant = make(**settings).reset(seed=0, options=changed)[1]["plant"]
    again = make(**settings).reset(seed=0, options={"theta": plant})[1]["plant"]
    assert again.keys() == plant.keys() and all(np.array_equal(again[name], plant[name]) for name in plant)
    assert np.all(plant["cogging.order"] == 9)


def test_a_refused_reset_changes_nothing_and_parameters_set_while_it_runs_last_until_the_next(make):
    env = make(effects=["stribeck"])
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    env.unwrapped.set_parameters({"coulomb": 0.5})
    with pytest.raises(ValueError):
        env.reset(options={"theta": {"viscous": 0.5, "inertia": -1.0}})
    plant = env.step(action)[-1]["plant"]
    assert np.all(plant["viscous"] == PAPER["viscous"]) and np.all(plant["coulomb"] == 0.5)
    plant = env.reset()[1]["plant"]
    assert all(np.all(plant[name] == PAPER[name]) for name in ("viscous", "coulomb"))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"viscos": 0.1}, "unknown parameter of the plant 'viscos': did you mean viscous"),
        ({"cogging.sin": 0.1}, r"no effect 'cogging' to change: make it with effects=\['cogging=0'\]"),
        ({"stribeck.stribeck_velocity": 0.0}, "stribeck_velocity of stribeck cannot be 0: give a number from"),
        ({"inertia": 0.0}, "inertia of a plant cannot be 0: give a positive number"),
        ({"gravity": "heavy"}, "gravity of a plant cannot be 'heavy': give a number"),
        ({"hard_stop.upper": -1.0}, "lower has to be below upper"),
    ],
)
def test_a_parameter_that_makes_no_sense_is_refused_by_every_door(make, changes, why):
    settings = {"effects": ["stribeck", "hard_stop:lower=0.5,upper=1.5"]}
    env = make(**settings)
    for ask in (
        lambda: env.reset(options={"theta": changes}),
        lambda: env.unwrapped.set_parameters(changes),
    ):
        with pytest.raises(ValueError, match=why):
            ask()


def test_plants_of_a_batch_have_one_dead_time():
    with pytest.raises(ValueError, match="plants of a batch have one dead_time"):
        gym.make_vec(PENDULUM, num_envs=2, effects="dead_time").reset(
            options={"theta": {"dead_time.dead_time": [0.1, 0.2]}}
        )


def test_a_recording_has_no_plant_to_change(tmp_path, swing):
    write_recording(swing, tmp_path / "run.csv")
    settings = {"backend": "replay", "recording": tmp_path / "run.csv"}
    env = gym.make(PENDULUM, **settings)
    assert "plant" not in env.reset(seed=0)[1]
    for ask in (
        lambda: gym.make(PENDULUM, **settings, theta={"viscous": 0.1}),
        lambda: env.reset(options={"theta": {"viscous": 0.1}}),
        lambda: env.unwrapped.set_parameters({"viscous": 0.1}),
    ):
        with pytest.raises(ValueError, match=r"leave out .*theta|reset it without options|no plant"):
            ask()


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
@pytest.mark.parametrize(("id", "word", "near"), [
    (PENDULUM, "efects", "effects"), (DESIGN, "secconds", "seconds"), (ARM, "torque_nois", "torque_noise"),
])  # fmt: skip
def test_a_misspelt_argument_is_refused_with_the_nearest(make, id, word, near):
    with pytest.raises(ValueError, match=f"unknown argument '{word}': did you mean {near}"):
        make(id, **{word: 1})
