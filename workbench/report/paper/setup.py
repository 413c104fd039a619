"""What was done, in brief and with its result; and, at the end of the page, where it departs from the paper."""

from __future__ import annotations

from estimators.paper import PARAMETERS, TABLE_2, Experiment
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.plant import paper_plant
from workbench.report.section import Section

TARGET = 0.01  # median error that every scheme should stay below


def setup(experiment: Experiment) -> Section:
    """The opening: result and experiment."""
    worst = experiment.worst_median("ours")
    good = worst < TARGET
    title = "All six schemes find the paper's pendulum" if good else "Not every scheme finds the paper's pendulum"
    content = {
        "experiment": experiment,
        "good": good,
        "target": TARGET,
        "ours": worst,
        "printed": experiment.worst_median("printed"),
        "disagreement": max(experiment.disagreement(scheme) for scheme in TABLE_2 if "hamiltonian" in scheme),
        "truth": {name: paper_plant().estimates[name] for name in PARAMETERS},
        "rate": experiment.example.rate,
        "counts": COUNTS,
        "noise": TORQUE_NOISE,
    }
    return Section("experiment", "Experiment", title, content)


def departures(experiment: Experiment) -> Section:
    """The slips of the paper, and how to do it again."""
    command = (
        f"pendulum-ident paper --runs {experiment.runs} --seconds {experiment.seconds:g} --seed {experiment.seed} "
        "--report paper.html"
    )
    return Section("departures", "Departures", "Where this departs from the paper", {"command": command})
