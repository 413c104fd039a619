"""Plots of the residual over angle, velocity, torque, time and frequency."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from estimators.data.regions import find_regions_at
from estimators.signals.residual import REGIONS, SYMBOLS, WITHIN, Profile, Region, compute_profiles
from estimators.weak_form.resolution import RESOLUTION
from pendulum_env._typing import JSON
from pendulum_env.formatting import format_percent
from pendulum_env.units import JointUnits, to_shown_unit
from workbench.figure import Figure, make_axis, make_band, make_line
from workbench.narrator.diagnosis import describe_region
from workbench.narrator.parts import Legend, Part
from workbench.report.data import ReportData, Section

TITLES = {  # name and symbol of an axis
    "position": ("angle", " q"),
    "velocity": ("velocity", " q'"),
    "torque": ("torque", " τ"),
    "time": ("time", " t"),
    "frequency": ("frequency", ""),
}
SHOWN = ("position", "velocity", "time")  # axes plotted for a joint of an arm
QUARTERS = ["−π", "−π/2", "0", "π/2", "π"]

Curve = tuple[str, str]  # label and colour of a model


def make_failures(case: ReportData) -> Section:
    """Make the section on the residuals of the first and the final model in the fitted data, joint by joint."""
    prepared, curves, body = case.data.parts[0], case.model_labels, case.diagnosis.model.mechanism
    residuals, axes = case.compute_residuals(0), tuple(SYMBOLS) if body.can_simulate else SHOWN
    strips, stands_out = list[Part](), [False] * len(residuals)
    for k, joint in enumerate(prepared.floors):
        x, rows = prepared.data.part(joint).samples, prepared.data.locate_rows(joint)
        noise, units = prepared.floors[joint], prepared.units(joint)
        maps = [compute_profiles(x, residual[rows], noise, axes, units) for residual in residuals]
        regions = [find_regions_at(prepared, residual, joint, axes) for residual in residuals]
        stands_out = [is_visible or bool(region) for is_visible, region in zip(stands_out, regions, strict=True)]
        reach = 1.08 * max(float(np.abs(p.mean).max()) for m in maps for p in m if p.axis != "frequency")
        final_regions = regions[-1] if len(regions) > 1 else []
        name = f"joint-{k}" if joint else "profile"
        figures = [
            plot_profile(curves, profiles, regions[0], final_regions, reach, name)
            for profiles in zip(*maps, strict=True)
        ]
        strips.append(Part(joint, [tuple(figures), *list_regions(curves, regions)]))
    negligible = format_percent(RESOLUTION.width.negligible)
    threshold = f" by more than {negligible} of the joint's torque" * (not body.can_simulate)
    remark = "; amplitudes over frequency have their own" * body.can_simulate
    scales = (
        "The residual torque, averaged over bins of each quantity, on the data that were fitted. The grey band is "
        f"the noise floor ({REGIONS.z_limit:g} standard errors); a shaded stretch is where the residual stands out "
        f"of it{threshold}. Means share one scale{remark}."
    )
    content: list[Any] = [scales, make_legend(curves, stands_out[0], len(stands_out) > 1 and stands_out[-1])]
    content += strips[0].content if body.can_simulate else strips
    return Section("failures", "Where it fails", "Where the model fails", content)


def list_regions(
    curves: Sequence[Curve], regions_of_models: Sequence[Sequence[Region]]
) -> Iterator[str | tuple[str, ...]]:
    """Yield a heading and the significant regions of the residual for each model."""
    for (label, _), regions in zip(curves, regions_of_models, strict=False):
        yield f"Under the {label}{':' if regions else ', the residual is within the noise.'}"
        yield tuple(describe_region(region) for region in regions)


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
    curves: Sequence[Curve],
    profiles: Sequence[Profile],
    regions: Sequence[Region],
    final_regions: Sequence[Region],
    reach: float,
    name: str = "profile",
) -> Figure:
    """Plot the mean residual of each model over one quantity up to `reach` [N m], with noise band and regions.

    `regions`: of the first model, `final_regions`: of another last model, `name`: prefix of the figure's id.
    """
    first, unit = profiles[0], profiles[0].units.unit("N m")
    (edges, unit_of_axis), (factor, _) = to_shown_unit(first.edges, first.unit), to_shown_unit(1.0, first.unit)
    middle = 0.5 * (edges[1:] + edges[:-1])
    oscillates = first.axis == "frequency"
    data = [make_band(middle, REGIONS.z_limit * first.error, f"noise (±{REGIONS.z_limit:g}σ)")]
    for (label, color), profile in zip(curves, profiles, strict=True):
        mode = "lines" if oscillates else "lines+markers"
        data.append(make_line(middle, profile.mean, label, color, unit, mode=mode))
    half = 0.5 if final_regions else 0.0  # two kinds of stripes share the height
    shapes = [draw_stripe(r, "--region", half, 1.0, factor) for r in regions if r.axis == first.axis]
    shapes += [draw_stripe(r, "--open", 0.0, half, factor) for r in final_regions if r.axis == first.axis]
    quantity, symbol = TITLES[first.axis]
    title = f"{first.units.name(quantity)}{symbol} [{unit_of_axis}]"
    label_of_y = f"{'amplitude' if oscillates else 'mean residual'} [{unit}]"
    layout: JSON = {
        "xaxis": make_angle_axis(first.units) if first.unit == WITHIN else make_axis(title),
        "yaxis": make_axis(label_of_y, **({"rangemode": "tozero"} if oscillates else {"range": [-reach, reach]})),
        "shapes": shapes,
        "showlegend": False,
        "margin": {"t": 16},
    }
    if oscillates:
        layout["yaxis"]["range"] = [0, 1.08 * max(float(np.max(p.mean)) for p in profiles)]
    return Figure(f"{name}-{first.axis}", f"Residual torque against {first.axis}", data, layout, 290)


def make_angle_axis(units: JointUnits) -> JSON:
    """Make the axis of an angle wrapped to one turn."""
    half, unit = to_shown_unit(np.pi, units.unit("rad"))
    ends = {"tickvals": [half * share for share in (-1, -0.5, 0, 0.5, 1)]}
    return make_axis(
        f"{units.name('angle')} q, wrapped [{unit}]", **ends, **({"ticktext": QUARTERS} if unit == "rad" else {})
    )


def draw_stripe(region: Region, color: str, low: float, high: float, factor: float = 1.0) -> JSON:
    """Make the rectangle over a region, from `low` to `high` in shares of the height; `factor` scales the axis."""
    return {
        "type": "rect",
        "layer": "below",
        "yref": "paper",
        "x0": factor * region.low,
        "x1": factor * region.high,
        "y0": low,
        "y1": high,
        "fillcolor": color,
        "line": {"width": 1, "color": "--page"},  # separates neighbours
    }
