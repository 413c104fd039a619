"""What the cases of a dataset show together: effects by joint, drifts, jumps and odd ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy import stats

from estimators.fleet import Course, Odd, course, odd_ones, onset, surely
from estimators.selection.criterion import Criterion
from pendulum_env._typing import JSON, Array
from workbench.survey.dataset import SCHEMA, Dataset

DAY = 86400.0  # [s]
CHANCE = Criterion().chance  # that a diagnosis names an effect where none is missing
COLUMNS = tuple(name for name in SCHEMA.names if name != "diagnosis")  # which is large


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint with its cases.

    Attributes:
        robot, name, kind: what it is.
        cases: rows of the dataset that were diagnosed, in the order of time.
    """

    robot: str
    name: str
    kind: str
    cases: tuple[JSON, ...] = ()

    @property
    def label(self) -> str:
        """Robot and joint in one."""
        return " / ".join(filter(None, (self.robot, self.name))) or "–"


@dataclass(frozen=True, eq=False)
class Series:
    """A parameter of a joint over time.

    Attributes:
        joint: whose.
        parameter, unit: name and unit; one with a shape, such as `stribeck.velocity`, is a parameter like others.
        date: of each case (N,) [s since 1970].
        value, error: of each (N,), in the unit.
        course: their mean, and the line or step that tells most, time in days.
        changes: whether that is sure, all parameters of the fleet weighed.
        odd: what its siblings lead to expect, if its mean surely differs.
    """

    joint: Joint
    parameter: str
    unit: str
    date: Array
    value: Array
    error: Array
    course: Course
    changes: bool = False
    odd: Odd | None = None

    @property
    def since(self) -> datetime | None:
        """Date of the first estimate after the step; None if it is a line."""
        return None if self.course.first is None else datetime.fromtimestamp(self.date[self.course.first], UTC)


@dataclass(frozen=True)
class Missing:
    """An effect that is missing in a joint's model.

    Attributes:
        joint: where.
        effect: id.
        cases: number of the joint's cases in which it was named.
        of: number of its cases.
        first: when it was named first.
        since: when it set in, if cases before and after are surely different.
        sure: whether so many cases do not name an effect by chance.
    """

    joint: Joint
    effect: str
    cases: int
    of: int
    first: datetime
    since: datetime | None
    sure: bool


@dataclass(frozen=True)
class Fleet:
    """What a survey shows.

    Attributes:
        folder: of the dataset.
        rows: every case, in the order of names.
        joints: those with cases that were diagnosed.
        series: every parameter of every joint.
        effects: what is missing where.
    """

    folder: Path
    rows: tuple[JSON, ...] = ()
    joints: tuple[Joint, ...] = ()
    series: tuple[Series, ...] = ()
    effects: tuple[Missing, ...] = ()

    @classmethod
    def of(cls, dataset: Dataset) -> Fleet:
        """Take stock of a dataset."""
        rows = tuple(dataset.rows(COLUMNS))
        joints = _joints(rows)
        series = _judged([one for joint in joints for one in _series(joint)])
        effects = sorted(_missing(joints), key=lambda one: (not one.sure, -one.cases / one.of, one.effect))
        return cls(dataset.folder, rows, joints, tuple(series), tuple(effects))

    @property
    def drifting(self) -> list[Series]:
        """Parameters that drift."""
        return [one for one in self.series if one.changes and one.since is None]

    @property
    def jumping(self) -> list[Series]:
        """Parameters that are others from a date on."""
        return [one for one in self.series if one.changes and one.since is not None]

    @property
    def odd(self) -> list[Series]:
        """Parameters that differ from those of the joint's siblings."""
        return [one for one in self.series if one.odd is not None]


def _joints(rows: Sequence[JSON]) -> tuple[Joint, ...]:
    cases: dict[tuple[str, str], list[JSON]] = {}
    for row in sorted(rows, key=lambda row: row["date"]):
        if row["status"] == "done":
            cases.setdefault((row["robot"] or "", row["joint"] or ""), []).append(row)
    return tuple(Joint(*key, own[-1]["kind"] or "", tuple(own)) for key, own in sorted(cases.items()))


def _series(joint: Joint) -> Iterator[Series]:
    """Parameters over time; those without an error, such as whole numbers, are none that could drift."""
    points: dict[tuple[str, str], list[tuple[float, float, float]]] = {}  # by name and unit
    for row in joint.cases:
        for one in row["parameters"]:
            if one["std"] and np.isfinite([one["value"], one["std"]]).all():
                point = (row["date"].timestamp(), one["value"], one["std"])
                points.setdefault((one["name"], one["unit"]), []).append(point)
    units = dict(sorted(points, key=lambda key: len(points[key])))  # of two units the one that is used
    for name in dict.fromkeys(name for name, _ in points):
        date, value, error = np.array(points[name, units[name]]).T
        yield Series(joint, name, units[name], date, value, error, course(date / DAY, value, error))


def _judged(series: Sequence[Series]) -> Iterator[Series]:
    """Parameters that change, or are unlike those of siblings, told from others: all tests of the fleet are weighed."""
    siblings: dict[tuple[str, str, str], list[Series]] = {}
    for one in series:
        siblings.setdefault((one.joint.kind, one.parameter, one.unit), []).append(one)
    odd: dict[Series, Odd] = {}
    for own in siblings.values():
        level, error = np.array([(one.course.level, one.course.level_error) for one in own]).T
        odd |= zip(own, odd_ones(level, error), strict=True)
    changes = surely(np.array([one.course.chance for one in series]))
    differs = surely(np.array([odd[one].chance for one in series]))
    for k, one in enumerate(series):
        yield replace(one, changes=bool(changes[k]), odd=odd[one] if differs[k] else None)


def _missing(joints: Sequence[Joint]) -> Iterator[Missing]:
    """Effects by joint; all joints and effects are weighed together."""
    found = []
    for joint in joints:
        dates = np.array([row["date"].timestamp() for row in joint.cases])
        for effect in sorted({id for row in joint.cases for id in row["selected"]}):
            has = np.array([effect in row["selected"] for row in joint.cases])
            found.append((joint, effect, has, onset(dates, has)))
    library = max((len(row["candidates"]) for joint in joints for row in joint.cases), default=0) or 1
    by_chance = [stats.binom.sf(has.sum() - 1, len(has), CHANCE / library) for _, _, has, _ in found]
    silent = np.ones(max(0, library * len(joints) - len(found)))  # effects that no case names were tested, too
    sure = surely(np.r_[by_chance, silent])
    begins = surely(np.array([np.nan if begun is None else begun.chance for *_, begun in found]))
    for k, (joint, effect, has, begun) in enumerate(found):
        first = joint.cases[int(np.argmax(has))]["date"]
        since = joint.cases[begun.first]["date"] if begun is not None and begins[k] else None
        yield Missing(joint, effect, int(has.sum()), len(has), first, since, bool(sure[k]))
