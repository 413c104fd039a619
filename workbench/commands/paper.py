"""`paper`: the source paper's experiment, repeated on a pendulum whose parameters are known."""

from __future__ import annotations

import argparse

from estimators.paper import PARAMETERS, TABLE_2, WAYS, Experiment, paper_experiment
from estimators.paper.experiment import RUNS, SECONDS
from pendulum_env.plant import paper_plant
from workbench.inputs import check_outputs, number, take_report, whole, write_json, wrote
from workbench.terminal import Terminal

SHORTEST, LONGEST = 5.0, 600.0  # [s] of a run


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare runs, seed and outputs."""
    parser.add_argument("--runs", type=whole(1, 10_000), default=RUNS, help=f"with random phases (default {RUNS})")
    parser.add_argument(
        "--seconds", type=number(SHORTEST, LONGEST), default=SECONDS, help=f"length of each (default {SECONDS:g})"
    )
    parser.add_argument("--seed", type=whole(0), default=0, help="of phases and noise (default 0)")
    take_report(parser, "Table 2 and figures 2 to 9 as one page")
    parser.add_argument("--json", metavar="FILE", help="write all numbers")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Run the experiment, print Table 2 and what each care buys, write what was asked for."""
    outputs = [arguments.report, arguments.json]
    check_outputs(outputs)
    with terminal.progress("the paper's experiment") as progress:
        experiment = paper_experiment(arguments.runs, arguments.seconds, arguments.seed, progress=progress)
    write_json(arguments.json, experiment.json())
    if arguments.report is not None:
        from workbench.report.paper import write_paper_report  # plotly takes a while to import

        with terminal.progress("writing the report"):
            write_paper_report(arguments.report, experiment)
    tell(experiment, terminal)
    wrote(outputs, terminal)


def tell(experiment: Experiment, terminal: Terminal) -> None:
    """Print the tables of the page."""
    units = [f"{name} [{paper_plant().estimates[name].unit}]" for name in PARAMETERS]
    truth = ("truth of the simulation", *(f"{value:.4f}" for value in experiment.truth))
    terminal.heading("Table 2 of the paper, measured on its rig")
    terminal.table(("scheme", *units), [(scheme, *map(_value, row)) for scheme, row in TABLE_2.items()])
    for title, way in (
        ("The same by this project", "ours"),
        ("The same by the paper's equations as printed", "printed"),
    ):
        terminal.heading(f"{title}: median of {experiment.runs} simulated runs")
        rows = [(scheme, *map(_value, found(experiment, way, scheme))) for scheme in TABLE_2]
        terminal.table(("scheme", *units), [*rows, truth])

    terminal.heading("Median error (worst of all runs) in %")
    rows = [
        (f"{scheme}, {way}", *_errors(experiment, way, scheme)) for scheme in TABLE_2 for way in ("ours", "printed")
    ]
    terminal.table(("scheme", *PARAMETERS), rows)
    for scheme in ("hamiltonian", "filtered_hamiltonian"):
        lender = scheme.replace("hamiltonian", "dynamic")
        terminal.say(
            f"given the same inertia, {scheme} differs from {lender} by {100 * experiment.disagreement(scheme):.1g} %"
        )

    terminal.heading("What each care buys: largest median error of any parameter in %")
    rows = [
        (way.text, *(f"{100 * experiment.score(way.id, scheme).median.max():.2g}" for scheme in TABLE_2))
        for way in WAYS
    ]
    terminal.table(("way", *TABLE_2), rows)


def found(experiment: Experiment, way: str, scheme: str) -> list[float | None]:
    """Median estimates; None where the scheme was given its inertia, as in the paper."""
    estimates = experiment.score(way, scheme).theta.tolist()
    given = [way == "printed" and value is None for value in TABLE_2[scheme]]
    return [None if known else estimate for known, estimate in zip(given, estimates, strict=True)]


def _value(value: float | None) -> str:
    return "given" if value is None else f"{value:.4f}"


def _errors(experiment: Experiment, way: str, scheme: str) -> list[str]:
    score = experiment.score(way, scheme)
    return [f"{100 * median:.2g} ({100 * worst:.2g})" for median, worst in zip(score.median, score.worst, strict=True)]
