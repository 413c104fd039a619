"""Kind of a detected change: the model refitted to the rows since then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.online.binning import BLOCK, Bin
from estimators.selection.score import NU
from estimators.signals.residual import profile, weight
from pendulum_env._typing import Array, Index, Mask


@dataclass(frozen=True)
class WatchSettings:
    """Numbers of the watch; chosen on simulated plants by `benchmarks.watching`."""

    significant: float = 4.0  # standard errors, from which a change of a parameter is reported
    splits: int = 24  # trial times of the change
    walk: float = 0.003  # random walk of each parameter, relative to its size [1/sqrt(s)]
    least: float = 0.004  # of the RMS torque, error of no practical consequence
    learn: float = 0.5  # of the calibration time, after which the size of errors is learnt
    kept: float = 10.0  # [s] of motion by which a change is judged
    kept_turns: int = 24  # reversals by which a change is judged
    fewest: float = 0.5  # [s] of motion after a change, needed to judge its kind
    sure: float = 2.5  # [s] of motion, after which a change that a refit explains is called a value
    kind: float = 5.0  # standard errors by which errors of a refit exceed their former size, from which it is structure


WATCH = WatchSettings()


@dataclass(frozen=True)
class Rows:
    """R rows of a model, of one joint or of several, in standard deviations of their errors while it holds.

    Attributes:
        phi: (R, P).
        y: (R,).
        scale: those standard deviations (R,) [N m].
        joint: whose they are (R,).
        series: time, position and velocity (3, R).
    """

    phi: Array
    y: Array
    scale: Array
    joint: Index
    series: Array

    @classmethod
    def of(cls, bins: Sequence[Bin], scale: Array) -> Rows:
        """Rows of bins, and the standard deviation of each joint's errors (J,)."""
        joint = np.array([one.joint for one in bins], dtype=np.intp)
        own = scale[joint]
        phi, y = np.array([one.phi for one in bins]), np.array([one.y for one in bins])
        return cls(phi / own[:, None], y / own, own, joint, np.array([one.series[:3, -2] for one in bins]).T)

    def __getitem__(self, some: slice | Mask) -> Rows:
        return Rows(self.phi[some], self.y[some], self.scale[some], self.joint[some], self.series[:, some])

    def error(self, theta: Array) -> Array:
        """Residual (R,) of parameters (P,)."""
        return np.asarray(self.y - self.phi @ theta)

    def place_of_errors(self, theta: Array) -> dict[str, tuple[float, float]]:
        """The quantity on which errors depend most, and its range where they are largest."""
        values = {"position": self.series[1], "velocity": self.series[2], "torque": self.y * self.scale}
        found = [profile(axis, along, self.error(theta), 1.0) for axis, along in values.items()]
        most = max(found, key=weight)
        worst = int(np.argmax(np.abs(most.mean / most.error)))
        return {most.axis: (float(most.edges[worst]), float(most.edges[worst + 1]))}


@dataclass(frozen=True)
class Known:
    """Estimates of a model before the change.

    Attributes:
        theta: its parameters (P,).
        covariance: theirs (P, P).
        sizes: of the parameters, scale of their changes (P,).
        square: mean square of errors at the joint where they are largest [(N m)^2].
    """

    theta: Array
    covariance: Array
    sizes: Array
    square: float

    def refit(self, rows: Rows) -> Array:
        """Parameters (P,) that fit rows, with a weak prior at their former values."""
        weak = np.diag(1.0 / self.sizes)
        both = np.vstack([rows.phi, weak]), np.concatenate([rows.y, weak @ self.theta])
        return np.asarray(np.linalg.lstsq(*both, rcond=None)[0])

    def root(self, rows: Rows) -> Array:
        """Factor of the covariance of such a fit for unit noise (P, P)."""
        phi = rows.phi * rows.scale[:, None]
        weak = np.diag((rows.scale.mean() / self.sizes) ** 2)
        return np.asarray(np.linalg.cholesky(np.linalg.inv(phi.T @ phi + weak)))

    def moment(self, rows: Rows, last: int) -> tuple[int, Array]:
        """Row of the change, up to a last possible one, and the parameters (P,) after it."""
        before = np.concatenate([[0.0], np.cumsum(density(rows.error(self.theta)))])

        def best(splits: Index) -> tuple[int, Array]:
            later = [rows[k:] for k in splits]
            fits = [self.refit(part) for part in later]
            gains = [
                before[k] + density(part.error(fit)).sum() for k, part, fit in zip(splits, later, fits, strict=True)
            ]
            place = int(np.argmax(gains))
            return int(splits[place]), fits[place]

        k, _ = best(np.unique(np.linspace(0, last, WATCH.splits).astype(np.intp)))
        step = -(-last // (WATCH.splits - 1))
        return best(np.arange(max(0, k - step), min(last, k + step) + 1))

    def std(self, rows: Rows, error: Array) -> Array:
        """Standard errors of changes (P,): of a fit whose errors are correlated over blocks, and of what was known."""
        phi, joints = rows.phi, len(np.unique(rows.joint))
        bread = np.linalg.pinv(phi.T @ phi)
        scores = np.add.reduceat(phi * error[:, None], np.arange(0, len(error), BLOCK * joints))
        fit = np.maximum(np.diag(bread @ (scores.T @ scores) @ bread), np.diag(bread))
        return np.asarray(np.sqrt(fit + np.diag(self.covariance)))

    def changes(self, names: Sequence[str], theta: Array, std: Array) -> dict[str, tuple[float, float]]:
        """Significant changes of parameters and their standard errors, by name, most significant first."""
        delta = theta - self.theta
        order = np.argsort(-np.abs(delta) / std)
        return {names[j]: (float(delta[j]), float(std[j])) for j in order if abs(delta[j]) > WATCH.significant * std[j]}


def density(error: Array) -> Array:
    """Log density of Student's t, but for its constant."""
    return np.asarray(-(NU + 1) / 2 * np.log1p(error**2 / NU))
