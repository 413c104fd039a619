"""Plots of measured and modelled motion over time: torque and free runs, or servos simulated from their goals."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from estimators.data.preparation import find_preparation
from estimators.signals.residual import AXES, makes_whole_turns, wrap_angles
from estimators.simulation.free_running import HORIZON, Segments, sample_free_runs
from pendulum_env._typing import JSON, Array, Mask
from pendulum_env.formatting import TextTable, capitalise, format_number, typeset
from pendulum_env.recording import Recording
from pendulum_env.units import to_shown_unit
from workbench import figure as plots
from workbench.narrator.diagnosis import describe_result
from workbench.narrator.parts import Content, Part
from workbench.narrator.results import narrate_next_step, narrate_unexplained
from workbench.report.data import ReportData, Section

COMPARED = 4  # largest number of plotted recordings
MEASURED = 9600  # most points of measured torque: about one for each pixel in three seconds of a recording of 20 s
ROWS = ("position", "torque", "residual", "error of free run")
SIGMAS = ", %{customdata:.1f}σ"  # size of a residual in standard errors by noise
DOTTED = {"color": "--muted", "dash": "dot", "width": 1}  # line of a goal
LOOPS = 8  # largest number of recordings plotted in the loop


@dataclass(frozen=True)
class Course:
    """Windows of one recording at one joint in order of time, with the results of each plotted model.

    Attributes:
        recording: whole recording of the joint.
        at: name of the joint; empty for a pendulum.
        axes: motion in the middle of each window (R,), by the keys of `AXES`.
        is_fitted: whether a window is in the fitted data (R,).
        measured: measured torque, averaged over each window (R,) [N m].
        residuals: measured minus modelled torque of each model, (R,) each [N m].
        segments: segments of free runs for each model; empty for an arm.
    """

    recording: Recording
    at: str
    axes: dict[str, Array]
    is_fitted: Mask
    measured: Array
    residuals: list[Array]
    segments: list[list[Segments]]

    @property
    def title(self) -> str:
        """Return the name of the recording and of the joint."""
        parts = self.at, f"recording {self.recording.name}", "" if self.is_fitted.any() else "held out"
        return ", ".join(filter(None, parts))

    @property
    def error(self) -> float:
        """Return the mean square of the first model's residual [(N m)^2]."""
        return float(np.mean(self.residuals[0] ** 2))


def list_courses(case: ReportData) -> list[Course]:
    """List the courses of all recordings and joints: fitted recordings first, of these the largest error first."""
    groups = dict[tuple[str, int], list[Course]]()
    for part in range(1 if case.data.is_comparison else 2):
        rows = case.data.parts[part].data
        ends = np.cumsum([len(w.centers) for w in rows.windows])[:-1]
        series = rows.torque.applied, *case.compute_residuals(part)
        split = zip(*(np.split(values, ends) for values in series), strict=True)
        for k, (w, (measured, *residuals)) in enumerate(zip(rows.windows, split, strict=True)):
            x, segments = w.select_center_samples(), [[data.segments[k]] for data in case.parts[part] if data.segments]
            axes = {axis: np.asarray(getattr(x, axis)) for axis in AXES}
            is_fitted = np.full(len(measured), part == 0)
            course = Course(w.recording, w.at, axes, is_fitted, measured, residuals, segments)
            groups.setdefault((w.at, id(w.recording)), []).append(course)
    courses = [_join_courses(group) for group in groups.values()]
    shown = (course for course in courses if len(course.measured) > 1)
    return sorted(shown, key=lambda course: (not course.is_fitted.any(), -course.error))


def _join_courses(parts: Sequence[Course]) -> Course:
    """Join the fitted and the held-out windows of one recording and joint."""
    order = np.argsort(np.concatenate([part.axes["time"] for part in parts]), kind="stable")

    def join(series: Iterable[Any]) -> Any:
        return np.concatenate([*series])[order]

    return replace(
        parts[0],
        axes={axis: join(part.axes[axis] for part in parts) for axis in AXES},
        is_fitted=join(part.is_fitted for part in parts),
        measured=join(part.measured for part in parts),
        residuals=[join(of_model) for of_model in zip(*(part.residuals for part in parts), strict=True)],
        segments=[[*chain(*of_model)] for of_model in zip(*(part.segments for part in parts), strict=True)],
    )


def make_comparison(case: ReportData) -> Section:
    """Make the section on raw position, torque, residual and free run over time, the largest residuals first."""
    courses = list_courses(case)
    first = {id(course) for course in {course.at: course for course in reversed(courses)}.values()}  # of each joint
    order = sorted(courses, key=lambda course: id(course) not in first)[: COMPARED * len(first)]
    figures = [Part(course.title, [plot_course(case, course, f"course-{k}")]) for k, course in enumerate(order)]
    how = "Choose a sentence or a shaded stretch: its fitted samples are shaded here, with the worst 3 s in sight."
    about = (
        "Torque of a model and residual are averages over short windows in which the joint moves in one direction; "
        "gaps are rests and reversals."
    )
    if case.diagnosis.model.mechanism.can_simulate:
        about += (
            " Each free run starts from the measured state and lasts "
            f"{case.data.cut.horizon or HORIZON:g} s on the recorded torque alone."
        )
    shown, folded = figures[: len(first)], figures[len(first) :]
    others = [Part(f"Other recordings, {len(folded)}", folded, brief=False)] if folded else []
    return Section("comparison", "Over time", "Measured against modelled, over time", [how, about, *shown, *others])


