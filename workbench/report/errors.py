"""The fall of the error, step by step."""

from textwrap import wrap

import numpy as np

from estimators.selection.criterion import Criterion
from estimators.selection.data import PreparedData
from pendulum_env._typing import JSON
from pendulum_env.words import name, number
from workbench.report.case import Case
from workbench.report.figure import Figure, Section, axis, line

PARTS = (("train", "fitted data", "--train", "circle-open"), ("holdout", "held-out data", "--measured", "circle"))


def errors(case: Case) -> Section:
    """Errors after every step: table, and plot where there is more than one."""
    steps = case.diagnosis.steps
    content = {
        "steps": steps,
        "noise_floor": case.diagnosis.noise_floor,
        "whiteness": [
            whiteness(f"{label}, {part}", case, prepared, k)
            for k, (label, _, _) in enumerate(case.models)
            for part, prepared in zip(("fitted", "held out"), case.data.parts, strict=True)
        ],
        "figures": [
            ladder(case, "torque_rms", "torque error [N m]", case.diagnosis.noise_floor),
            ladder(case, "position_rms", "free-running position error [rad]", None),
        ]
        if len(steps) > 1
        else [],
    }
    return Section("errors", "Errors", "How the error falls", content)


def whiteness(label: str, case: Case, prepared: PreparedData, drawn: int) -> tuple[str, float, float, str]:
    """Test of the residual of a drawn model for correlation between neighbours, beyond what their overlap gives.

    Label, what they share [N m], the same in standard errors of white noise, and what that means.
    """
    residual, model = case.residuals(prepared)[drawn], case.models[drawn][2]
    shared, significance, _ = prepared.data.structure(residual, abs(model.estimates["inertia"].value))
    small = ", by less than noise is" if shared < case.diagnosis.noise_floor else ": something is left"
    return label, shared, significance, "white" if significance < Criterion().sure else f"not white{small}"


def ladder(case: Case, quantity: str, title: str, floor: float | None) -> Figure:
    """One kind of error over the steps, on a logarithmic axis."""
    steps = case.diagnosis.steps
    labels = ["base model", *(f"+ {name(step.added)}" for step in steps if step.added)]
    data: list[JSON] = []
    values = []
    shades = ["--base", *["--between"] * (len(steps) - 2), "--final"]
    for part, label, color, symbol in PARTS:
        error = np.array([getattr(step.errors[part], quantity) for step in steps])
        values += [*error]
        marker = {"color": shades, "size": 10, "symbol": symbol}
        data.append(line(np.arange(float(len(steps))), error, label, color, "", mode="lines+markers", marker=marker))
    if floor is not None:
        values.append(floor)
        dashed = {"color": "--muted", "width": 1.5, "dash": "dash"}
        data.append(line(np.array([-0.3, len(steps) - 0.7]), np.full(2, floor), "noise floor", "", "", line=dashed))
    low, high = np.log10(min(values)) - 0.12, np.log10(max(values)) + 0.12
    marks = np.array([1, 2, 5] if high - low < 2 else [1]) * 10.0 ** np.arange(-15, 7)[:, None]  # 1-2-5 or decades
    ticks = [float(mark) for mark in marks.ravel() if low <= np.log10(mark) <= high]
    layout = {
        "xaxis": axis(
            "",
            tickvals=list(range(len(steps))),
            ticktext=["<br>".join(wrap(label, 14)) for label in labels],  # characters of a label's line
            ticklabeloverflow="allow",
            range=[-0.3, len(steps) - 0.7],
            showgrid=False,
            zeroline=False,
        ),
        "yaxis": axis(title, type="log", range=[low, high], tickvals=ticks, ticktext=[number(t) for t in ticks]),
    }
    return Figure(f"ladder-{quantity}", f"{title} after every step", data, layout, 320)
