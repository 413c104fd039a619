"""`train`: train a policy that chooses excitations."""

import argparse
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from agents.config import DEFAULTS, Config
from agents.observer import ARM
from pendulum_env.reading import read_toml
from workbench.errors import InputError, Interrupted
from workbench.outputs import check_outputs, report_files
from workbench.terminal import Terminal

NEEDED = ("torch", "stable_baselines3")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare settings of the training and output."""
    parser.add_argument(
        "--config", metavar="FILE", help="TOML with other settings of agents.config.Config, such as seed and steps"
    )
    parser.add_argument(
        "--constraint",
        choices=tuple(DEFAULTS),
        help="of a pendulum's torque: peak or rms; arm: the motion of an arm within its limits (default peak)",
    )
    parser.add_argument("--robot", metavar="FILE", help="arm to train on, URDF or MJCF, for --constraint arm")
    parser.add_argument(
        "--checkpoints",
        metavar="FOLDER",
        help="keep policies on the way, a log for TensorBoard, and the model there, from which the same command goes "
        "on after an interruption. Reading the model runs the pickles in it: name only folders of your own",
    )
    parser.add_argument("-o", "--output", metavar="NAME.npz", required=True, help="policy")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Train and write the policy."""
    if not arguments.output.lower().endswith(".npz"):
        raise InputError(f"{arguments.output}: the name of a policy should end in .npz")
    check_outputs([arguments.output], [arguments.config] if arguments.config else [])
    if any(find_spec(name) is None for name in NEEDED):
        raise InputError("training needs the extra rl: pip install 'pendulum-ident[rl]'")
    config = _read_config(arguments)
    folder = None if arguments.checkpoints is None else Path(arguments.checkpoints)
    if config.steps < (least_steps := Config.from_settings({"constraint": config.constraint}).steps):
        steps = f"{config.steps:,} steps are too few to learn the task"
        least = f"it takes {least_steps:,} (`steps` in --config)"
        terminal.print(f"{steps}: under the constraint {config.constraint} {least}")
    training = import_module("agents.training")  # imports torch
    try:
        with terminal.progress("training", lines=True) as progress:
            network = training.train(config, progress, folder)
    except KeyboardInterrupt:
        has_checkpoint = folder is not None and (folder / training.CHECKPOINT).exists()
        raise Interrupted(f"run it again to go on from {folder}" if has_checkpoint else "nothing was kept") from None
    network.save(arguments.output)
    terminal.print(f"{config.total:,} decisions under the constraint {config.constraint}, seed {config.seed}")
    if config.constraint != ARM:
        terminal.print(f"`pendulum-ident evaluate {arguments.output} --constraint {config.constraint}` compares it")
    else:
        robot = config.robot or "FILE"
        terminal.print(f"`pendulum-ident record --robot {robot} --excitation rl --policy {arguments.output}` plays it")
    report_files([arguments.output], terminal)


def _read_config(arguments: argparse.Namespace) -> Config:
    options = {name: getattr(arguments, name) for name in ("constraint", "robot")}
    options = {name: value for name, value in options.items() if value is not None}
    settings = {} if arguments.config is None else read_toml(arguments.config)
    try:
        return Config.from_settings(settings | options)
    except ValueError as error:
        raise InputError(str(error) if arguments.config is None else f"{arguments.config}: {error}") from None
