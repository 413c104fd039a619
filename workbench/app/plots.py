"""Plots of recordings and of columns, for the stage Data."""

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.recording import Recording
from pendulum_env.thinning import thin
from pendulum_env.units import JointUnits
from workbench.figure import Figure, axis, line, stacked


def plot_joints(recording: Recording, k: int, body: Mechanism) -> list[Figure]:
    """Plot the position and torque of a recording over time, of an arm joint by joint."""
    height = {} if len(recording.joints) == 1 else {"height": 260}
    return [
        plot_recording(
            own,
            f"course-{k}-{n}",
            f"{joint}, {recording.name}" if joint else recording.name,
            body.units(joint, recording.units),
            **height,
        )
        for n, (joint, own) in enumerate(zip(recording.names, recording.joints, strict=True))
    ]


def plot_recording(r: Recording, id: str, title: str, units: JointUnits, height: int = 340) -> Figure:
    """Plot the position and torque over time."""
    data, (angle, torque) = [], (units.unit("rad"), units.unit("N m"))
    for series, label, color, unit, where in (
        (r.position, "position", "--final", angle, "y"),
        (r.torque, "torque", "--train", torque, "y2"),
    ):
        kept = thin(series)
        data.append(line(r.time[kept], series[kept], label, color, unit, yaxis=where, showlegend=False))
    layout = stacked(f"position [{angle}]", f"{units.name('torque')} [{torque}]", "time [s]")
    layout["margin"] = {"t": 40}
    layout["title"] = {"text": title, "x": 0, "xref": "paper", "font": {"size": 14}}
    return Figure(id, f"Position and torque over time, {title}", data, layout, height)


def plot_column(k: int, header: str, values: Array, seconds: Array | None) -> Figure:
    """Plot a column over time, over rows while there is no time."""
    x = seconds if seconds is not None and len(seconds) == len(values) else np.arange(len(values), dtype=float)
    kept = thin(np.nan_to_num(values), 300)  # of a plot
    bare = axis("", visible=False, fixedrange=True)
    layout = {
        "xaxis": bare,
        "yaxis": bare,
        "margin": {"l": 2, "r": 2, "t": 2, "b": 2},
        "dragmode": False,
        "showlegend": False,
    }
    data = [line(x[kept], values[kept], header, "--train", "", hoverinfo="skip", hovertemplate=None)]
    return Figure(f"column-{k}", f"Column {header} over {'time' if x is seconds else 'rows'}", data, layout, 54)
