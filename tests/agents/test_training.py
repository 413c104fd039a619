"""Training, what it leaves behind, and the two commands."""

from pathlib import Path

import numpy as np
import pytest

from agents import Network, load
from agents.config import Config
from agents.design_env import ExcitationDesignVector
from agents.observer import CONSTRAINTS
from agents.training import TrainingTask, export_network, make_model, train
from pendulum_env.errors import UserError
from robots.arms.env import PlanarArm
from workbench.cli import main

SMALL = {"steps": 288, "pendulums": 8, "rollout": 12, "batch": 48, "epochs": 2, "checkpoint": 96}


def weights(network: Network) -> np.ndarray:
    return np.concatenate([w.ravel() for w in network.weights])


def test_training_repeats_itself_and_keeps_policies_on_the_way(tmp_path):
    told, settings = [], {**SMALL, "steps": 192}
    first = train(Config.from_settings(settings), lambda text, share: told.append(share), tmp_path)
    np.testing.assert_array_equal(weights(first), weights(train(Config.from_settings(settings))))
    assert told[-1] == 1.0 and told == sorted(told)
    policies = sorted(path.name for path in tmp_path.glob("*.npz"))
    assert policies == ["steps-192.npz", "steps-96.npz"]
    assert list(tmp_path.glob("tensorboard/*/events*"))
    np.testing.assert_allclose(weights(load(str(tmp_path / "steps-192.npz"))), weights(first), rtol=1e-6)
    other = train(Config.from_settings({**settings, "steps": 96, "seed": 1}))
    assert (weights(other) != weights(first)).any()


def test_progress_and_total_count_the_decisions_that_are_made():
    config, shares, texts = Config.from_settings({**SMALL, "steps": 100}), [], []
    train(config, lambda text, share: (texts.append(text), shares.append(share)))
    assert config.total == 192 and texts[-1].startswith("192 decisions")
    assert shares[0] == pytest.approx(0.5) and shares[-1] == 1.0


def test_an_interrupted_training_goes_on_from_its_last_policy(tmp_path):
    def interrupt(text: str, share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(Config.from_settings(SMALL), interrupt, tmp_path)
    kept = {int(path.stem.split("-")[1]) for path in tmp_path.glob("steps-*.npz")}
    shares = []
    train(Config.from_settings(SMALL), lambda text, share: shares.append(share), tmp_path)
    assert shares[0] > max(kept) / SMALL["steps"] > 0
    assert (tmp_path / "steps-288.npz").exists()
    with pytest.raises(UserError, match="other settings"):
        train(Config.from_settings({**SMALL, "constraint": "rms"}), folder=tmp_path)


def test_a_policy_acts_as_the_one_that_was_trained():
    """The network in NumPy answers as torch does."""
    config = Config.from_settings(SMALL)
    model = make_model(config)
    network = export_network(model, config)
    observation = np.random.default_rng(0).uniform(-1, 1, (50, 20)).astype(np.float32)
    observation[:, 2] = np.abs(observation[:, 2])  # turning forwards
    choice, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(network.predict(observation)[0][:, 0], np.array(config.levels)[choice[:, 0]], atol=1e-6)


@pytest.mark.parametrize("constraint", CONSTRAINTS)
def test_policies_ship_small_and_see_no_difference_in_a_mirror(constraint):
    network = load(constraint)
    assert network.constraint == constraint
    observation = np.random.default_rng(1).uniform(-1, 1, (50, 20)).astype(np.float32)
    mirror = observation * np.where(np.isin(np.arange(20), [0, 2]), -1, 1)
    np.testing.assert_array_equal(network.predict(observation)[0], -network.predict(mirror)[0])
    single, _ = network.predict(observation[0])
    np.testing.assert_array_equal(single, network.predict(observation)[0][0])


def test_the_price_of_torque_rises_while_too_much_is_commanded():
    config = Config.from_settings({"constraint": "rms", "price_rate": 0.01, "levels": (0.0, 1.0)})
    env = TrainingTask(ExcitationDesignVector(4, constraint="rms"), config)
    env.reset(seed=0)
    for _ in range(3):
        reward = env.step(np.ones((4, 1), dtype=int))[1]
    assert env.price == pytest.approx(3 * 0.01 * 24)
    assert (reward < 0).all()
    for _ in range(100):
        env.step(np.zeros((4, 1), dtype=int))
    assert env.price == 0.0


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ('hidden = "a"', "'hidden': Expected int"),
        ("hidden = 1_000_000_000", "'hidden': Expected int <= 4096"),
        ("pendulums = 100_000\nrollout = 1000", "pendulums times rollout is 100000000"),
        ("levels = [1.0]", "levels has 1 values"),
        ("levels = [0, 2]", "'levels[1]': Expected float <= 1"),
        ("seed = 1048576", "'seed': Expected int <= 1048575"),
        ("step = 3", "unknown key 'step': did you mean steps"),
        ("batch = 9000\npendulums = 8\nrollout = 125", "batch is 9000: give at most the 1000 decisions"),
    ],
)
def test_a_setting_that_makes_no_sense_is_one_line(setting, reason, tmp_path, capsys):
    config = tmp_path / "config.toml"
    config.write_text(setting)
    assert main(["train", "--config", str(config), "-o", str(tmp_path / "new.npz")]) == 2
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == 1


def test_train_from_the_command_line(tmp_path, capsys):
    config, policy = tmp_path / "config.toml", tmp_path / "policy.npz"
    config.write_text("\n".join(f"{name} = {value}" for name, value in {**SMALL, "steps": 960}.items()))
    assert main(["train", "--config", str(config), "-o", str(policy)]) == 0
    printed = capsys.readouterr()
    assert "960 decisions" in printed.out and "too few" in printed.out and f"{Config().steps:,}" in printed.out
    assert [line.split(":")[0] for line in printed.err.splitlines()] == [f"training {k}0 %" for k in range(1, 11)]
    assert load(str(policy)).constraint == "peak"


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("evaluate text.npz", "a policy is what `pendulum-ident train` writes"),
        ("evaluate rms.npz", "was trained under the constraint rms, not peak"),
        ("train -o policy.zip", "should end in .npz"),
        ("train --robot arm.urdf -o x.npz", "robot needs constraint = "),
        (
            "record --robot arm.urdf --excitation rl --amplitude 0.01 --seconds 2 -o x.csv",
            "joint 'shoulder' never moves",
        ),
        ("record --excitation rl --policy arm -o x.csv", "policy arm chooses the motion of an arm"),
        ("record --excitation rl --amplitude 3 -o x.csv", "--amplitude does not go with --excitation rl"),
        ("record --excitation rl --backend simulated -o x.csv", "use --backend pymunk"),
        ("record --excitation rl --policy peek -o x.csv", "unknown policy 'peek': did you mean peak"),
        ("record --excitation paper --policy peak -o x.csv", "--policy goes with --excitation rl only"),
    ],
)
def test_what_makes_no_sense_is_one_line(command, reason, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("text.npz").write_text("no policy")
    load("rms").save("rms.npz")
    Path("arm.urdf").write_text(PlanarArm().urdf)
    assert main(command.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line and not Path("x.csv").exists()
