"""What the cases of a dataset show together: effects by joint, drifts, odd ones, and what all of a kind share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path

import numpy as np
from scipy import stats

from estimators.diagnosis.result import Verdict
from estimators.fleet import Course, Odd, Pooled, course, odd_ones, onset, pool, significant, weigh
from estimators.selection.criterion import Criterion
from pendulum_env._typing import JSON, Array
from pendulum_env.reading import LARGE
from workbench.survey.dataset import SCHEMA, Dataset

DAY = 86400.0  # [s]
CHANCE = Criterion().chance  # that a diagnosis names an effect where none is missing
COLUMNS = tuple(name for name in SCHEMA.names if name != "diagnosis")  # which is large


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a robot, of a kind, with rows of the dataset that were diagnosed, in the order of time."""

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
    """A parameter of a joint over time; one with a shape, such as `stribeck.velocity`, is a parameter like others."""

    joint: Joint
    parameter: str
    unit: str
    date: Array  # of each case (N,) [s since 1970]
    value: Array  # of each (N,), in the unit
    error: Array  # standard error of each (N,)
    course: Course  # mean, and the line or step that explains most, time in days
    changes: bool = False  # whether that is significant, all parameters of the fleet weighed
    odd: Odd | None = None  # what its siblings lead to expect, if its mean differs significantly

    @property
    def since(self) -> datetime | None:
        """Date of the first estimate after the step; None if it is a line."""
        return None if self.course.first is None else datetime.fromtimestamp(self.date[self.course.first], UTC)


@dataclass(frozen=True)
class Missing:
    """An effect that is missing in a joint's model."""

    joint: Joint
    effect: str  # id
    cases: int  # in which it was named
    of: int  # number of the joint's cases
    first: datetime  # when it was named first
    since: datetime | None  # when it set in, if cases before and after differ significantly
    significant: bool  # whether so many cases do not name an effect by chance


@dataclass(frozen=True)
class Shared:
    """An effect that no case of a group names, or few, and all of the others show a little."""

    group: str  # whose cases were added up: a joint, or joints of one kind
    effect: str  # id
    pooled: Pooled  # sum over the cases that do not name it
    named: int  # number of cases that do
    probability: float  # among the effects that show in this group in this way


@dataclass(frozen=True)
class Fleet:
    """What a survey shows.

    Attributes:
        folder: of the dataset.
        rows: every case, in the order of names.
        joints: those with cases that were diagnosed.
        series: every parameter of every joint.
        effects: what is missing where.
        shared: effects that are weak in each case, and in all of a group.
    """

    folder: Path
    rows: tuple[JSON, ...] = ()
    joints: tuple[Joint, ...] = ()
    series: tuple[Series, ...] = ()
    effects: tuple[Missing, ...] = ()
    shared: tuple[Shared, ...] = ()

    @classmethod
    def of(cls, dataset: Dataset) -> Fleet:
        """Take stock of a dataset."""
        rows = tuple(dataset.rows(COLUMNS))
        joints = _joints(rows)
        series = _judged([one for joint in joints for one in _series(joint)])
        effects = sorted(_missing(joints), key=lambda one: (not one.significant, -one.cases / one.of, one.effect))
        shared = sorted(_shared(joints), key=lambda one: (-one.pooled.cases, one.group, -one.probability))
        return cls(dataset.folder, rows, joints, tuple(series), tuple(effects), tuple(shared))

    @property
    def unexplained(self) -> str:
        """How many cases lack something that no effect explains, `5 of 6 cases`; empty if none does."""
        verdicts = [case["verdict"] for joint in self.joints for case in joint.cases]
        lacking = verdicts.count("unexplained")
        return f"{lacking} of {len(verdicts)} cases" if lacking else ""

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
            if one["std"] and abs(one["value"]) <= LARGE and 1 / LARGE**2 <= one["std"] <= LARGE:  # nor NaN
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
    changes = significant(np.array([one.course.p_value for one in series]))
    differs = significant(np.array([odd[one].p_value for one in series]))
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
    named = significant(np.r_[by_chance, silent])
    begins = significant(np.array([np.nan if begun is None else begun.p_value for *_, begun in found]))
    for k, (joint, effect, has, begun) in enumerate(found):
        first = joint.cases[int(np.argmax(has))]["date"]
        since = joint.cases[begun.first]["date"] if begun is not None and begins[k] else None
        yield Missing(joint, effect, int(has.sum()), len(has), first, since, bool(named[k]))


def _shared(joints: Sequence[Joint]) -> Iterator[Shared]:
    """Effects that show in cases that do not name them, once their scores are added up: by joint, kind, and fleet."""
    groups = _groups(joints)
    effects = sorted({one["effect"] for joint in joints for row in joint.cases for one in row["candidates"]})
    for label, cases in groups.items():
        gains = np.array([_gains(row, effects) for row in cases]).reshape(len(cases), len(effects), 3)
        shown: dict[int, Pooled] = {}
        for k in range(len(effects)):
            known = gains[np.isfinite(gains[:, k]).all(axis=1), k]  # (n, 3)
            if len(known) > 1:
                gain, error, forms = known.T
                pooled = pool(gain, error, forms, rivals=len(effects) * len(groups))
                if pooled.p_value <= CHANCE:
                    shown[k] = pooled
        if shown:
            weak = gains[:, list(shown)]
            for (k, pooled), share in zip(shown.items(), weigh(weak[..., 0] - np.log(weak[..., 2])), strict=True):
                named = sum(effects[k] in row["selected"] for row in cases)
                yield Shared(label, effects[k], pooled, named, float(share))


def _groups(joints: Sequence[Joint]) -> dict[str, list[JSON]]:
    """Cases of single joints, of those of every kind that several are of, and of all."""
    groups = {joint.label: list(joint.cases) for joint in joints}
    kinds = sorted({joint.kind for joint in joints})
    for kind in kinds:
        own = [joint.cases for joint in joints if joint.kind == kind]
        if len(own) > 1:
            groups[f"all {kind}".strip()] = list(chain(*own))
    if len(kinds) > 1:
        groups["all joints"] = list(chain(*(joint.cases for joint in joints)))
    return groups


def _gains(row: JSON, effects: Sequence[str]) -> list[list[float]]:
    """What each effect gains that a case does not name, its error and forms; NaN if it names it, or cannot tell."""
    gains = {
        one["effect"]: [
            np.nan if one[key] is None or abs(one[key]) > LARGE else one[key]
            for key in ("gain", "gain_error", "variants")
        ]
        for one in row["candidates"]
        if one["verdict"] not in (str(Verdict.SELECTED), str(Verdict.AMBIGUOUS))
    }
    return [gains.get(effect, [np.nan] * 3) for effect in effects]
