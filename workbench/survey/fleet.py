"""What the cases of a dataset show together: effects by joint, drifts, odd ones, and what all of a kind share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from estimators.diagnosis.result import Verdict
from estimators.fleet import Course, Drift, Jump, Odd, Pooled, drift, jump, odd_ones, onset, pool, surely, weigh
from estimators.selection.criterion import Criterion
from pendulum_env._typing import JSON, Array
from workbench.survey.dataset import Dataset

DAY = 86400.0  # [s]
NAMED = (str(Verdict.SELECTED), str(Verdict.AMBIGUOUS))
COLUMNS = (
    "name", "robot", "joint", "kind", "date", "dated_by", "file", "status", "reason", "verdict", "headline", "score",
    "selected", "ambiguous", "candidates", "parameters", "torque_unit", "noise_floor", "torque_rms", "position_rms",
    "duration", "seconds", "report",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Series:
    """A parameter of a joint over time.

    Attributes:
        parameter, unit: name and unit; one with a shape, such as `stribeck.velocity`, is a parameter like others.
        date: of each case (N,) [s since 1970].
        value, error: of each (N,), in the unit.
        drift: a constant and a line, time in days.
        jump: a step, if there are enough estimates.
        course: what may be said of it, all parameters of the fleet weighed.
    """

    parameter: str
    unit: str
    date: Array
    value: Array
    error: Array
    drift: Drift
    jump: Jump | None
    course: Course = Course.STEADY

    @property
    def jumps_at(self) -> datetime | None:
        """Date of the first estimate after the jump, if it jumps."""
        jumps = self.jump is not None and self.course is Course.JUMPS
        return datetime.fromtimestamp(self.date[self.jump.first], UTC) if self.jump is not None and jumps else None


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint with its cases, in the order of time.

    Attributes:
        robot, name, kind: what it is.
        cases: rows of the dataset that were diagnosed.
        series: its parameters, by name.
    """

    robot: str
    name: str
    kind: str
    cases: tuple[JSON, ...]
    series: Mapping[str, Series]

    @property
    def label(self) -> str:
        """Robot and joint in one."""
        return " / ".join(filter(None, (self.robot, self.name))) or "–"

    @property
    def dates(self) -> Array:
        """Of its cases (N,) [s since 1970]."""
        return np.array([row["date"].timestamp() for row in self.cases])


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
class Differs:
    """A joint whose parameter is not like that of its siblings."""

    joint: Joint
    series: Series
    odd: Odd


@dataclass(frozen=True)
class Shared:
    """An effect that no case of a group names, or few, and all of the others show a little.

    Attributes:
        group: whose cases were added up: a joint, or joints of one kind.
        effect: id.
        pooled: sum over the cases that do not name it.
        named: number of cases that do.
        probability: among the effects that show in this group in this way.
    """

    group: str
    effect: str
    pooled: Pooled
    named: int
    probability: float


@dataclass(frozen=True)
class Fleet:
    """What a survey shows.

    Attributes:
        folder: of the dataset.
        rows: every case, in the order of names.
        joints: those with cases that were diagnosed.
        effects: what is missing where.
        drifting: joints with the parameters that drift.
        jumping: those that are others from a date on.
        scattering: those that scatter more than their errors allow, and to no end.
        odd: joints that differ from their siblings.
        shared: effects that are weak in each case, and in all of a group.
    """

    folder: Path
    rows: tuple[JSON, ...]
    joints: tuple[Joint, ...]
    effects: tuple[Missing, ...]
    drifting: tuple[tuple[Joint, Series], ...]
    jumping: tuple[tuple[Joint, Series], ...]
    scattering: tuple[tuple[Joint, Series], ...]
    odd: tuple[Differs, ...]
    shared: tuple[Shared, ...]
    criterion: Criterion = field(default_factory=Criterion)

    @classmethod
    def of(cls, dataset: Dataset) -> Fleet:
        """Take stock of a dataset."""
        rows, criterion = dataset.rows(COLUMNS), Criterion()
        joints = _judged(_joints(rows))
        courses = [(joint, series) for joint in joints for series in joint.series.values()]
        return cls(
            dataset.folder,
            tuple(rows),
            tuple(joints),
            tuple(_missing(joints, criterion)),
            tuple(one for one in courses if one[1].course is Course.DRIFTS),
            tuple(one for one in courses if one[1].course is Course.JUMPS),
            tuple(one for one in courses if one[1].course is Course.SCATTERS),
            tuple(_odd(joints)),
            tuple(_shared(joints, criterion)),
            criterion,
        )

    @property
    def troubled(self) -> list[JSON]:
        """Cases that could not be diagnosed."""
        return [row for row in self.rows if row["status"] != "done"]

    @property
    def parameters(self) -> list[str]:
        """Names of all parameters, those that most joints have first."""
        names = [name for joint in self.joints for name in joint.series]
        return sorted(dict.fromkeys(names), key=lambda name: -names.count(name))


