"""Whole recordings of servos beside simulations that know nothing but the goal."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.in_loop.fit import followed
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from pendulum_env.words import opening
from workbench.report.case import Case
from workbench.report.figure import DRAWING, Figure, Section, axis, line

COLORS = ("--base", "--final")


def loop(
    headline: str,
    models: Sequence[tuple[str, Model]],
    recordings: Sequence[Recording],
    left: Sequence[str] = (),
    advice: Sequence[str] = (),
) -> Section:
    """Errors of one or two models on every recording, their motion beside what was measured, and what remains to do."""
    rows, figures = [], []
    for number, recording in enumerate(recordings):
        errors, curves = [], []
        for (label, model), color in zip(models, COLORS[-len(models) :], strict=True):
            time, simulated, measured = followed(model, recording)
            errors.append(float(np.mean(np.abs(simulated - measured))))
            curves.append(line(time, simulated, label, color, "rad"))
        rows.append((recording.name, errors))
        if number >= DRAWING.in_loop or recording.reference is None:
            continue
        start = recording.time - recording.time[0]
        lines = [line(time, measured, "measured", "--measured", "rad"), *curves]
        if recording.drive is not None and not recording.drive.acts_on_speed:
            dotted = {"color": "--muted", "dash": "dot", "width": 1}
            lines.insert(0, line(start, recording.reference, "goal", "", "rad", line=dotted))
        layout = {"title": {"text": recording.name}, "xaxis": axis("time [s]"), "yaxis": axis("position [rad]")}
        label = f"{recording.name}: goal, measured and simulated position"
        figures.append(Figure(f"loop-{number}", label, lines, layout))
    content = {
        "labels": [label for label, _ in models],
        "rows": rows,
        "figures": figures,
        "lists": [("Left unexplained", left), ("What to do next", advice)],
    }
    return Section("loop", "In the loop", opening(headline), content)


def of_diagnosis(case: Case) -> Section:
    """The same of the first and the last model of a diagnosis, what was held out first."""
    found = case.diagnosis
    held_out = [replace(recording, name=f"{recording.name} (held out)") for recording in case.data.holdout]
    recordings = [*held_out, *case.data.recordings]
    models = [("base model", found.steps[0].model)]
    if len(found.steps) > 1:
        models.append(("with what was found", found.model))
    left = [region.text for region in found.unexplained]
    return loop(found.headline, models, recordings, left, [found.next_step, *found.remarks])
