"""Tables of what a fleet shows, for the command line and for its page."""

import numpy as np

from pendulum_env.words import Table, plus_minus
from workbench.survey.fleet import Fleet, Series

WEEK = 7.0  # days, over which drifts are told


def effects_table(fleet: Fleet) -> Table:
    """What is missing where, and since when."""
    rows = [
        (one.joint.label, one.effect, f"{one.cases} of {one.of}",
         f"since {one.since:%Y-%m-%d}" if one.since else f"first {one.first:%Y-%m-%d}",
         "" if one.significant else "perhaps by chance")
        for one in fleet.effects
    ]  # fmt: skip
    return Table(("joint", "effect", "cases", "when", ""), rows, left=("effect", "when", ""))


def drifting_table(fleet: Fleet) -> Table:
    """Parameters that drift."""
    rows = [
        (one.joint.label, one.parameter, mean(one), one.unit, change(one), by_chance(one.course.p_value))
        for one in fleet.drifting
    ]
    return Table(("joint", "parameter", "mean", "unit", "a week [%]", "by chance"), rows, left=("parameter", "unit"))


def jumping_table(fleet: Fleet) -> Table:
    """Parameters that are others from a date on."""
    rows = [
        (one.joint.label, one.parameter, f"{one.since:%Y-%m-%d}", change(one), by_chance(one.course.p_value))
        for one in fleet.jumping
    ]
    return Table(("joint", "parameter", "since", "change [%]", "by chance"), rows, left=("parameter", "since"))


def odd_table(fleet: Fleet) -> Table:
    """Joints that differ from their siblings."""
    rows = [
        (one.joint.label, one.parameter, mean(one), plus_minus(one.odd.expected, one.odd.spread), one.unit,
         by_chance(one.odd.p_value))
        for one in fleet.odd
        if one.odd is not None
    ]  # fmt: skip
    return Table(("joint", "parameter", "mean", "expected", "unit", "by chance"), rows, left=("parameter", "unit"))


def pooled_table(fleet: Fleet) -> Table:
    """Effects that are weak in each case, and in all of a group."""
    rows = [
        (one.group, one.effect, f"{one.pooled.total:.3g} ± {one.pooled.error:.2g}", str(one.pooled.cases),
         str(one.named), f"{one.probability:.2f}")
        for one in fleet.shared
    ]  # fmt: skip
    return Table(("group", "effect", "gain [nat]", "cases", "named in", "probability"), rows, left=("effect",))


def courses_table(fleet: Fleet) -> Table:
    """Every parameter of every joint, those first that change."""
    rows = [
        (one.joint.label, one.parameter, ("jumps" if one.since else "drifts") if one.changes else "steady",
         str(len(one.date)), mean(one), one.unit, change(one), f"since {one.since:%Y-%m-%d}" if one.since else "a week",
         by_chance(one.course.p_value), f"{one.course.excess:.2g}")
        for one in sorted(fleet.series, key=lambda one: not one.changes)
    ]  # fmt: skip
    headers = ("joint", "parameter", "course", "cases", "mean", "unit", "change [%]", "when", "by chance", "scatter")
    return Table(headers, rows, left=("parameter", "course", "unit", "when"))


def mean(series: Series) -> str:
    """Weighted mean over time."""
    return plus_minus(series.course.level, series.course.level_error)


def change(series: Series) -> str:
    """Height of a step, or change in a week, in per cent of the mean."""
    course, weeks = series.course, 1.0 if series.since else WEEK
    if not (course.level and np.isfinite(course.change)):
        return "–"
    share = 100 * weeks / abs(course.level)
    text = plus_minus(share * course.change, share * course.change_error)
    return text if text.startswith("-") else f"+{text}"


def by_chance(p_value: float) -> str:
    """A small probability."""
    return "–" if np.isnan(p_value) else f"{p_value:.1g}" if p_value >= 1e-12 else "< 1e-12"
