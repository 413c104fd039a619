"""`paper`: the source paper's experiment, repeated on a pendulum whose parameters are known."""

import argparse
from itertools import product

from estimators.paper import PARAMETERS, TABLE_2, WAYS, Experiment, paper_experiment
from estimators.paper.experiment import RUNS, SECONDS
from pendulum_env.plant import paper_plant
from workbench.inputs import check_outputs, write_json, write_page, wrote
from workbench.options import declare, number, whole
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare runs, seed and outputs."""
    declare(
        parser,
        f"""
        --runs  with random phases (default {RUNS})
        --seconds  length of each (default {SECONDS:g})
        --seed  of phases and noise (default 0)
        --report  write Table 2 and figures 2 to 9 as one page
        --json FILE  write all numbers
        """,
        runs=(whole(1, 10_000), RUNS),
        seconds=(number(5.0, 600.0), SECONDS),
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Run the experiment, print Table 2 and what each care buys, write what was asked for."""
    outputs = [arguments.report, arguments.json]
    check_outputs(outputs)
    with terminal.progress("the paper's experiment") as progress:
        experiment = paper_experiment(arguments.runs, arguments.seconds, arguments.seed, progress=progress)
    write_json(arguments.json, experiment.json())
    write_page(arguments.report, terminal, "workbench.report.paper:render", experiment)
    tell(experiment, terminal)
    wrote(outputs, terminal)


def tell(experiment: Experiment, terminal: Terminal) -> None:
    """Print the tables of the page."""
    header = ("scheme", *(f"{name} [{paper_plant().estimates[name].unit}]" for name in PARAMETERS))
    terminal.heading("Table 2 of the paper, measured on its rig")
    terminal.table(header, [(scheme, *map(_value, row)) for scheme, row in TABLE_2.items()])
    truth = ("truth of the simulation", *map(_value, experiment.truth.tolist()))
    for title, way in (("this project", "ours"), ("the paper's equations as printed", "printed")):
        terminal.heading(f"The same by {title}: median of {experiment.runs} simulated runs")
        found = {scheme: experiment.score(way, scheme).theta.tolist() for scheme in TABLE_2}
        if way == "printed":  # some are given their inertia, as in the paper
            found = {
                id: [None if TABLE_2[id][k] is None else v for k, v in enumerate(row)] for id, row in found.items()
            }
        terminal.table(header, [*((scheme, *map(_value, row)) for scheme, row in found.items()), truth])

    terminal.heading("Median error (worst of all runs) in %")
    rows = []
    for scheme, way in product(TABLE_2, ("ours", "printed")):
        _, median, worst = experiment.score(way, scheme)
        rows.append(
            (f"{scheme}, {way}", *(f"{100 * m:.2g} ({100 * w:.2g})" for m, w in zip(median, worst, strict=True)))
        )
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


def _value(value: float | None) -> str:
    return "given" if value is None else f"{value:.4f}"