def _joints(rows: Sequence[JSON]) -> list[Joint]:
    def key(row: JSON) -> tuple[str, str]:
        return row["robot"] or "", row["joint"] or ""

    done = sorted((row for row in rows if row["status"] == "done"), key=lambda row: (*key(row), row["date"]))
    joints = []
    for (robot, name), own in groupby(done, key):
        cases = tuple(own)
        joints.append(Joint(robot, name, cases[-1]["kind"] or "", cases, _series(cases)))
    return joints


def _series(cases: Sequence[JSON]) -> dict[str, Series]:
    """Parameters over time; those without an error, such as whole numbers, are none that could drift."""
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    for row in cases:
        for one in row["parameters"] or ():
            if one["std"] and np.isfinite([one["value"], one["std"]]).all():
                point = (row["date"].timestamp(), one["value"], one["std"])
                found.setdefault((one["name"], one["unit"]), []).append(point)
    series: dict[str, Series] = {}
    for (name, unit), points in found.items():
        date, value, error = np.array(points).T
        if name not in series or len(date) > len(series[name].date):  # of two units the one that is used
            series[name] = Series(
                name, unit, date, value, error, drift(date / DAY, value, error), jump(date, value, error)
            )
    return series


def _judged(joints: Sequence[Joint]) -> list[Joint]:
    """Joints whose parameters are told apart by their course, all tests of the fleet weighed together.

    Of a line and a step that are both sure, the one that leaves less is told.
    """
    everything = [series for joint in joints for series in joint.series.values()]
    jumps = np.array([np.nan if series.jump is None else series.jump.chance for series in everything], dtype=float)
    named = zip(
        surely(np.array([series.drift.chance for series in everything])),
        surely(jumps),
        surely(np.array([series.drift.scatter for series in everything])),
        strict=True,
    )
    courses = {id(series): _course(series, *sure) for series, sure in zip(everything, named, strict=True)}
    return [
        replace(joint, series={name: replace(one, course=courses[id(one)]) for name, one in joint.series.items()})
        for joint in joints
    ]


def _course(series: Series, drifts: bool, jumps: bool, scatters: bool) -> Course:
    if series.jump is not None and jumps and not (drifts and series.drift.left <= series.jump.left):
        return Course.JUMPS
    return Course.DRIFTS if drifts else Course.SCATTERS if scatters else Course.STEADY


