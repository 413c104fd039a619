"""Online estimates: theta and covariances of all schemes, and those of one scheme by name."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pendulum_env._typing import Array, Index, Mask
from pendulum_env.notebook import card, note, shown, table
from pendulum_env.words import Table, plus_minus


@dataclass(eq=False)  # not frozen, which takes its time: one is made at every sample
class Estimates:
    """Estimates of B pendulums by S schemes after a sample.

    Attributes:
        index: of the newest sample that is used, counted from 0; negative while too few have come in (B,).
        time: of that sample: the measurement must be smoothed, and stick be ruled out, on both sides of it (B,) [s].
        theta: (B, S, P) in the order of the terms' columns.
        error: a-priori prediction errors, 0 where the equation was not used (B, S) [the scheme's unit].
        usable: which equations were used (B, S).
        regressor: phi of the torque balance at the instant, 0 in stick (B, P); None of an arm.
        spread: gives P.
        judge: what turns P into a covariance.
    """

    index: Index
    time: Array
    theta: Array
    error: Array
    usable: Mask
    regressor: Array | None
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


class SchemeEstimate(Mapping[str, Any], dict[str, Any]):  # type: ignore[metaclass,misc]  # for Gymnasium
    """What one scheme knows, by name; looked up when it is asked for, as few steps are looked at.

    theta (P,), covariance (P, P), prediction_error, and P (P, P), the covariance for unit noise, of one plant; of a
    batch with a first axis over all, and with the masks (B,) of Gymnasium's vector environments, as `_theta`.
    """

    __slots__ = ("_now", "_pendulum", "_scheme", "units")

    _parts: ClassVar[dict[str, str]] = {
        "theta": "theta",
        "covariance": "covariance",
        "prediction_error": "error",
        "P": "P",
    }

    def __init__(self, now: Estimates, scheme: int, pendulum: int | slice, units: Mapping[str, str]) -> None:
        """Take all estimates, which of them are meant, and the units of the parameters by name, in order."""
        self._now, self._scheme, self._pendulum, self.units = now, scheme, pendulum, units

    def __getitem__(self, name: str) -> Any:
        if isinstance(self._pendulum, slice) and name[:1] == "_" and name[1:] in self._parts:
            return np.ones(len(self._now.time), dtype=bool)
        return getattr(self._now, self._parts[name])[self._pendulum, self._scheme]

    def __iter__(self) -> Iterator[str]:
        return iter([*self._parts, *(f"_{name}" for name in self._parts if isinstance(self._pendulum, slice))])

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __repr__(self) -> str:
        return repr(self.copy())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SchemeEstimate) and all(np.array_equal(self[name], other[name]) for name in self)

    __hash__ = None  # type: ignore[assignment]  # as of any mapping

    def copy(self) -> dict[str, Any]:
        """All that it knows, computed."""
        return {name: self[name] for name in self}

    def __reduce__(self) -> tuple[type[dict[str, Any]], tuple[dict[str, Any]]]:
        return dict, (self.copy(),)  # for another process, which has no recursion to ask


class SchemeEstimates(dict[str, Any]):
    """Estimates of several schemes, a `SchemeEstimate` by id; of a batch with Gymnasium's masks, as `_dynamic`."""

    def _repr_html_(self) -> str:
        return shown(self)


@shown.register
def show_estimates(found: SchemeEstimates) -> str:
    """Estimates of several schemes as they are now; of a batch, those of its first plant."""
    schemes = {id: own for id, own in found.items() if isinstance(own, SchemeEstimate)}
    units = {name: of for own in schemes.values() for name, of in own.units.items()}
    rows = []
    for id, own in schemes.items():
        theta = np.atleast_2d(own["theta"])[0]
        variance = np.diagonal(own["covariance"], axis1=-2, axis2=-1).reshape(-1, len(theta))[0]
        std = np.sqrt(np.maximum(variance, 0.0))
        known = {name: plus_minus(*pair) for name, *pair in zip(own.units, theta, std, strict=True)}
        rows.append((id, *(known.get(name, "") for name in units)))
    batch = [len(own["theta"]) for own in schemes.values() if np.ndim(own["theta"]) > 1]
    return card(
        "Online estimates",
        table(Table(("scheme", *(f"{name} [{of}]" for name, of in units.items())), rows)),
        note(f"of the first of {batch[0]} pendulums" if batch else ""),
    )
