"""`evaluate`: excitation policies beside the paper's signal, on fresh plants."""

import argparse
import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from agents.baselines import BASELINE, BASELINES
from agents.comparison import compare_policies
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

SHIPPED = "agent"  # the policy that ships for the constraint


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare policies, plants and output."""
    parser.add_argument(
        "policies",
        metavar="POLICY",
        nargs="*",
        help=f"{SHIPPED} (which ships), {', '.join(BASELINES)}; a file NAME.npz that `train` wrote, or "
        "MODULE:CLASS, an own class with `predict` (all by default)",
    )
    parser.add_argument("--constraint", choices=CONSTRAINTS, default="peak", help="of the torque (default peak)")
    parser.add_argument(
        "--plants",
        type=options.convert_whole(2, 10_000),
        default=160,  # they take a quarter of an hour for each policy
        help="fresh plants, within 30 %% of the paper's (default 160)",
    )
    options.add_seed(parser, "of plants, noise and signals")
    options.add_hidden_effects(parser)
    options.add_workers(parser)
    parser.add_argument("--json", metavar="FILE", help="write all figures there")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Let every policy excite the same plants, and print the errors of the estimates."""
    check_outputs([arguments.json], [name for name in arguments.policies if name.endswith(".npz")])
    names = dict.fromkeys([BASELINE, *(arguments.policies or [*BASELINES, SHIPPED])])
    baselines = [name for name in names if name in BASELINES]
    policies = {name: _load_policy(name, arguments.constraint) for name in names if name not in BASELINES}
    pool: AbstractContextManager[Executor | None] = nullcontext()
    if arguments.workers > 1:
        pool = open_local_workers(arguments.workers)
    try:
        with pool as executor, terminal.progress("evaluating", lines=True) as tell:
            comparison = compare_policies(
                policies,
                baselines,
                constraint=arguments.constraint,
                plants=arguments.plants,
                seed=arguments.seed,
                effects=arguments.effects,
                executor=executor,
                progress=tell,
            )
    except BrokenExecutor:
        raise InputError("a worker process was killed: memory may be too small, give fewer --workers") from None
    figures = comparison.json()
    print_figures(figures, terminal)
    write_json(arguments.json, figures)
    report_files([arguments.json], terminal)


def print_figures(report: JSON, terminal: Terminal) -> None:
    """Print the figures of a `PolicyComparison`."""
    policies = report["policies"]
    first = policies[report["baseline"]]

    def table(headers: Iterable[str], row: Callable[[JSON], Iterable[str]]) -> None:
        terminal.table(("policy", *headers), [[name, *row(figures)] for name, figures in policies.items()])

    plants = f"{report['plants']} plants within {100 * report['spread']:g} %"
    terminal.say(f"{plants}, 10 s, constraint {report['constraint']}; medians over plants")
    terminal.heading("RMS error of the parameters [%] (Cramer-Rao bound), and time until all stay within [s]")
    table((*(f"at {moment}" for moment in first["error"]), *first["time_to"]), _format_errors)
    terminal.heading(f"Gain over {report['baseline']}, above 1 is better, with bootstrap intervals of 95 %")
    table(first["gain"], lambda figures: map(_format_gain, figures["gain"].values()))
    terminal.heading("What it takes")
    table(("peak [N m]", "RMS [N m]", "speed [rad/s]", "turns", "computing a decision for all [ms]"), _format_use)
    for note in report["notes"]:
        terminal.say(note)


def _format_errors(figures: JSON) -> Iterator[str]:
    for error, bound in zip(figures["error"].values(), figures["cramer_rao"].values(), strict=True):
        yield f"{100 * error[1]:.3f}" + ("" if bound[1] is None else f" ({100 * bound[1]:.3f})")
    yield from (_format_number(quartiles[1]) for quartiles in figures["time_to"].values())


def _format_use(figures: JSON) -> Iterator[str]:
    yield f"{figures['torque_peak']:.2f}"
    yield from (_format_number(figures[name][1]) for name in ("torque_rms", "speed", "turns"))
    yield f"{1e3 * figures['seconds_per_action']:.3g}"


def _format_gain(gain: JSON) -> str:
    return f"{_format_number(gain['ratio'])} ({_format_number(gain['low'])} to {_format_number(gain['high'])})"


def _format_number(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def _load_policy(name: str, constraint: str) -> Any:
    """Load the policy of a name, a file or a class."""
    if name == SHIPPED or name.endswith(".npz"):
        return load(constraint if name == SHIPPED else name)
    return load_class(name) if ":" in name else find("baseline", name, BASELINES)