def _missing(joints: Sequence[Joint], criterion: Criterion) -> list[Missing]:
    """Effects by joint, those first that most cases name; all joints and effects are weighed together.

    Where nothing is missing, a diagnosis names some effect with a probability of `criterion.chance`.
    """
    found = []
    for joint in joints:
        for effect in sorted({id for row in joint.cases for id in row["selected"]}):
            has = np.array([effect in row["selected"] for row in joint.cases])
            found.append((joint, effect, has, onset(joint.dates, has)))
    library = max((len(row["candidates"] or ()) for joint in joints for row in joint.cases), default=0) or 1
    silent = np.ones(max(0, library * len(joints) - len(found)))
    by_chance = [stats.binom.sf(has.sum() - 1, len(has), criterion.chance / library) for _, _, has, _ in found]
    chances = np.array([np.nan if begun is None else begun.chance for *_, begun in found], dtype=float)
    missing = [
        Missing(
            joint,
            effect,
            int(has.sum()),
            len(has),
            joint.cases[int(np.argmax(has))]["date"],
            joint.cases[begun.first]["date"] if begun is not None and sets_in else None,
            bool(sure),
        )
        for (joint, effect, has, begun), sets_in, sure in zip(
            found, surely(chances), surely(np.r_[by_chance, silent])[: len(found)], strict=True
        )
    ]
    return sorted(missing, key=lambda one: (not one.sure, -one.cases / one.of, one.effect, one.joint.label))


def _odd(joints: Sequence[Joint]) -> list[Differs]:
    """Joints whose mean differs from what their siblings let expect."""
    tested: list[Differs] = []
    for parameter in dict.fromkeys(name for joint in joints for name in joint.series):
        having = [joint for joint in joints if parameter in joint.series]
        for group in {(joint.kind, joint.series[parameter].unit): None for joint in having}:
            own = [joint for joint in having if (joint.kind, joint.series[parameter].unit) == group]
            means = [joint.series[parameter].drift for joint in own]
            odd = odd_ones(np.array([m.level for m in means]), np.array([m.level_error for m in means]))
            tested += [Differs(joint, joint.series[parameter], one) for joint, one in zip(own, odd, strict=True)]
    named = surely(np.array([one.odd.chance for one in tested]))
    return [one for one, sure in zip(tested, named, strict=True) if sure]


def _shared(joints: Sequence[Joint], criterion: Criterion) -> list[Shared]:
    """Effects that show in cases that do not name them, once their scores are added up: by joint, kind, and fleet."""
    groups: dict[str, list[JSON]] = {}
    for joint in joints:
        groups.setdefault(joint.label, []).extend(joint.cases)
    kinds = {joint.kind for joint in joints}
    for kind in sorted(kinds):
        own = [joint for joint in joints if joint.kind == kind]
        if len(own) > 1:
            groups[f"all {kind}".strip()] = [row for joint in own for row in joint.cases]
    if len(kinds) > 1:
        groups["all joints"] = [row for joint in joints for row in joint.cases]
    effects = sorted({one["effect"] for joint in joints for row in joint.cases for one in row["candidates"] or ()})
    found: list[Shared] = []
    for label, rows in groups.items():
        sure = {}
        for effect in effects:
            silent = [one for row in rows if (one := _candidate(row, effect)) is not None]
            if len(silent) > 1:
                pooled = pool(*_scores(silent), rivals=len(effects) * len(groups))
                if pooled.chance <= criterion.chance:
                    sure[effect] = pooled
        if sure:
            gains = np.array([[_net(_candidate(row, effect)) for effect in sure] for row in rows])
            for (effect, pooled), share in zip(sure.items(), weigh(gains), strict=True):
                named = sum(effect in row["selected"] for row in rows)
                found.append(Shared(label, effect, pooled, named, float(share)))
    return sorted(found, key=lambda one: (-one.pooled.cases, one.group, -one.probability))


def _candidate(row: JSON, effect: str) -> JSON | None:
    """What a case says of an effect that it does not name; None if it names it, or cannot tell what it gains."""
    for one in row["candidates"] or ():
        if one["effect"] == effect and one["verdict"] not in NAMED and None not in (one["gain"], one["gain_error"]):
            found: JSON = one
            return found
    return None


def _net(one: Mapping[str, Any] | None) -> float:
    return np.nan if one is None else one["gain"] - float(np.log(one["variants"]))


def _scores(found: Sequence[JSON]) -> tuple[Array, Array, Any]:
    gain, error = (np.array([one[name] for one in found], dtype=float) for name in ("gain", "gain_error"))
    return gain, error, np.array([one["variants"] for one in found])