def plot_course(case: ReportData, course: Course, id: str) -> plots.Figure:
    """Plot position, torque, residual and free run of one recording and joint, with one range and one cursor."""
    units, floor = case.diagnosis.model.units(course.at), case.data.parts[0].floors[course.at]
    (factor, angle), torque = to_shown_unit(1.0, units.unit("rad")), units.unit("N m")
    recording, time, style = course.recording, course.axes["time"], {"color": "--measured", "width": plots.BROAD}
    data = [plots.make_band(time[[0, -1]], np.full(2, 2 * floor), "noise (±2σ)", yaxis="y3")]

    def draw(x: Array, y: Array, place: int, model: tuple[str, str], unit: str, **options: object) -> None:
        """Add the curve of a model, or of the measurement, to one of the rows `ROWS`."""
        readout = f"{ROWS[place]}, {model[0]}: %{{y:.3g}} {typeset(unit)}{options.pop('size', '')}<extra></extra>"
        axis = {"yaxis": f"y{place + 1 if place else ''}", "legendgroup": model[0], "showlegend": place == 1}
        data.append(plots.make_line(x, y, *model, unit) | axis | {"hovertemplate": readout} | options)

    series = [("measured", 0, factor * recording.position, style), ("measured", 1, recording.torque, style)]
    series += [("goal", 0, factor * recording.goal, DOTTED)] if recording.goal is not None else []
    for name, place, values, line in series:
        indices = plots.select_samples(values, MEASURED if place else plots.POINTS)
        x, (y,) = plots.insert_gaps(recording.time, indices, values)
        is_first = place == 1 or name == "goal"
        draw(x, y, place, (name, ""), torque if place else angle, line=line, showlegend=is_first)
    for k, model in enumerate(case.model_labels):
        residual = course.residuals[k]
        x, (measured, error) = plots.insert_gaps(time, plots.select_samples(residual), course.measured, residual)
        draw(x, measured - error, 1, model, torque)
        draw(x, error, 2, model, torque, size=SIGMAS, customdata=plots.round_numbers(error / floor))
        if course.segments:
            last = case.ends[k].model
            x, position, error = sample_free_runs(course.segments[k], last.terms, last.theta, plots.POINTS // 2)
            draw(x, factor * position, 0, model, angle)
            draw(x, factor * error, 3, model, angle)
    titles = [f"{name} [{unit}]" for name, unit in zip(ROWS, (angle, torque, torque, angle), strict=True)]
    layout = plots.make_stacked_layout(titles[: 4 if course.segments else 3])
    reach = max(plots.measure_reach(residual, 2 * floor) for residual in course.residuals)
    layout["yaxis3"]["range"] = [-reach, reach]
    beyond = {"rangemode": "fixed", "range": [1e9, 2e9]}  # of the whole, the slider shows the residual alone
    slider = {f"yaxis{row}": beyond for row in ("", 2, 4)}
    layout["xaxis"]["rangeslider"] = {"visible": True, "thickness": 0.06, **slider}
    layout["meta"] = describe_course(case, course)
    return plots.Figure(id, f"Measured and modelled position and torque over time, {course.title}", data, layout, 720)


def describe_course(case: ReportData, course: Course) -> JSON:
    """Describe the fitted windows of a course in displayed units, for scripts that find the samples of a region."""
    units, axes, time = case.diagnosis.model.units(course.at), dict(course.axes), course.recording.time
    if makes_whole_turns(np.asarray(case.data.parts[0].data.part(course.at).samples.position)):
        axes["position"] = wrap_angles(axes["position"])
    shown = {axis: to_shown_unit(values, units.unit(AXES[axis]))[0] for axis, values in axes.items()}
    return {
        "turn": to_shown_unit(2 * np.pi, units.unit("rad"))[0] if course.segments and not units.is_prismatic else 0,
        "recording": [course.recording.name, time[0]],  # the same for all joints
        "joint": course.at,
        "axes": {axis: plots.round_numbers(values[course.is_fitted]) for axis, values in shown.items()},
        "residuals": [plots.round_numbers(residual[course.is_fitted]) for residual in course.residuals],
    }


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
            time = recording.time - recording.time[0]
            lines.insert(0, plots.make_line(time, factor * recording.goal, "goal", "", unit, line=DOTTED))
        x_axis, y_axis = plots.make_axis("time [s]"), plots.make_axis(f"position [{unit}]")
        layout: JSON = {"title": {"text": name}, "xaxis": x_axis, "yaxis": y_axis}
        layout |= {"hovermode": "x unified", "meta": {"turn": 0 if case.units.is_prismatic else factor * 2 * np.pi}}
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
