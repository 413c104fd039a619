"""Plots of recordings, for the stage Data."""

from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.recording import Recording
from pendulum_env.thinning import thin
from pendulum_env.units import JointUnits
from workbench.figure import Figure, line, stacked


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
