"""Online estimates: theta and covariances of all schemes, and those of one scheme by name."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators.online.noise_bias import Correction
from estimators.online.recursion import RecursionState
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.formatting import format_estimate
from pendulum_env.notebook import Shown

NO_DATA = "no data"


@dataclass(eq=False)  # not frozen, which is slow: one is made at every sample
class Estimates:
    """Estimates of B pendulums by S schemes after a sample.

    Attributes:
        index: index of the newest used sample, from 0; negative before enough samples (B,).
        time: time of this sample (B,) [s], which is older than the last sample by the reach of smoothing and guards.
        state: state of the recursion; its theta is not corrected for encoder noise.
        error: a-priori prediction errors in the unit of the scheme, 0 where the equation was not used (B, S).
        usable: mask of the used equations (B, S).
        regressor: phi of the torque balance at this sample, 0 in stick (B, P); None with links.
        compute_covariance: function that computes the covariance without bias (B, S, P, P).
        compute_correction: function that computes the correction of theta for encoder noise, and its remaining bias.
    """

    index: Index
    time: Array
    state: RecursionState
    error: Array
    usable: Mask
    regressor: Array | None
    compute_covariance: Callable[[], Array]
    compute_correction: Callable[[], Correction] = Correction.none

    @cached_property
    def _correction(self) -> Correction:
        return self.compute_correction()

    @cached_property
    def theta(self) -> Array:
        """Return the estimates (B, S, P) in the order of the columns of the terms."""
        return self.state.theta + self._correction.step

    @property
    def P(self) -> Array:
        """Return the covariance for unit noise (B, S, P, P)."""
        return self.state.P

    @cached_property
    def covariance(self) -> Array:
        """Return the covariance of theta, valid under correlated errors (B, S, P, P)."""
        return self.compute_covariance() + self._correction.bias

    @property
    def std(self) -> Array:
        """Return the standard errors of theta (B, S, P)."""
        return np.sqrt(np.maximum(np.einsum("bsii->bsi", self.covariance), 0.0))

    @property
    def is_known(self) -> Mask:
        """Return whether the data determine each parameter, better than P(0) (B, S, P); else its std has no meaning."""
        return (np.einsum("bsii->bsi", self.P) < 0.5 * self.state.prior) & np.isfinite(self.std)


class SchemeEstimate(Mapping[str, Any], dict[str, Any]):  # type: ignore[metaclass,misc]  # for Gymnasium
    """Estimates of one scheme, by name; computed when they are read.

    The names are theta and its standard errors std, each a mapping by name of the parameter; covariance (P, P) in the
    order of theta; prediction_error; and P (P, P), the covariance for unit noise. A batch has a first axis B, and the
    masks (B,) of vector environments of Gymnasium, for example `_theta`.
    """

    __slots__ = ("_estimates", "_pendulum", "_scheme", "units")

    _parts: ClassVar[dict[str, str]] = {
        "theta": "theta",
        "std": "std",
        "covariance": "covariance",
        "prediction_error": "error",
        "P": "P",
    }

    def __init__(self, estimates: Estimates, scheme: int, pendulum: int | slice, units: Mapping[str, str]) -> None:
        """Select the estimates of a scheme by index, and of a pendulum by index or of all by a slice.

        `units` are those of the parameters by name.
        """
        self._estimates, self._scheme, self._pendulum, self.units = estimates, scheme, pendulum, units

    def __getitem__(self, name: str) -> Any:
        if isinstance(self._pendulum, slice) and name[:1] == "_" and name[1:] in self._parts:
            return np.ones(len(self._estimates.time), dtype=bool)
        values = getattr(self._estimates, self._parts[name])[self._pendulum, self._scheme]
        return self._name_values(values) if name in ("theta", "std") else values

    def _name_values(self, values: Array) -> dict[str, Any]:
        """Return values (P,) as numbers by name, or values (B, P) as arrays (B,) with masks."""
        if isinstance(self._pendulum, int):
            return dict(zip(self.units, values.tolist(), strict=True))
        mask = np.ones(len(values), dtype=bool)
        return dict(zip(self.units, values.T, strict=True)) | {f"_{name}": mask for name in self.units}

    def __iter__(self) -> Iterator[str]:
        return iter([*self._parts, *(f"_{name}" for name in self._parts if isinstance(self._pendulum, slice))])

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __repr__(self) -> str:
        values = self.format()
        has_data = any(value != NO_DATA for value in values.values())
        text = ", ".join(f"{name} {value}" for name, value in values.items()) if has_data else NO_DATA
        return f"<{text}>" if self.count is None else f"<{text}; first of {self.count} pendulums>"

    @property
    def count(self) -> int | None:
        """Return the number B of pendulums; None for a single one."""
        return None if isinstance(self._pendulum, int) else len(self._estimates.time)

    def format(self) -> dict[str, str]:
        """Format each parameter by name, as `0.08951 ± 0.00012`, or `no data`; of a batch, those of the first."""
        estimates, place = self._estimates, (self._pendulum, self._scheme)
        values = (np.atleast_2d(each[place])[0] for each in (estimates.theta, estimates.std, estimates.is_known))
        numbers = zip(self.units, *values, strict=True)
        return {name: format_estimate(value, std) if known else NO_DATA for name, value, std, known in numbers}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SchemeEstimate) and _are_equal(self.copy(), other.copy())

    __hash__ = None  # type: ignore[assignment]  # as of any mapping

    def copy(self) -> dict[str, Any]:
        """Return all values as a dictionary."""
        return {name: self[name] for name in self}

    def __reduce__(self) -> tuple[type[dict[str, Any]], tuple[dict[str, Any]]]:
        return dict, (self.copy(),)  # a process without the recursion gets the values


class SchemeEstimates(dict[str, Any], Shown):
    """`SchemeEstimate` of each scheme, by id; a batch also has masks of Gymnasium, for example `_dynamic`."""


def _are_equal(one: Any, other: Any) -> bool:
    """Return whether two arrays, or two nested mappings of arrays, are equal."""
    if not isinstance(one, dict):
        return np.array_equal(one, other)
    return one.keys() == other.keys() and all(_are_equal(one[name], other[name]) for name in one)
