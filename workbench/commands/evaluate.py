"""`evaluate`: excitation policies beside the paper's signal, on fresh plants."""

import argparse
import math
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor
from contextlib import AbstractContextManager, nullcontext
from functools import partial

from agents.baselines import BASELINE, BASELINES, baseline
from agents.evaluation import Contender, compare, evaluation_json
from agents.network import Network, load
from agents.observer import CONSTRAINTS
from estimators.schemes.six import SCHEMES
from pendulum_env._typing import JSON
from workbench.inputs import check_outputs, write_json, wrote
from workbench.mistakes import InputError
from workbench.options import declare, number, one_of, whole
from workbench.processes import local_workers
from workbench.terminal import Terminal

SHIPPED = "agent"  # the policy that ships for the constraint
PLANNER = "look-ahead"  # with which the agent's information and time are compared


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare policies, plants and output."""
    known = f"{SHIPPED} (which ships), {', '.join(BASELINES)}, or what `train` wrote"
    declare(
        parser,
        f"""
        policies POLICY  {known}; all that have a name by default
        --constraint  {", ".join(CONSTRAINTS)}
        --plants  fresh plants (default 160)
        --spread  within which they differ (default 0.3)
        --max-speed RAD/S  beyond which no torque drives the arm on
        --max-turns TURNS  likewise, to either side
        --seed  of plants, noise and signals (default 0)
        --scheme  of the estimator (default filtered_dynamic)
        --effect  hide an effect in the plants (may be repeated)
        --workers  processes on this computer (default: one for each core)
        --json FILE  write all figures there
        """,
        policies={"nargs": "*"},
        constraint=(one_of("constraint", CONSTRAINTS), "peak"),
        plants=(whole(2, 10_000), 160),  # they take a quarter of an hour for each policy
        spread=(number(0.0, 0.9), 0.3),
        max_speed=number(0.1),
        max_turns=number(0.01),
        workers=(whole(1, 1000), os.cpu_count() or 1),
        scheme=(one_of("scheme", [item.id for item in SCHEMES]), "filtered_dynamic"),
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Let every policy excite the same plants, and tell what was learnt."""
    files = [name for name in arguments.policies if name.endswith(".npz")]
    check_outputs([arguments.json], files)
    names = list(dict.fromkeys([BASELINE, *(arguments.policies or [SHIPPED, *BASELINES])]))
    task = {name: getattr(arguments, name) for name in ("spread", "max_speed", "max_turns")}
    task = {name: value for name, value in task.items() if value is not None}
    contenders = {name: _contender(name, arguments.constraint) for name in names}
    pool: AbstractContextManager[Executor | None] = nullcontext()
    if arguments.workers > 1:
        pool = local_workers(arguments.workers)
    try:
        with pool as executor, terminal.progress("evaluating") as tell:
            outcomes = compare(
                contenders,
                arguments.constraint,
                arguments.plants,
                seed=arguments.seed,
                effects=arguments.effects,
                task=task,
                scheme_id=arguments.scheme,
                executor=executor,
                tell=tell,
            )
    except BrokenExecutor:
        raise InputError("a worker process was killed: memory may be too small, give fewer --workers") from None
    told = ("constraint", "plants", "seed", "scheme", "effects", "spread", "max_speed", "max_turns")
    setting = {name: getattr(arguments, name) for name in told}
    figures = evaluation_json(outcomes, BASELINE, **setting)
    show(figures, terminal)
    write_json(arguments.json, figures)
    wrote([arguments.json], terminal)


def show(report: JSON, terminal: Terminal) -> None:
    """Print what `evaluation_json` holds."""
    policies = report["policies"]
    first = policies[report["baseline"]]

    def table(headers: Iterable[str], row: Callable[[JSON], Iterable[str]]) -> None:
        terminal.table(("policy", *headers), [[name, *row(figures)] for name, figures in policies.items()])

    plants = f"{report['plants']} plants within {100 * report['spread']:g} %"
    terminal.say(f"{plants}, 10 s, constraint {report['constraint']}; medians over plants")
    terminal.heading("RMS error of the parameters [%] (Cramer-Rao bound), and time until all stay within [s]")
    table((*(f"at {moment}" for moment in first["error"]), *first["time_to"]), _errors)
    terminal.heading(f"Gain over {report['baseline']}, above 1 is better, with bootstrap intervals of 95 %")
    table(first["gain"], lambda figures: map(_gain, figures["gain"].values()))
    terminal.heading("What it takes")
    table(("peak [N m]", "RMS [N m]", "speed [rad/s]", "turns", "computing a decision for all [ms]"), _use)
    if PLANNER in policies and SHIPPED in policies:
        agent, planner = policies[SHIPPED], policies[PLANNER]
        share = agent["gain"]["information"]["ratio"] / planner["gain"]["information"]["ratio"]
        faster = planner["seconds_per_action"] / agent["seconds_per_action"]
        told = f"learns {share:.2f} times what looking ahead does, and decides for all {faster:.0f} times faster"
        terminal.say(f"\nthe agent {told}")


def _errors(figures: JSON) -> Iterator[str]:
    for error, bound in zip(figures["error"].values(), figures["cramer_rao"].values(), strict=True):
        yield f"{100 * error[1]:.3f}" + ("" if bound[1] is None else f" ({100 * bound[1]:.3f})")
    yield from (_number(quartiles[1]) for quartiles in figures["time_to"].values())


def _use(figures: JSON) -> Iterator[str]:
    yield f"{figures['torque_peak']:.2f}"
    yield from (_number(figures[name][1]) for name in ("torque_rms", "speed", "turns"))
    yield f"{1e3 * figures['seconds_per_action']:.3g}"


def _gain(gain: JSON) -> str:
    return f"{_number(gain['ratio'])} ({_number(gain['low'])} to {_number(gain['high'])})"


def _number(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def _contender(name: str, constraint: str) -> Contender:
    if name == SHIPPED or name.endswith(".npz"):
        network = load(constraint if name == SHIPPED else name)
        if network.constraint != constraint:
            raise InputError(f"{name}: was trained under the constraint {network.constraint}, not {constraint}")
        return partial(_always, network)
    baseline(name, constraint)
    return partial(baseline, name, constraint)


def _always(network: Network, seed: int) -> Network:
    return network  # it draws nothing
