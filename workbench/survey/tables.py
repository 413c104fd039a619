"""Tables of what a fleet shows, for the command line and for its page."""

from __future__ import annotations

import numpy as np

from pendulum_env.words import Table, plus_minus
from workbench.survey.fleet import Fleet, Series

WEEK = 7.0  # days, over which drifts are told


def effects_table(fleet: Fleet) -> Table:
    """What is missing where, and since when."""
    rows = [
        (one.joint.label, one.effect, f"{one.cases} of {one.of}",
         f"since {one.since:%Y-%m-%d}" if one.since else f"first {one.first:%Y-%m-%d}",
         "" if one.sure else "perhaps by chance")
        for one in fleet.effects
    ]  # fmt: skip
    return Table(("joint", "effect", "cases", "when", ""), rows, left=("effect", "when", ""))


def drifting_table(fleet: Fleet) -> Table:
    """Parameters that drift."""
    rows = [
        (joint.label, series.parameter, plus_minus(series.drift.level, series.drift.level_error), series.unit,
         slope(series), by_chance(series.drift.chance))
        for joint, series in fleet.drifting
    ]  # fmt: skip
    return Table(("joint", "parameter", "mean", "unit", "a week [%]", "by chance"), rows, left=("parameter", "unit"))


def jumping_table(fleet: Fleet) -> Table:
    """Parameters that are others from a date on."""
    rows = [
        (joint.label, series.parameter, f"{series.jumps_at:%Y-%m-%d}", change(series), by_chance(series.jump.chance))
        for joint, series in fleet.jumping
        if series.jump is not None
    ]
    return Table(("joint", "parameter", "since", "change [%]", "by chance"), rows, left=("parameter", "since"))


def change(series: Series) -> str:
    """A jump, in per cent of the mean."""
    if series.jump is None or not series.drift.level:
        return "+nan"
    share = 100 / abs(series.drift.level)
    return _signed(plus_minus(share * series.jump.change, share * series.jump.error))


def slope(series: Series) -> str:
    """Change in a week, in per cent of the mean."""
    share = 100 * WEEK / abs(series.drift.level) if series.drift.level else np.nan
    return _signed(plus_minus(share * series.drift.slope, share * series.drift.slope_error))


def _signed(value: str) -> str:
    return value if value.startswith("-") else f"+{value}"


def odd_table(fleet: Fleet) -> Table:
    """Joints that differ from their siblings."""
    rows = [
        (one.joint.label, one.series.parameter, plus_minus(one.series.drift.level, one.series.drift.level_error),
         plus_minus(one.odd.expected, one.odd.spread), one.series.unit, by_chance(one.odd.chance))
        for one in fleet.odd
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


def by_chance(chance: float) -> str:
    """A small probability."""
    return f"{chance:.1g}" if chance >= 1e-12 else "< 1e-12"
