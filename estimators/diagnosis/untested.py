"""Ranges of angles that no motion tested for an effect."""

from dataclasses import dataclass

from estimators.findings import Finding, Quantity
from pendulum_env.physics import Term
from pendulum_env.physics.terms import find_untested_ends
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
    ends = find_untested_ends(term, low, high, units)
    return UntestedRange(term.id, **ends) if ends else None
