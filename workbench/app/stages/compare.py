"""Compare: measured against modelled, in three views that are linked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import dash
import numpy as np
from dash import ALL, Dash, Input, Output, State, dcc, html
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from estimators.data.regression_data import RegressionData
from estimators.signals.residual import AXES, Region, compute_profiles, find_regions, makes_whole_turns, wrap_angles
from pendulum_env._typing import JSON, Array, Mask
from pendulum_env.formatting import capitalise, format_number
from pendulum_env.physics import Samples
from pendulum_env.recording import Recording
from pendulum_env.thinning import thin
from workbench.app.parts import (
    LINKED,
    label_control,
    list_choices,
    make_dropdown,
    make_fragment,
    make_graph,
    make_panel,
    name_field,
)
from workbench.app.session import Session, Sessions, Stage
from workbench.app.state import State as Work
from workbench.figure import Figure, axis, broken, line, numbers, span
from workbench.narrator.diagnosis import describe_region
from workbench.narrator.effects import find_description
from workbench.narrator.parts import Part, list_figures
from workbench.report.arm import make_strips
from workbench.report.comparison import plot_position, plot_torque
from workbench.report.data import ReportData, list_ends
from workbench.report.failures import draw_planes, plot_profile

GALLERY = Path(__file__).parents[1] / "assets" / "gallery"  # `make pages` draws it
HINT = "Drag a box in any of the plots, or choose a region: the same moments light up in all."
MAP, PHASE, TIME = "map", "phase", "time"
VIEWS = (MAP, PHASE, TIME)
LIT = 1500  # points of a selection that are drawn in one view


@dataclass(frozen=True, eq=False)
class WindowPoints:
    """R windows of one recording under the models that are compared."""

    case: ReportData  # the models, and what they were fitted to
    samples: Samples  # time, position, velocity and torque at the windows' centres (R,), SI
    residuals: tuple[Array, ...]  # measured minus modelled torque of each model (R,) [N m]

    @classmethod
    def of(cls, case: ReportData, recording: Recording) -> WindowPoints:
        """Return the windows of one of the recordings, fitted and held-out ones alike."""
        parts = []
        for prepared in case.data.parts:
            windows, x = prepared.data.windows, prepared.samples
            own = np.repeat([w.recording is recording for w in windows], [len(w.centers) for w in windows])
            series = (x.time, x.position, x.velocity, prepared.data.applied_torque(), *case.compute_residuals(prepared))
            parts.append([values[own] for values in series])
        time, position, velocity, torque, *residuals = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(case, Samples(time, position, velocity, torque), tuple(residuals))

    @property
    def noise(self) -> float:
        """Return the torque error that measurement noise alone gives [N m]."""
        return self.case.diagnosis.noise_floor

    def find_regions(self, shown: int) -> list[Region]:
        """Render the regions with a significant residual of a model."""
        return find_regions(self.samples, self.residuals[shown], self.noise, units=self.case.units)


def make_figures(points: WindowPoints, shown: int, name: str) -> dict[str, Figure]:
    """Make the three views; `shown` is the model whose residual the map shows."""
    x, label = points.samples, points.case.models[shown][0]
    cells, map_layout = draw_planes(x, points.residuals, points.case.units)[shown]
    select = {"dragmode": "select", "margin": {"t": 12, "r": 8}}
    dots, kept = thin(x.velocity, LIT), thin(x.velocity, 2 * LIT)
    picked = _draw_dots(wrap_angles(x.position[dots]), x.velocity[dots], "--text", 2, opacity=0.25, hoverinfo="skip")
    units = points.case.units
    speed = units.unit("rad/s")
    _, (q, v) = broken(x.time, kept, x.position, x.velocity)
    motion = line(q, v, "motion", "--train", speed, line={"color": "--train", "width": 1}, hoverinfo="skip")
    axes = {
        "xaxis": axis(f"{units.name('angle')} q [{units.unit('rad')}]", range=span([x.position])),
        "yaxis": axis(f"velocity q' [{speed}]", range=span([x.velocity])),
        "showlegend": False,
    }
    about = f"Residual torque of the {label} over angle and velocity, {name}"
    return {
        MAP: Figure(MAP, about, [cells, picked], map_layout | select, 380),
        PHASE: Figure(PHASE, f"Phase plane, {name}", [motion], axes | select, 380),
        TIME: _plot_time(points, name),
    }


def _plot_time(points: WindowPoints, name: str) -> Figure:
    """Plot measured and modelled torque above the residuals."""
    time, torque = points.samples.time, points.samples.torque
    drawn = plot_torque(points.case, TIME, name, time, torque, points.residuals, points.noise)
    layout = drawn.layout | {"dragmode": "select", "selectdirection": "h", "hovermode": "closest"}
    # ranges of all of it, so that nothing moves when a selection lights up
    layout["xaxis"]["range"] = span([time], 0.01)
    layout["yaxis"]["range"] = span([torque])
    layout["yaxis2"]["range"] = span(points.residuals)
    return Figure(TIME, drawn.label, drawn.data, layout, 420)


def _draw_dots(x: Array, y: Array, color: str, size: float, **more: object) -> JSON:
    marker = {"color": color, "size": size}
    plain = {"type": "scatter", "mode": "markers", "x": numbers(x), "y": numbers(y), "marker": marker}
    return {**plain, "showlegend": False, **more}


def select_box(x: Samples, view: str, box: Mapping[str, Any]) -> Mask:
    """Select the windows within a box that was drawn in a view; `box` is a range of plotly.js."""
    ranges = {key[0]: sorted(map(float, ends)) for key, ends in box.items() if len(ends) == 2}
    (left, right), (low, high) = (ranges.get(key, [-np.inf, np.inf]) for key in "xy")
    if view == TIME:
        return (x.time >= left) & (x.time <= right)
    angle = wrap_angles(x.position) if view == MAP else x.position
    return (angle >= left) & (angle <= right) & (x.velocity >= low) & (x.velocity <= high)


def select_region(x: Samples, region: Region) -> Mask:
    """Select the windows within a region that stands out, which is not one of frequencies."""
    values: Array = getattr(x, region.axis)
    if region.axis == "position" and makes_whole_turns(values):
        values = wrap_angles(values)
    return (values >= region.low) & (values <= region.high)


def highlight(points: WindowPoints, selected: Mask, shown: int) -> dict[str, list[JSON]]:
    """Draw the traces that each view shows on top of its own for a selection (R,)."""
    at, x, residual = np.flatnonzero(selected), points.samples, points.residuals[shown]
    at = at[thin(residual[at], LIT)] if len(at) else at
    q, v = x.position[at], x.velocity[at]

    def dots(x: Array, y: Array, **more: object) -> JSON:
        return _draw_dots(x, y, "--brush", 4, hoverinfo="skip", name="selected", **more)

    return {
        MAP: [dots(wrap_angles(q), v)],
        PHASE: [dots(q, v)],
        TIME: [dots(x.time[at], x.torque[at]), dots(x.time[at], residual[at], yaxis="y2")],
    }


def show(session: Session) -> list[Component]:
    """Show the choice of recording and model, then the views."""
    state = session.state
    names = [{"label": one.recording.name, "value": one.id} for one in state.loaded]
    models: list[Any] = [{"label": label, "value": k} for k, (label, *_) in enumerate(list_ends(state.ladder))]
    last = len(models) - 1  # the one that the headline is about
    chosen = [  # of an arm, all are drawn, and nothing lights up
        label_control("Residual of the", dcc.RadioItems(models, last, id="of", inline=True, className="pair")),
        html.Button("Clear selection", id="clear", type="button", n_clicks=0, className="action"),
    ]
    recording = label_control("Recording", make_dropdown("shown", names, names[0]["value"], searchable=False))
    return [
        html.Div([recording, html.Div(chosen, hidden=state.robot is not None)], className="fields wide"),
        html.P(HINT, id="selected", className="brushed", role="status", hidden=state.robot is not None),
        dcc.Store(id="lit"),
        html.Div(_show_views(state, names[0]["value"], last), id="views"),
    ]


def _show_views(state: Work, id: str, shown: int) -> list[Component]:
    """Show the regions of a recording that stand out, and three views of it; of an arm, a strip of plots a joint."""
    if state.robot is not None:
        return _show_strips(state, id)
    points, recording = _find_points(state, id), state.recordings[state.loaded.index(state.find(id))]
    drawn = make_figures(points, shown, recording.name)
    map_, phase, time = (
        html.Div(make_graph(drawn[view], html.B(title), LINKED), className="panel")
        for view, title in ((MAP, "Residual map"), (PHASE, "Phase plane"), (TIME, "Over time"))
    )
    return [
        _show_regions(points, shown),
        html.Div([map_, phase], className="columns even"),
        time,
        _show_gallery(state, points, shown),
        _show_free_run(state.standing, recording),
    ]


def _show_strips(state: Work, id: str) -> list[Component]:
    """Show the residuals of a recording, joint by joint, under the ends of the ladder."""
    recording = state.recordings[state.loaded.index(state.find(id))]
    section = make_strips(list_ends(state.ladder), RegressionData.of_arm([recording], state.model.terms))
    parts = []
    for number, strip in enumerate(part for part in section.content if isinstance(part, Part)):
        plots = html.Div([make_graph(figure) for figure in list_figures([strip])], className="grid strip")
        texts = make_fragment(replace(section, id=f"strip-{number}", content=strip.content))
        parts.append(make_panel(strip.title, plots, texts))
    return parts


def _show_free_run(case: ReportData, recording: Recording) -> Component:
    """Show the free-running simulation of a recording: of its held-out part, if it has one."""
    found = ((part, k) for part in reversed(case.data.parts) for k in range(len(part.segments)))
    part, k = next((part, k) for part, k in found if part.segments[k].windows.recording is recording)
    segments = [own.segments[k] for own in case.with_link_states(part)]
    note = "Each simulation starts from the measured state and runs freely for one second on the recorded torque alone."
    return make_panel(
        "Position in free run", html.P(note, className="note"), make_graph(plot_position(case, "flown", segments))
    )


def _show_regions(points: WindowPoints, shown: int) -> Component:
    rows = [
        html.Button(capitalise(describe_region(region)), id={"region": k}, n_clicks=0, type="button", className="link")
        if region.axis != "frequency"
        else capitalise(describe_region(region))
        for k, region in enumerate(points.find_regions(shown))
    ]
    listed = html.Ul([html.Li(row) for row in rows], className="regions-list")
    return make_panel("Where it fails", listed if rows else html.P("The residual is within the noise."))


def _show_gallery(state: Work, points: WindowPoints, shown: int) -> Component:
    """Show the residual beside the residuals that single effects leave, the likeliest first after a diagnosis."""
    names = list_choices()
    found = [one.effect for one in state.diagnosis.candidates] if state.diagnosis is not None else []
    ranked = sorted(names, key=lambda id: found.index(id) if id in found else len(found))
    drawn, curve = (
        compute_profiles(points.samples, points.residuals[shown], points.noise, tuple(AXES), points.case.units),
        points.case.models[shown],
    )
    reach = 1.08 * max(float(np.abs(item.mean).max()) for item in drawn)
    here = [plot_profile([curve[:2]], [item], points.find_regions(shown), (), reach, "here") for item in drawn]
    rows = []
    for id in ranked:
        if (GALLERY / f"{id}.svg").is_file():
            leaves = html.Img(src=f"/assets/{GALLERY.name}/{id}.svg", alt=f"What {names[id]} leaves")
            rows.append(
                html.Li([names[id], html.Div([leaves, html.P(find_description(id).signature, className="note")])])
            )
    return make_panel(
        "What it looks like",
        html.P(
            "The mean residual over angle, velocity, torque and time, with the noise floor. Below, the residual of "
            "each effect in the paper's pendulum. Signs and sizes may differ.",
            className="note",
        ),
        html.Div([make_graph(figure, bar=False) for figure in here], className="grid strip"),
        html.Details([html.Summary("Effects to compare it with"), html.Ul(rows)]),
        className="gallery",
    )


@lru_cache(maxsize=4)  # while the page shows one
def _find_points(state: Work, id: str) -> WindowPoints:
    return WindowPoints.of(state.standing, state.recordings[state.loaded.index(state.find(id))])


def describe_selection(points: WindowPoints, selected: Mask, shown: int) -> str:
    """Describe a selection in words."""
    if not selected.any():
        return "Nothing is in this selection."
    residual, time = points.residuals[shown][selected], points.samples.time[selected]
    mean, rms = float(residual.mean()), float(np.sqrt(np.mean(residual**2)))
    unit = points.case.units.unit("N m")
    return (
        f"{len(time)} of {len(selected)} windows, from {time.min():.3g} to {time.max():.3g} s: residual "
        f"{format_number(mean)} "
        f"{unit} on average, {format_number(rms)} {unit} RMS; noise floor "
        f"{format_number(points.noise)} {unit}."
    )


def connect(app: Dash, sessions: Sessions) -> None:
    """Wire the choice of what is shown, and the brushing."""

    @app.callback(
        Output("views", "children"),
        Output("lit", "data", allow_duplicate=True),
        Output("selected", "children", allow_duplicate=True),
        Input(name_field("shown"), "value"),
        Input("of", "value"),
        State("session", "data"),
        prevent_initial_call=True,
    )
    def choose(recording: str, shown: int, id: str) -> tuple[list[Component], None, str]:
        state = sessions.find_session(id).state
        return _show_views(state, recording, shown), None, HINT

    @app.callback(
        Output("lit", "data"),
        Output("selected", "children"),
        *(Input({"kind": LINKED, "of": view}, "selectedData") for view in VIEWS),
        Input({"region": ALL}, "n_clicks"),
        Input("clear", "n_clicks"),
        State(name_field("shown"), "value"),
        State("of", "value"),
        State("session", "data"),
        prevent_initial_call=True,
    )
    def brush(*values: Any) -> tuple[JSON | None, str]:
        recording, shown, id = values[-3:]
        cause, value = dash.ctx.triggered_id, dash.ctx.triggered[0]["value"]
        if not value:
            raise PreventUpdate
        if cause == "clear":
            return None, HINT
        points, source = _find_points(sessions.find_session(id).state, recording), None
        if "region" in cause:
            selected = select_region(points.samples, points.find_regions(shown)[cause["region"]])
        elif "range" in value:
            source = cause["of"]
            selected = select_box(points.samples, source, value["range"])
        else:
            raise PreventUpdate
        return {"source": source, "traces": highlight(points, selected, shown)}, describe_selection(
            points, selected, shown
        )


STAGE = Stage("compare", "Compare", show, connect=connect)
