"""`evaluate`: compare excitation policies with the paper's signal on random plants."""

import argparse
import math
from concurrent.futures import BrokenExecutor, Executor
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from agents.baselines import BASELINE, BASELINES
from agents.comparison import PolicyComparison, compare_policies
from agents.contenders import load_class
from agents.network import load
from agents.observer import CONSTRAINTS
from pendulum_env._typing import JSON
from pendulum_env.lookup import find
from workbench import options
from workbench.errors import InputError
from workbench.outputs import check_outputs, report_files, write_json
from workbench.processes import open_local_workers
from workbench.terminal import Terminal

SHIPPED = "agent"  # name of the shipped policy


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare policies, plants and output."""
    parser.add_argument(
        "policies",
        metavar="POLICY",
        nargs="*",
        help=f"{SHIPPED}: the shipped policy for --constraint; {', '.join(BASELINES)}; a file NAME.npz "
        "that `train` wrote, or MODULE:CLASS, an own class with `predict` (all by default)",
    )
    parser.add_argument("--constraint", choices=CONSTRAINTS, default="peak", help="of the torque (default peak)")
    parser.add_argument(
        "--plants",
        type=options.convert_number(2, 10_000),
        default=160,  # about 15 min for each policy
        help="fresh plants, within 30 %% of the paper's (default 160)",
    )
    options.declare(parser, "--seed", help="of plants, noise and signals (default 0)")
    options.declare(parser, "--effect", "--workers")
    options.add_json(parser, "write all figures there")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Excite the same plants by every policy, and print the errors of the estimates."""
    check_outputs([arguments.json], [name for name in arguments.policies if name.endswith(".npz")])
    names = dict.fromkeys([BASELINE, *(arguments.policies or [*BASELINES, SHIPPED])])
    baselines = [name for name in names if name in BASELINES]
    policies = {name: _load_policy(name, arguments.constraint) for name in names if name not in BASELINES}
    pool: AbstractContextManager[Executor | None] = nullcontext()
    if arguments.workers > 1:
        pool = open_local_workers(arguments.workers)
    try:
        with pool as executor, terminal.progress("evaluating", lines=True) as progress:
            comparison = compare_policies(
                policies,
                baselines,
                constraint=arguments.constraint,
                plants=arguments.plants,
                seed=arguments.seed,
                effects=arguments.effects,
                executor=executor,
                progress=progress,
            )
    except BrokenExecutor:
        raise InputError("a worker process was killed: memory may be too small, give fewer --workers") from None
    figures = print_figures(comparison, terminal)
    write_json(arguments.json, figures)
    report_files([arguments.json], terminal)


def print_figures(comparison: PolicyComparison, terminal: Terminal) -> JSON:
    """Print the figures of a comparison, and return them."""
    report = comparison.json()
    policies = report["policies"]
    first = policies[report["baseline"]]
    gains, use = list[list[str]](), list[list[str]]()
    for name, policy in policies.items():
        parts = ([_format_number(gain[part]) for part in ("ratio", "low", "high")] for gain in policy["gain"].values())
        gains.append([name, *(f"{ratio} ({low} to {high})" for ratio, low, high in parts)])
        times = [_format_number(quartiles[1]) for quartiles in policy["time_to"].values()]
        medians = [_format_number(policy[kind][1]) for kind in ("torque_rms", "speed", "turns")]
        use.append(
            [name, *times, f"{policy['torque_peak']:.2f}", *medians, f"{1e3 * policy['seconds_per_action']:.3g}"]
        )
    plants = f"{report['plants']} plants within {100 * report['spread']:g} %"
    terminal.print(f"{plants}, 10 s, constraint {report['constraint']}")
    terminal.print_heading("RMS error of the parameters over the plants, Cramer-Rao bound, bootstrap intervals of 95 %")
    terminal.print(comparison.tables)
    terminal.print_heading(f"Ratios of medians to {report['baseline']}, above 1 is better")
    terminal.print_table(("policy", *first["gain"]), gains)
    terminal.print_heading("Time until all parameters stay within [s], and cost; medians over plants")
    headers = (
        *first["time_to"],
        "peak [N m]",
        "RMS [N m]",
        "speed [rad/s]",
        "turns",
        "computing a decision for all [ms]",
    )
    terminal.print_table(("policy", *headers), use)
    for note in report["notes"]:
        terminal.print(note)
    return report


def _format_number(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def _load_policy(name: str, constraint: str) -> Any:
    """Load a policy by name, file or class."""
    if name == SHIPPED or name.endswith(".npz"):
        return load(constraint if name == SHIPPED else name)
    return load_class(name) if ":" in name else find("baseline", name, BASELINES)
