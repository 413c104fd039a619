"""Estimates: parameter values with standard errors, and derived quantities."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pendulum_env._typing import JSON, Array
from pendulum_env.formatting import format_estimate
from pendulum_env.physics.term import Term
from pendulum_env.quantity import Quantity
from pendulum_env.units import JointUnits, to_shown_unit

LARGEST = 1e60  # size of an error or a standard error whose powers do not overflow
SIGNIFICANT = 3.0  # standard errors from zero of a significant parameter


@dataclass(frozen=True, repr=False)
class Estimate(Quantity):
    """Value of a parameter with its standard error, both in `unit`; the error is 0 for a value that was not estimated.

    It is also 0 for a value at a bound, which noise did not determine. If the model lacks an effect, the value is
    biased by an unknown amount, and the standard error covers only the noise. A value that noise of the encoder biases
    is marked as well; its standard error covers this bias.
    """

    at_bound: bool = field(default=False, compare=False)
    is_biased: bool = field(default=False, compare=False)
    is_unknown: bool = field(default=False, compare=False)  # whether the data do not determine the value

    @classmethod
    def from_bounds(cls, value: float, std: float, unit: str, low: float, high: float) -> Estimate:
        """Make an estimate from a fit within bounds; with equal bounds, the value is known."""
        at_bound = low < high and value in (low, high)
        std = std if std < LARGEST else math.inf  # its square overflows
        return cls(value, 0.0 if at_bound or low == high else std, unit, at_bound)

    @property
    def is_significant(self) -> bool:
        """Return whether the value differs from zero by more than 3 standard errors."""
        return abs(self.value) > SIGNIFICANT * self.std

    @property
    def text(self) -> str:
        """Format the estimate for a table: `0.08951 ± 0.00012`, `0.3 (at its bound)`, `0.0895 (biased)`, `unknown`."""
        if self.is_unknown:
            return "unknown"
        if self.is_biased and not self.at_bound and self.std > 0:
            return f"{self.value:.3g} (biased)"
        return format_estimate(self.value, self.std) + (" (at its bound)" if self.at_bound else "")

    @property
    def shown(self) -> Estimate:
        """Convert to the displayed unit; angles may be in degrees, rad/s is kept."""
        factor, unit = to_shown_unit(1.0, self.unit, is_parameter=True)
        return replace(self, value=factor * self.value, std=factor * self.std, unit=unit)

    def __str__(self) -> str:
        shown = self.shown
        return shown.text if shown.is_unknown or shown.unit == "1" else f"{shown.text} {shown.unit}"

    def __repr__(self) -> str:
        return f"<{self}>"

    def __float__(self) -> float:
        return self.value

    def json(self) -> JSON:
        """Return a dictionary for JSON, with flags for a biased or unknown value."""
        flags = {"biased": self.is_biased, "unknown": self.is_unknown}
        return super().json() | {key: True for key, is_set in flags.items() if is_set}


def shorten_name(name: str) -> str:
    """Shorten the name of a parameter for display: `dead_time` for `dead_time.dead_time`."""
    id, _, suffix = name.partition(".")
    part, at, joint = suffix.partition("@")
    return f"{id}{at}{joint}" if part == id else name


def derive_estimates(
    terms: Sequence[Term], estimates: Mapping[str, Estimate], covariance: Array, units: JointUnits
) -> dict[str, Estimate]:
    """Compute the derived quantities of a model by name, with standard errors to first order.

    A quantity that depends on a parameter at its bound is at its bound.
    """
    names, values = list(estimates), np.array([estimate.value for estimate in estimates.values()])
    results = {}
    for term in terms:
        indices = [names.index(name) for name in term.parameter_names]
        theta = values[indices]
        perturbations = np.diag(1e-6 * np.maximum(np.abs(theta), 1e-9))
        perturbed = [_derive_quantities(term, theta + perturbation) for perturbation in perturbations]
        for name, (value, unit) in _derive_quantities(term, theta).items():
            slope = np.array([changed[name][0] - value for changed in perturbed]) / perturbations.diagonal()
            std = np.sqrt(max(0.0, float(slope @ covariance[np.ix_(indices, indices)] @ slope)))
            is_biased = any(estimates[names[k]].is_biased for k in indices)
            at_bound = any(estimates[names[k]].at_bound for k, change in zip(indices, slope, strict=True) if change)
            full_name, std, unit = term.get_full_name(name), 0.0 if at_bound else float(std), units.unit(unit)
            results[full_name] = Estimate(float(value), std, unit, at_bound, is_biased=is_biased)
        for part in term.percent_of:
            name, base_name = term.get_full_name(part), f"{part}@{term.at}" if term.at else part
            base, entry = estimates.get(base_name), estimates[name]
            if base is not None and base.value != 0:
                share, places = 100 * entry.value / base.value, [names.index(name), names.index(base_name)]
                slope = np.array([100.0, -share]) / base.value
                std = float(np.sqrt(slope @ covariance[np.ix_(places, places)] @ slope))
                unit = f"%{entry.unit.removeprefix(base.unit)}"
                results[term.get_full_name(f"{part}_share")] = Estimate(share, std, unit, is_biased=entry.is_biased)
    return results


def _derive_quantities(term: Term, values: Array) -> dict[str, tuple[float, str]]:
    """Compute derived quantities with units by short name, from linear and nonlinear parameters (P + S,)."""
    count = len(term.columns)
    nonlinear = {parameter.name: float(value) for parameter, value in zip(term.free, values[count:], strict=True)}
    return replace(term, **nonlinear).derived(values[:count])
