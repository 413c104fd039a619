"""Figure 9: the norm (10) of the torque error of all six models, as the paper takes it and clear of stick."""

from __future__ import annotations

import numpy as np

from estimators.paper import Experiment
from estimators.paper.experiment import SHOWN, Norms
from workbench.report.figure import Figure, axis, numbers
from workbench.report.section import Section
from workbench.report.words import name, opening

COLORS = dict(zip(SHOWN, ("--base", "--final"), strict=True))


def norms(experiment: Experiment) -> Section:
    """Both norms of every model, beside that of the true parameters."""
    found = {way: experiment.norms(way) for way in SHOWN}
    least = min(found["printed"].models, key=lambda scheme: found["printed"].models[scheme])
    content = {
        "norms": found,
        "figures": {way: norm_figure(way, found[way]) for way in SHOWN},
        "least": least,
        "shrunk": 1.0 - float(experiment.found[0]["printed"][least].model.theta[0] / experiment.truth[0]),
        "beats_truth": found["printed"].models[least] < found["printed"].truth,
    }
    return Section("norms", "Figure 9", "The norm of the torque error", content)


def norm_figure(way: str, found: Norms) -> Figure:
    """A dot for each model, and a line where the true parameters are."""
    values = np.array(list(found.models.values()))
    labels = [opening(name(scheme)) for scheme in found.models]
    reach = 1.25 * max(float(np.abs(values - found.truth).max()), 0.005 * found.truth)
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "model",
            "x": numbers(values),
            "y": labels,
            "marker": {"color": COLORS[way], "size": 11},
            "hovertemplate": "%{x:.5g} N m",
        },
        {
            "type": "scatter",
            "mode": "lines",
            "name": "true parameters",
            "x": numbers(np.full(2, found.truth)),
            "y": [labels[0], labels[-1]],
            "line": {"color": "--measured", "width": 1.5, "dash": "dot"},
            "hoverinfo": "skip",
        },
    ]
    layout = {
        "xaxis": axis("L2 norm [N m]", range=[found.truth - reach, found.truth + reach], nticks=6),
        "yaxis": {"autorange": "reversed", "type": "category"},
        "margin": {"l": 130},
    }
    return Figure(f"figure-9-{way}", f"L2 norm of the torque error of six models, {way}", data, layout, 300)
