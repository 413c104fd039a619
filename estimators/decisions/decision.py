"""Decisions: the one call that compares two models, gate by gate, under a named policy.

A policy lists stages. A stage is a function of both models that makes gates, each a value with its limit. The stages
run in order, up to the first one with a failed gate. The gates that ran are the decision, and are what a user sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from estimators.decisions.gate import Gate

Compared = TypeVar("Compared")  # a model with its evidence, a search under a treatment, or a fit under a convention


@dataclass(frozen=True)
class Policy(Generic[Compared]):
    """Named list of stages; the limits of their gates are fields of `Criterion`.

    Attributes:
        name: of the policy.
        stages: functions that make the gates of one model over another.
    """

    name: str
    stages: tuple[Callable[[Compared, Compared], Iterable[Gate]], ...]


@dataclass(frozen=True)
class Decision:
    """Gates that were tested in the comparison of two models, up to the first stage with a failure."""

    gates: tuple[Gate, ...] = ()

    @property
    def passed(self) -> bool:
        """Return whether all gates were passed."""
        return all(gate.passed for gate in self.gates)

    def join(self, other: Decision) -> Decision:
        """Return the decision with the gates of another one after its own."""
        return Decision((*self.gates, *other.gates))


NOTHING_TESTED = Decision()


def decide(after: Compared, before: Compared, policy: Policy[Compared]) -> Decision:
    """Decide whether `after` takes the place of `before`."""
    decision = NOTHING_TESTED
    for make_gates in policy.stages:
        decision = decision.join(Decision(tuple(make_gates(after, before))))
        if not decision.passed:
            break
    return decision
