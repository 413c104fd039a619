"""Scenario: a retold log of a machine, with the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

LEAST_BOUND = 0.01  # relative standard error of a parameter, above which it may be withheld


@dataclass(frozen=True)
class Scenario:
    """Retold log of a machine, with the truth.

    Attributes:
        kind: of the machine.
        row: name of the retelling.
        motion: name of the motion.
        hidden: ids of hidden effects.
        truth: parameters in the unit of the log.
        bound: least relative standard errors in theory, by parameter.
        write: writes the files into a folder, and returns the arguments of `diagnose`.
    """

    kind: str
    row: str
    motion: str
    hidden: tuple[str, ...]
    truth: Mapping[str, float]
    bound: Mapping[str, float]
    write: Callable[[Path], list[str]]

    def may_decline(self) -> bool:
        """Return whether a parameter has a large error in theory, or an effect is hidden, whose bound is not known."""
        return bool(self.hidden) or max(self.bound.values()) > LEAST_BOUND
