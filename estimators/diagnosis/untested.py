"""Ranges of angles that no motion tested for an effect."""

from dataclasses import dataclass

from estimators.findings import Finding, Quantity
from pendulum_env.physics import Term
from pendulum_env.units import JointUnits


@dataclass(frozen=True)
class UntestedRange(Finding):
    """Effect that may act beyond the motion.

    Attributes:
        effect: id of the effect.
        low, high: ends of the motion beyond which it may act, None if it acts on the other side alone.
    """

    effect: str
    low: Quantity | None = None
    high: Quantity | None = None


def find_untested_range(term: Term, low: float, high: float, units: JointUnits) -> UntestedRange | None:
    """Return the finding on a term that may act beyond the ends of a motion [rad]; None if it cannot."""
    pairs = zip((low, high), term.open_ends, strict=True)
    ends = [Quantity(end, unit=units.unit("rad")) if is_open else None for end, is_open in pairs]
    return UntestedRange(term.id, *ends) if any(ends) else None
