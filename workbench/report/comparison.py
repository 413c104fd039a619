"""Plots of measured and modelled torque and position: free motion, or servos simulated from their goals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.data.preparation import find_preparation
from estimators.decisions.errors import get_single
from estimators.simulation.free_running import HORIZON, Segments, simulate_errors
from pendulum_env._typing import Array
from pendulum_env.formatting import TextTable, capitalise, format_number
from workbench import figure as plots
from workbench.narrator.diagnosis import describe_result
from workbench.narrator.parts import Content, Part
from workbench.narrator.results import narrate_next_step, narrate_unexplained
from workbench.report.data import ReportData, Section

COMPARED = 4  # largest number of plotted recordings
LOOPS = 8  # largest number of recordings plotted in the loop


def make_comparison(case: ReportData) -> Section:
    """Make the section on torque and position of held-out recordings, largest errors first."""
    prepared = case.data.parts[1]
    residuals = case.compute_residuals(1)
    ends = np.cumsum([len(w.centers) for w in prepared.data.windows])[:-1]
    split = [np.split(residual, ends) for residual in residuals]
    torque = np.split(prepared.data.torque.applied, ends)
    noise = get_single(case.diagnosis.floors)
    usable = [k for k, w in enumerate(prepared.data.windows) if len(w.centers) > 1]
    order = sorted(usable, key=lambda k: -float(np.mean(split[0][k] ** 2)))[:COMPARED]
    runs: list[Part] = []
    for k in order:
        name, time = prepared.recordings[k].name, np.asarray(prepared.data.windows[k].select_center_samples().time)
        errors = [part[k] for part in split]
        position = plot_position(case, f"position-{k}", [part.segments[k] for part in case.parts[1]])
        torque_plot = plot_torque(case, f"torque-{k}", f"recording {name}", time, torque[k], errors, noise)
        runs += [Part(f"Torque, {name}", [torque_plot]), Part(f"Position in free run, {name}", [position])]
    held_out = "Held-out data. " * (not case.data.is_comparison)
    about = (
        f"{held_out}Torque is averaged over short windows clear of stick; gaps are where the joint stuck or turned. "
        "Each simulation of the position starts from the measured state and then runs "
        f"freely for {case.data.cut.horizon or HORIZON:g} s on the recorded torque alone."
    )
    other_runs = [Part(f"Other recordings, {len(order) - 1} of {len(usable) - 1}", runs[2:], brief=False)]
    content: Content = [about, *runs[:2], *other_runs[: len(order) - 1]]
    return Section("comparison", "Comparison", "Measured against modelled", content)


def plot_torque(
    case: ReportData, id: str, subject: str, time: Array, torque: Array, residuals: Sequence[Array], noise: float
) -> plots.Figure:
    """Plot the torque of one recording in its windows (N,) [N m], above the residual (N,) of each model."""
    x, (measured, *differences) = plots.insert_gaps(time, plots.select_samples(residuals[0]), torque, *residuals)
    modelled = [measured - difference for difference in differences]
    label = f"Measured and modelled torque over time, and their difference, {subject}"
    names = ("torque", "residual", case.units.unit("N m"))
    figure = plots.plot_before_and_after(id, label, x, measured, case.model_labels, modelled, differences, names)
    figure.data.insert(0, plots.make_band(time[[0, -1]], np.full(2, 2 * noise), "noise (±2σ)", yaxis="y2"))
    reach = max(plots.measure_reach(difference, 2 * noise) for difference in differences)
    figure.layout["yaxis2"]["range"] = [-reach, reach]
    return figure


def plot_position(case: ReportData, id: str, segments_of_models: Sequence[Segments]) -> plots.Figure:
    """Plot the position of one recording and free-running simulations from measured states.

    `segments_of_models`: the segments of the recording for each model of the case, with its initial states.
    """
    segments = segments_of_models[0]
    # plotted points of each window
    seconds = (len(segments.position) - 1) / segments.windows.recording.rate
    points = int(np.clip(2 * plots.POINTS // len(segments.first), 10, 80 * max(1.0, seconds)))
    step = max(1, (len(segments.position) - 1) // points)
    at = np.arange(0, len(segments.position), step)
    recording = segments.windows.recording
    start = recording.time[segments.first]
    x = plots.join_arrays(list((start + at[:, None] / recording.rate).T))
    measured = plots.join_arrays(list(segments.position[at].T))
    models = zip(segments_of_models, (step.model for step in case.ends), strict=True)
    errors = [
        plots.join_arrays(list(simulate_errors(segments_of_model, m.terms, m.theta)[at].T))
        for segments_of_model, m in models
    ]
    simulated = [measured + error for error in errors]
    label = f"Measured position and free-running simulation over time, recording {recording.name}"
    factor, unit = case.angle
    names, measured = ("position", "error", unit), factor * measured
    above, below = [factor * values for values in simulated], [factor * values for values in errors]
    figure = plots.plot_before_and_after(id, label, x, measured, case.model_labels, above, below, names)
    dots = {"color": "--measured", "size": 5}
    options = {"mode": "markers", "marker": dots, "hoverinfo": "skip", "hovertemplate": None}
    position = factor * segments.position[0]
    figure.data.append(plots.make_line(start, position, "start of a window", "--measured", "", **options))
    return figure


def make_loop(case: ReportData, headline: str) -> Section:
    """Make the section on simulations in the loop: errors and motion, held-out recordings first."""
    recordings = case.data.all_recordings
    loops = [find_preparation(recordings).simulate(step.model, recordings) for step in case.ends]
    fitted, (factor, unit) = len(case.data.recordings), case.angle
    rows, figures = [], list[plots.Figure]()
    for k, recording in sorted(enumerate(case.data.all_recordings), key=lambda item: item[0] < fitted):
        name = recording.name if k < fitted else f"{recording.name} (held out)"
        motions = [loop.select_recording(k) for loop in loops]
        errors = [factor * float(np.mean(np.abs(motion.error))) for motion in motions]
        rows.append((name, *(format_number(error, padded=True) for error in errors)))
        if len(figures) >= LOOPS:
            continue
        lines = [plots.make_line(motions[0].time, factor * motions[0].measured, "measured", "--measured", unit)]
        for (label, color), motion in zip(case.model_labels, motions, strict=True):
            lines.append(plots.make_line(motion.time, factor * motion.simulated_position, label, color, unit))
        if recording.goal is not None:
            dotted = {"color": "--muted", "dash": "dot", "width": 1}
            time = recording.time - recording.time[0]
            lines.insert(0, plots.make_line(time, factor * recording.goal, "goal", "", unit, line=dotted))
        x_axis, y_axis = plots.make_axis("time [s]"), plots.make_axis(f"position [{unit}]")
        layout = {"title": {"text": name}, "xaxis": x_axis, "yaxis": y_axis}
        label = f"{name}: goal, measured and simulated position"
        figures.append(plots.Figure(f"loop-{len(figures)}", label, lines, layout))
    content: Content = [
        "Whole recordings are simulated with the controller in the loop: all that is known is the goal. The error is "
        "the mean distance of the simulated from the measured position.",
        TextTable(("recording", *(f"{label} [{unit}]" for label, _ in case.model_labels)), rows),
        *figures,
    ]
    return Section("loop", "In the loop", capitalise(headline), content)


def make_loop_diagnosis(case: ReportData) -> Section:
    """Make the section on a diagnosis in the loop: simulations, residual and next step."""
    diagnosis = case.diagnosis
    section = make_loop(case, describe_result(diagnosis))
    return replace(section, content=[*section.content, *narrate_unexplained(diagnosis), *narrate_next_step(diagnosis)])
