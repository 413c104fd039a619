"""Caveats of a result: limits of the recordings within which the values of a model hold."""

from collections.abc import Sequence
from dataclasses import dataclass

from estimators.checks.channel_rows import compute_driven_share
from estimators.decisions.errors import Step, Terms
from estimators.diagnosis.angle_error import TURN
from estimators.diagnosis.questions import find_detectable_effects
from estimators.diagnosis.result import Detectable
from estimators.diagnosis.untested import UntestedRange, find_untested_range
from estimators.findings import Finding, Quantity
from estimators.selection.evidence import Evidence
from pendulum_env.physics import SIGNIFICANT, Gravity, Model, list_ids
from pendulum_env.units import JointUnits

MIN_WINDOWS = 40  # number of windows below which a finding warns


@dataclass(frozen=True)
class FewWindows(Finding):
    """Few windows of motion: their number."""

    count: int

    @property
    def is_open(self) -> bool:
        """Return True: longer recordings have more."""
        return True


@dataclass(frozen=True)
class PartOfTurn(Finding):
    """Motion of less than a turn: its `angle`, and the `effects` that changed the estimate of gravity."""

    angle: Quantity
    effects: tuple[str, ...]


@dataclass(frozen=True)
class UnknownScale(Finding):
    """Unknown scale of all parameters, as friction by load would not show: `share` of the motion that torque causes."""

    share: float


def find_caveats(evidence: Evidence, steps: Sequence[Step], terms: Terms, known: Sequence[Detectable]) -> list[Finding]:
    """Return findings on few windows, part of a turn, untested ranges, and an unknown scale of all parameters.

    Args:
        evidence: of the data.
        steps: from the base model to the final model of a pendulum.
        terms: of the final model.
        known: detectable effects of these terms; may be empty.
    """
    model, (low, high), count = (
        steps[-1].model,
        evidence.train.get_range(),
        len(evidence.train.layout.clusters),
    )
    return [
        *([FewWindows(count)] if count < MIN_WINDOWS else []),
        *_find_part_of_turn(evidence, steps[0].model, model, high - low),
        *_find_untested_ranges(model, low, high),
        *_find_unknown_scale(evidence, terms, known),
    ]


def _find_part_of_turn(evidence: Evidence, base: Model, model: Model, reach: float) -> list[Finding]:
    """Return a finding on effects of the angle that changed gravity, if the angles cover less than a turn [rad].

    Within part of a turn, gravity and another law of the angle can imitate a third law, or a wrong scale of the angle.
    `widen_by_law` adds the error of the laws of the library alone; here the error of gravity is without it. A tilt is
    weight too, and a stop acts at the end of the range only.
    """
    others = (term for term in model.terms if term.kind in ("potential", "sensor") and not term.has_impacts)
    effects = tuple(term.id for term in others if term.id not in list_ids(base.terms) and not term.is_weight)
    old, new = base.estimates.get(Gravity.id), model.estimates.get(Gravity.id)
    if not effects or old is None or new is None or not new.std or model.is_prismatic or reach >= TURN:
        return []
    std = evidence.fits.fit_with_std(model.terms).model.estimates[Gravity.id].std
    if abs(new.value - old.value) <= SIGNIFICANT * std:
        return []
    return [PartOfTurn(Quantity(reach, unit=JointUnits().unit("rad")), effects)]


def _find_unknown_scale(evidence: Evidence, terms: Terms, known: Sequence[Detectable]) -> list[Finding]:
    """Return a finding if friction by load may scale all parameters: torque causes the motion and does not show it.

    The scale counts as known if each effect that can hide it is detectable below 1 - `Criterion.kept_inertia`.
    """
    data, kinds = evidence.train.data, {id: kind for id, kind in evidence.library.items() if kind.can_hide_scale}
    share = compute_driven_share(data, data.torque.recorded)
    is_known = not kinds or any(term.can_hide_scale for term in terms)
    if share <= evidence.criterion.columns.driven_share or is_known:
        return []
    hidden = known or find_detectable_effects(evidence, terms, kinds)
    most = 1.0 - evidence.criterion.kept_inertia
    excited = {detectable.effect for detectable in hidden if detectable.is_excited and (detectable.above or 0.0) < most}
    return [] if kinds.keys() <= excited else [UnknownScale(share)]


def _find_untested_ranges(model: Model, low: float, high: float) -> list[UntestedRange]:
    """Return a finding on each term that would act beyond the recorded range of angles [rad]."""
    findings = (find_untested_range(term, low, high, model.units(term.at)) for term in model.terms)
    return [finding for finding in findings if finding is not None]
