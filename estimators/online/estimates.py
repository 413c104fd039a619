"""Online estimates: theta and covariances of all schemes, and those of one scheme by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pendulum_env._typing import Array, Index, Mask


@dataclass(eq=False)  # not frozen, which takes its time: one is made at every sample
class Estimates:
    """Estimates of B pendulums by S schemes after a sample.

    Attributes:
        index: of the newest sample that is used, counted from 0; negative while too few have come in (B,).
        time: of that sample: the measurement must be smoothed, and stick be ruled out, on both sides of it (B,) [s].
        theta: (B, S, P) in the order of the terms' columns.
        error: a-priori prediction errors, 0 where the equation was not used (B, S) [the scheme's unit].
        usable: which equations were used (B, S).
        regressor: phi of the torque balance at the instant, 0 in stick (B, P).
        spread: gives P.
        judge: what turns P into a covariance.
    """

    index: Index
    time: Array
    theta: Array
    error: Array
    usable: Mask
    regressor: Array
    spread: Callable[[], Array]
    judge: Callable[[Array], Array]

    @cached_property
    def P(self) -> Array:
        """The recursion's covariance for unit noise (B, S, P, P)."""
        return self.spread()

    @cached_property
    def covariance(self) -> Array:
        """Covariance of theta, honest under correlated errors (B, S, P, P); computed when it is asked for."""
        return self.judge(self.P)


class SchemeEstimate(Mapping[str, Any]):
    """What one scheme knows, by name; looked up when it is asked for, as few steps are looked at.

    theta (P,), covariance (P, P) and prediction_error of one pendulum, or with a first axis over all.
    """

    __slots__ = ("_now", "_pendulum", "_scheme", "units")

    _parts: ClassVar[dict[str, str]] = {"theta": "theta", "covariance": "covariance", "prediction_error": "error"}

    def __init__(self, now: Estimates, scheme: int, pendulum: int | slice, units: Mapping[str, str]) -> None:
        """Take all estimates, which of them are meant, and the units of the parameters by name, in order."""
        self._now, self._scheme, self._pendulum, self.units = now, scheme, pendulum, units

    def __getitem__(self, name: str) -> Any:
        return getattr(self._now, self._parts[name])[self._pendulum, self._scheme]

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    def __repr__(self) -> str:
        return repr(dict(self))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SchemeEstimate) and all(np.array_equal(self[name], other[name]) for name in self)

    __hash__ = None  # type: ignore[assignment]  # as of any mapping


class SchemeEstimates(dict[str, SchemeEstimate]):
    """What several schemes know, by id; a notebook shows it as a table."""

    def _repr_html_(self) -> str:
        from estimators.show.notebook import show_estimates  # only a notebook asks for it

        return show_estimates(self)
