"""`evaluate`: excitation policies beside the paper's signal, on fresh plants."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path

from agents.baselines import BASELINE, BASELINES, baseline
from agents.evaluation import evaluation_json, observe
from agents.network import load
from agents.observer import CONSTRAINTS
from estimators.schemes import SCHEMES
from pendulum_env._typing import JSON
from pendulum_env.lookup import find
from pendulum_env.plant import hide, paper_plant
from pendulum_env.policy import Policy
from workbench.command import Command
from workbench.inputs import InputError, argument, check_outputs, whole, wrote
from workbench.terminal import Terminal

SHIPPED = "agent"  # the policy that ships for the constraint
HEADERS = (
    "policy", "error at 2 s", "5 s", "10 s [%]", "to 1 % [s]", "gain: error 2 s", "error 10 s", "to 1 %", "information",
    "RMS [N m]",
)  # fmt: skip


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare policies, plants and output."""
    known = f"{SHIPPED} (which ships), {', '.join(BASELINES)}, or what `train` wrote"
    parser.add_argument("policies", metavar="POLICY", nargs="*", help=f"{known}; all that have a name by default")
    parser.add_argument("--constraint", type=argument(_constraint), default="peak", help=", ".join(CONSTRAINTS))
    parser.add_argument("--plants", type=whole(2), default=160, help="fresh plants, within 30 %% (default 160)")
    parser.add_argument("--seed", type=whole(0), default=0, help="of plants, noise and signals (default 0)")
    parser.add_argument(
        "--scheme",
        type=argument(_scheme),
        default="filtered_dynamic",
        help="of the estimator (default filtered_dynamic)",
    )
    parser.add_argument(
        "--effect", dest="effects", action="append", type=argument(_effect), default=[], metavar="ID[=VALUE,...]",
        help="hide an effect in the plants (may be repeated)",
    )  # fmt: skip
    parser.add_argument("--json", metavar="FILE", help="write all figures there")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Let every policy excite the same plants, and print what was learnt."""
    check_outputs([arguments.json], [name for name in arguments.policies if name.endswith(".npz")])
    names = list(dict.fromkeys([BASELINE, *(arguments.policies or [SHIPPED, *BASELINES])]))
    policies = {name: _policy(name, arguments.constraint, arguments.seed) for name in names}
    outcomes = {}
    for name, policy in policies.items():
        with terminal.progress(name) as tell:
            outcomes[name] = observe(
                policy,
                arguments.constraint,
                arguments.plants,
                seed=arguments.seed,
                effects=arguments.effects,
                scheme_id=arguments.scheme,
                tell=lambda share, tell=tell: tell("", share),  # type: ignore[misc]
            )
    setting = {name: getattr(arguments, name) for name in ("constraint", "plants", "seed", "scheme", "effects")}
    told = evaluation_json(outcomes, BASELINE, **setting)
    terminal.say(
        f"{arguments.plants} plants within 30 %, 10 s, constraint {arguments.constraint}; medians; gains over "
        f"{BASELINE} with bootstrap intervals of 95 %, above 1 is better"
    )
    terminal.table(HEADERS, [[name, *_row(figures)] for name, figures in told["policies"].items()])
    if arguments.json is not None:
        Path(arguments.json).write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    wrote([arguments.json], terminal)


def _row(figures: JSON) -> Sequence[str]:
    errors = [f"{100 * middle:.3f}" for _, middle, _ in figures["error"].values()]
    _, close, _ = figures["time_to_1_percent"]
    gain = figures["gain"]
    gains = [_gain(gain[name]) for name in ("error 2 s", "error 10 s", "time to 1 %", "information")]
    return *errors, _number(close), *gains, f"{figures['torque_rms'][1]:.2f}"


def _gain(gain: JSON) -> str:
    return f"{_number(gain['ratio'])} ({_number(gain['low'])} to {_number(gain['high'])})"


def _number(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def _policy(name: str, constraint: str, seed: int) -> Policy:
    try:
        if name == SHIPPED:
            return load(constraint)
        return load(name) if name.endswith(".npz") else baseline(name, constraint, seed)
    except ValueError as error:
        raise InputError(str(error)) from None


def _constraint(text: str) -> str:
    find("constraint", text, CONSTRAINTS)
    return text


def _scheme(text: str) -> str:
    find("scheme", text, {item.id: item for item in SCHEMES})
    return text


def _effect(text: str) -> str:
    hide(paper_plant(), text)
    return text


COMMAND = Command("compare excitation policies with the paper's signal, on fresh plants", configure, run)
