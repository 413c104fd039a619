"""Which effect is missing at which joint of an arm: the pendulum's search, on the rows of all joints."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.identifiability import untold_of_arm
from estimators.checks.residual import Region, everywhere
from estimators.diagnosis.judge import judge
from estimators.diagnosis.result import KEPT, UNNAMED, Diagnosis
from estimators.diagnosis.setting import Setting
from estimators.preprocessing import Preprocessed, parted
from estimators.regression.equations import IdentificationError
from estimators.selection.data import PreparedData
from estimators.selection.left import Terms
from estimators.selection.models import Models
from estimators.selection.moves import explaining
from estimators.selection.physical import driving_friction
from estimators.selection.search import select
from estimators.signals.motion import HALF_WIDTHS
from estimators.weak_form.dataset import Dataset
from estimators.weak_form.windows import in_a_row
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import kind_at
from pendulum_env.arms.recording import of_arms
from pendulum_env.recording import Recording
from pendulum_env.words import listing

HEAVIER = 1.2  # times, by which a joint feels heavier in slow motion without its friction being the reason


def examine_arm(
    recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting, body: Body
) -> Diagnosis:
    """Find the effects at joints that recordings of an arm call for.

    Raises:
        IdentificationError: if a joint hardly moves clear of stick.
    """
    known = {term.id for term in setting.base}
    setting = replace(setting, library={id: kind for id, kind in setting.library.items() if id not in known})
    given = Preprocessed(tuple(recordings), tuple(holdout), terms=(*setting.base, *setting.library.values())).timed()
    models = setting.models(given.parts)
    found = select(models)
    candidates, groups = judge(found, found.terms)
    left = left_at_joints(models, found.terms)
    by_law = ([table for table in models.tables if table.at == at] for at in left)
    tables = tuple(id for laws in by_law if (id := explaining(models, found.terms, laws)) is not None)
    *others, last = found.steps
    model = last.model.biased() if left else last.model
    seen = (in_a_row([w.samples for w in models.train.data.part(at).windows]) for at in body.joints)
    motion = zip(*((x.position, x.velocity, x.torque) for x in seen), strict=True)
    model = model.withholding(untold_of_arm([model], *map(np.column_stack, motion))[0])
    heavier = heavier_when_slow(models, given, left) if left else {}
    return Diagnosis(
        steps=(*others, replace(last, model=model)),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=where_it_stands_out(models, found.terms, left),
        floors=models.left.floors,
        advice=(*driving_friction(model), *(said_of_slow_motion(joint, times) for joint, times in heavier.items())),
        forbidden=what_is_open(groups, tables, bool(left), body),
        tables=tables,
        torque_unit=given.unit,
        data=given.fresh(model.terms),
        left=left,
        heavier=heavier,
    )


def left_at_joints(models: Models, terms: Terms) -> dict[str, float]:
    """Torque that terms leave of joints and that is no noise [N m]: what neighbouring windows share, or all."""
    found, data = models.left.structures(terms)[0], models.train.data
    assert isinstance(data, Dataset)  # nothing simulates an arm in its loop
    return {
        at: own.shared if own.sure > models.criterion.sure else own.all
        for at, own in found.items()
        if not models.criterion.is_noise(own, max(models.left.floors[at], data.negligible(at)))
    }


def where_it_stands_out(models: Models, terms: Terms, joints: Collection[str]) -> tuple[Region, ...]:
    """Where what terms leave stands out most of the noise, one region of each joint, everywhere if it does nowhere."""
    data, residual = models.train, models.regression.residual(terms)
    assert isinstance(data, PreparedData)
    return tuple(next(iter(data.stand_out(residual, at, most=1)), replace(everywhere(""), at=at)) for at in joints)


def heavier_when_slow(models: Models, given: Preprocessed, joints: Collection[str]) -> dict[str, float]:
    """Of some joints those that feel surely heavier in the longest windows, and how many times."""
    train, _ = parted(of_arms(given.recordings), of_arms(given.holdout))
    try:
        slow = PreparedData.of_arm(train, models.base, HALF_WIDTHS[-1]).inertias(models.base)
    except IdentificationError:  # they are too few
        return {}
    times = {at: slow[at] / max(models.left.inertia[at], 1e-300) for at in joints}
    return {at: ratio for at, ratio in times.items() if ratio > HEAVIER}


def said_of_slow_motion(joint: str, times: float) -> str:
    """What is said of a joint that feels some times as heavy in slow motion as in all."""
    return (
        f"{joint} feels {times:.2g} times as heavy below {0.5 / HALF_WIDTHS[-1]:.2g} Hz as in all of its motion, as "
        "behind an elastic transmission, on a base that gives, or where the encoder adds more than white noise: trust "
        "slow motion"
    )


def what_is_open(groups: Sequence[tuple[str, ...]], tables: Sequence[str], is_left: bool, body: Body) -> str | None:
    """What would settle what is open at joints, or that nothing would; None if nothing is open."""
    if groups:
        reveal = kind_at(groups[0][-1], body).reveal
        return f"{listing(groups[0])} look the same in these data; to tell them apart: {reveal}"
    if tables:
        first, *others = tables
        return KEPT.format(table=first) + (f" (so would {listing(others)})" if others else "")
    return UNNAMED if is_left else None
