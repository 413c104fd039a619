"""Plots of the residual over angle, velocity, torque and time, and its spectra over time and angle."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from estimators.data.regions import compute_profiles_at
from estimators.data.regression_data import RegressionData
from estimators.signals.residual import (
    REGIONS,
    SYMBOLS,
    WITHIN,
    Profile,
    Region,
    find_regions,
    find_runs,
    remove_strongest,
    split_regions,
)
from estimators.weak_form.resolution import RESOLUTION
from pendulum_env._typing import JSON, Array
from pendulum_env.formatting import format_percent
from pendulum_env.units import JointUnits, to_shown_unit
from workbench.figure import Figure, make_axis, make_band, make_line, measure_reach
from workbench.narrator.diagnosis import describe_region
from workbench.narrator.parts import Legend, Part, Place
from workbench.report.data import ReportData, Section

TITLES = {  # name and symbol of an axis
    "position": ("angle", " q"),
    "velocity": ("velocity", " q̇"),
    "torque": ("torque", " τ"),
    "time": ("time", " t"),
    "frequency": ("frequency", ""),
    "order": ("order", ""),
}
SHOWN = ("position", "velocity", "time")  # axes plotted for a joint of an arm
QUARTERS = ["−π", "−π/2", "0", "π/2", "π"]
FIRST = 3  # number of regions above the fold
FAINT = 0.4  # opacity of the stripe of a region without a residual; that of a mean at the end of the axis is 1
HALF = 0.5  # share of the residual from which a dependence on one quantity explains it

DOTS = "residual"  # label of the curve that is drawn as dots, without shaded stretches

Curve = tuple[str, str]  # label and colour of a model


def make_failures(case: ReportData) -> Section:
    """Make the section on the residuals of the first and the final model in the fitted data, joint by joint."""
    prepared, curves, body = case.data.parts[0], case.model_labels, case.diagnosis.model.mechanism
    residuals, axes = case.compute_residuals(0), tuple(SYMBOLS) if body.can_simulate else SHOWN
    strips, stands_out = list[Part](), [False] * len(residuals)
    for number, joint in enumerate(prepared.floors):
        maps = [compute_profiles_at(prepared, residual, joint, axes) for residual in residuals]
        stands_out = [seen or bool(find_regions(m)) for seen, m in zip(stands_out, maps, strict=True)]
        reach = max(measure_reach(p.mean, p.band) for profiles in maps for p in profiles if not p.is_spectrum)
        name = f"joint-{number}" if joint else "profile"
        of_axes = [[p for profiles in maps for p in profiles if p.axis == first.axis] for first in maps[0]]
        figures = [plot_profile(curves, profiles, reach, name, joint) for profiles in of_axes]
        parts = [
            part
            for k, (label, _) in enumerate(curves)
            for part in list_regions(label, k, maps[k], prepared, residuals[k], joint)
        ]
        strips.append(Part(joint, [tuple(figures), *parts]))
    negligible = format_percent(RESOLUTION.width.negligible)
    least = f", at least {negligible} of the joint's torque" * (not body.can_simulate)
    remark = "; amplitudes have their own" * body.can_simulate
    scales = (
        "The residual torque, averaged over bins of each quantity, on the data that were fitted. The grey band is "
        f"the noise floor ({REGIONS.z_limit:g} standard errors{least}). A shaded stretch is where the mean of a bin "
        f"leaves its band, the darker the larger. Means share one scale{remark}."
    )
    content: list[Any] = [scales, make_legend(curves, stands_out[0], len(stands_out) > 1 and stands_out[-1])]
    content += strips[0].content if body.can_simulate else strips
    title = "Where the model fails" if any(stands_out) else "The model fails nowhere above the noise"
    return Section("failures", "Where it fails", title, content)


def list_regions(
    label: str, number: int, profiles: Sequence[Profile], data: RegressionData, residual: Array, joint: str
) -> Iterator[str | tuple[str, ...] | Part]:
    """Yield a heading and the regions of profiles at a joint for the model of a number, the first above a fold.

    A further fold has the regions of the residual (R,) without its strongest profile.
    """
    texts, spectral = (
        [Place(describe_region(r), locate_region(r, joint, number)) for r in own] for own in split_regions(profiles)
    )
    yield f"Under the {label}{':' if texts else ', the residual is within the noise.'}"
    yield tuple(texts[:FIRST])
    if texts[FIRST:]:
        title = f"Further regions under the {label}, {len(texts) - FIRST} of {len(texts)}"
        yield Part(title, [tuple(texts[FIRST:])], brief=False)
    if spectral:
        yield Part(f"The same residual as oscillations, {len(spectral)}", [tuple(spectral)], brief=False)
    if texts:
        rows = data.locate_rows(joint)
        top, rest = remove_strongest(profiles, data.data.part(joint).samples, residual[rows])
        share = 1 - float(rest @ rest) / float(residual[rows] @ residual[rows])
        remaining = residual.copy()
        remaining[rows] = rest
        axes = [profile.axis for profile in profiles]
        left = [describe_region(r) for r in split_regions(compute_profiles_at(data, remaining, joint, axes))[0]]
        name = "strongest oscillation" if top.is_spectrum else f"dependence on {top.units.name(TITLES[top.axis][0])}"
        title = f"What remains under the {label} without its {name}"
        explained = f"The {name} explains {format_percent(share)} of the residual's mean square, without a refit."
        if share < HALF:
            yield f"{explained} No single quantity explains most of it."
        yield Part(title, [explained, tuple(left) or "The rest is within the noise."], brief=False)


def locate_region(region: Region, joint: str, number: int) -> JSON:
    """Return the place of a region in displayed units, for scripts: axis, ends, joint and number of the model."""
    factor = to_shown_unit(1.0, region.unit)[0]
    axis = {"axis": "" if region.is_constant else region.axis, "low": factor * region.low, "high": factor * region.high}
    return {**axis, "joint": joint, "model": number}


def make_legend(curves: Sequence[Curve], regions: bool, final_regions: bool) -> Legend:
    """Make the legend of curves, noise band, and stripes of the first (`regions`) and last model (`final_regions`)."""
    entries = [("stroke", color, label) for label, color in curves]
    entries.append(("patch", "--noise", f"noise (±{REGIONS.z_limit:g}σ)"))
    if regions:
        entries.append(("patch", "--region", f"stands out under the {curves[0][0]}"))
    if final_regions:
        entries.append(("patch", "--open", f"stands out under the {curves[-1][0]}"))
    return Legend(tuple(entries))


def plot_profile(
    curves: Sequence[Curve], profiles: Sequence[Profile], reach: float, name: str = "profile", joint: str = ""
) -> Figure:
    """Plot the mean residual of each model over one quantity up to `reach` [N m], with noise bands and runs.

    `name`: prefix of the figure's id; `joint`: of the residual.
    """
    first = profiles[0]
    factor, unit = to_shown_unit(1.0, first.unit)
    quantity, symbol = TITLES[first.axis]
    axis = make_axis(f"{first.units.name(quantity)}{symbol} [{unit}]")
    axis, unit = make_angle_axis(first.units) if first.unit == WITHIN else axis, first.units.unit("N m")
    bands = {len(profile.band): profile for profile in profiles}.values()  # bins of another model may differ
    label, has_dots = f"noise (±{REGIONS.z_limit:g}σ)", curves[0][0] == DOTS
    data = [make_band(factor * profile.middle, profile.band, label) for profile in bands]
    for (label, color), profile in zip(curves, profiles, strict=False):
        mode = "lines" if first.is_spectrum or has_dots else "lines+markers"
        mode = "markers" if label == DOTS else mode
        marker = {"size": 6 if len(profile.mean) <= REGIONS.bins else 3, "color": color}
        readout = f"{unit} at %{{x:.3g}} {to_shown_unit(1.0, first.unit)[1]}"
        data.append(make_line(factor * profile.middle, profile.mean, label, color, readout, mode=mode, marker=marker))
    runs = [find_runs(profile) if not has_dots else [] for profile in profiles]
    half = 0.5 if len(runs) > 1 and runs[-1] else 0.0  # two kinds of stripes share the height
    kinds = [(0, ("--region", half, 1.0)), *([(len(runs) - 1, ("--open", 0.0, half))] if half else [])]
    title = f"{'amplitude' if first.is_spectrum else 'mean residual'} [{unit}]"
    height = max(measure_reach(profile.mean, profile.band) for profile in profiles) if first.is_spectrum else reach
    shapes = [
        {**draw_stripe(locate_region(r, joint, k), *look), "opacity": FAINT + (1 - FAINT) * abs(r.residual) / height}
        for k, look in kinds
        for r in runs[k]
    ]
    layout: JSON = {
        "xaxis": axis,
        "yaxis": make_axis(title, range=[0 if first.is_spectrum else -height, height]),
        "shapes": shapes,
        "showlegend": False,
        "margin": {"t": 16},
        "hovermode": "x",
        "hoverdistance": -1,
    }
    return Figure(f"{name}-{first.axis}", f"Residual torque against {first.axis}", data, layout, 290)


def make_angle_axis(units: JointUnits) -> JSON:
    """Make the axis of an angle wrapped to one turn."""
    half, unit = to_shown_unit(np.pi, units.unit("rad"))
    ends = {"tickvals": [half * share for share in (-1, -0.5, 0, 0.5, 1)]}
    return make_axis(
        f"{units.name('angle')} q, wrapped [{unit}]", **ends, **({"ticktext": QUARTERS} if unit == "rad" else {})
    )


def draw_stripe(where: JSON, color: str, low: float, high: float) -> JSON:
    """Make the rectangle over the place of a region, from `low` to `high` in shares of the height."""
    return {
        "type": "rect",
        "layer": "below",
        "yref": "paper",
        "x0": where["low"],
        "x1": where["high"],
        "y0": low,
        "y1": high,
        "fillcolor": color,
        "line": {"width": 1, "color": "--page"},  # separates neighbours
        "name": json.dumps(where),
    }
