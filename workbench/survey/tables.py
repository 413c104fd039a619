"""Tables of what a fleet shows, for the command line and for its page."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from pendulum_env.words import Table, plus_minus
from workbench.survey.fleet import Fleet, Series

LEFT = ("effect", "parameter", "course", "unit", "since", "when", "")  # columns of words
Columns = dict[str, Callable[[Any], str]]  # what is told of one thing that was found, by header


def change(series: Series) -> str:
    """Height of a step, or change in a week, in per cent of the mean."""
    course, days = series.course, 1.0 if series.since else 7.0
    if not (course.level and np.isfinite(course.change)):
        return "–"
    share = 100 * days / abs(course.level)
    text = plus_minus(share * course.change, share * course.change_error)
    return text if text.startswith("-") else f"+{text}"


def by_chance(p_value: float) -> str:
    """A small probability."""
    return "–" if np.isnan(p_value) else f"{p_value:.1g}" if p_value >= 1e-12 else "< 1e-12"


SERIES: Columns = {  # of a parameter over time
    "joint": lambda one: one.joint.label,
    "parameter": lambda one: one.parameter,
    "course": lambda one: ("jumps" if one.since else "drifts") if one.changes else "steady",
    "cases": lambda one: str(len(one.date)),
    "mean": lambda one: plus_minus(one.course.level, one.course.level_error),
    "expected": lambda one: plus_minus(one.odd.expected, one.odd.spread),
    "unit": lambda one: one.unit,
    "since": lambda one: f"{one.since:%Y-%m-%d}",
    "a week [%]": change,
    "change [%]": change,
    "when": lambda one: f"since {one.since:%Y-%m-%d}" if one.since else "a week",
    "by chance": lambda one: by_chance(one.course.p_value),
    "scatter": lambda one: f"{one.course.excess:.2g}",
}
MISSING: Columns = {  # of an effect
    "joint": lambda one: one.joint.label,
    "effect": lambda one: one.effect,
    "cases": lambda one: f"{one.cases} of {one.of}",
    "when": lambda one: f"since {one.since:%Y-%m-%d}" if one.since else f"first {one.first:%Y-%m-%d}",
    "": lambda one: "" if one.significant else "perhaps by chance",
}
SHARED: Columns = {  # of an effect that is weak in each case
    "group": lambda one: one.group,
    "effect": lambda one: one.effect,
    "gain [nat]": lambda one: f"{one.pooled.total:.3g} ± {one.pooled.error:.2g}",
    "cases": lambda one: str(one.pooled.cases),
    "named in": lambda one: str(one.named),
    "probability": lambda one: f"{one.probability:.2f}",
}


def tables(fleet: Fleet) -> dict[str, Table]:
    """Effects that are missing, parameters that drift, jump or are odd, effects that all share, and every course."""
    every = sorted(fleet.series, key=lambda one: not one.changes)  # those first that change
    unlike = SERIES | {"by chance": lambda one: by_chance(one.odd.p_value)}
    headers = ("joint", "parameter", "course", "cases", "mean", "unit", "change [%]", "when", "by chance", "scatter")
    return {
        "missing": _table(fleet.effects, MISSING),
        "drifting": _table(fleet.drifting, SERIES, "joint", "parameter", "mean", "unit", "a week [%]", "by chance"),
        "jumping": _table(fleet.jumping, SERIES, "joint", "parameter", "since", "change [%]", "by chance"),
        "odd": _table(fleet.odd, unlike, "joint", "parameter", "mean", "expected", "unit", "by chance"),
        "shared": _table(fleet.shared, SHARED),
        "courses": _table(every, SERIES, *headers),
    }


def _table(found: Iterable[Any], columns: Columns, *headers: str) -> Table:
    """A row for each thing that was found, of the columns with these headers or of all."""
    shown = headers or tuple(columns)
    rows = [tuple(columns[header](one) for header in shown) for one in found]
    return Table(shown, rows, left=[header for header in shown if header in LEFT])
