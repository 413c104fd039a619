"""Section on the recordings: length, rate, use and raw traces."""

import numpy as np

from pendulum_env.formatting import TextTable
from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.recording import Recording
from workbench.figure import Figure, make_line, make_stacked_layout, select_samples
from workbench.report.data import ReportData, Section

DRAWN = 4  # largest number of recordings with traces
HEADERS = ("recording", "length [s]", "rate [Hz]", "samples", "turns", "use")


def make_recordings(case: ReportData) -> Section:
    """Make the section on the recordings."""
    fitted, recordings = len(case.data.recordings), case.data.all_recordings
    use = "fit" if case.data.holdout or case.data.is_comparison else "fit; last 30 % check"
    rows = [
        (recording.name, *measure_recording(recording), use if k < fitted else "check")
        for k, recording in enumerate(recordings)
    ]
    body = case.diagnosis.model.mechanism
    figures = [one for k, recording in enumerate(recordings[:DRAWN]) for one in plot_recording(recording, k, body)]
    table = TextTable(HEADERS, rows, left=("use",))
    return Section("recordings", "Recordings", "The recordings", [table, tuple(figures)])


def measure_recording(recording: Recording) -> tuple[str, str, str, str]:
    """Return length [s], rate [Hz], number of samples and turns of a recording; of an arm the largest turns."""
    turns = float(np.ptp(recording.position, axis=0).max()) / (2 * np.pi)
    samples = f"{len(recording):,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
    return f"{recording.duration:.3g}", f"{recording.rate:.4g}", samples, f"{turns:.2g}"


def plot_recording(recording: Recording, k: int, body: Mechanism) -> list[Figure]:
    """Plot the position and torque of the k-th recording over time, one figure for each joint."""
    figures, height = [], 340 if len(recording.joints) == 1 else 260
    for n, (joint, joint_data) in enumerate(zip(recording.names, recording.joints, strict=True)):
        title, units = f"{joint}, {recording.name}" if joint else recording.name, body.units(joint, recording.units)
        data, (angle, torque) = [], (units.unit("rad"), units.unit("N m"))
        series = [(joint_data.position, "position", "--final", angle, "y")]
        has_torque = bool(np.any(joint_data.torque))
        series += [(joint_data.torque, "torque", "--train", torque, "y2")] * has_torque
        for values, label, color, unit, axis in series:
            indices = select_samples(values)
            data.append(
                make_line(joint_data.time[indices], values[indices], label, color, unit, yaxis=axis, showlegend=False)
            )
        titles = f"position [{angle}]", f"{units.name('torque')} [{torque}]"
        layout = make_stacked_layout(titles[: len(series)])
        layout["margin"] = {"t": 8}
        label = f"Position{' and torque' * has_torque} over time, {title}"
        figures.append(Figure(f"trace-{k}-{n}", label, data, layout, height, title))
    return figures
