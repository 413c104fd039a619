"""Bins of motion, averages of a few samples, and the equations of models on them."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.online.arm_stream import make_stream
from estimators.online.rows import POSITION, TIME, TORQUE, VELOCITY
from estimators.regression.balance import LEAST_SLOPE
from estimators.schemes.six import scheme
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Column, Samples, Term
from pendulum_env.physics.term import return_one, return_zero

BIN = 0.01  # [s], averaging time: long against encoder noise, short against effects
BLOCK = 20  # bins in a block of gains
PERTURBATION = 1e-3  # [N m], for derivatives by the torque
MARGIN = 3  # instants of a bin without a row: two before the first and one after the last


class Bin(NamedTuple):
    """Bin of one joint, with rows of the Hamiltonian scheme.

    Attributes:
        joint: index of the joint.
        series: time, position, velocity and torque at n + 3 instants (4, n + 3).
        phi: mean row of the terms (P,).
        y: mean torque minus the torque of terms without parameters [N m].
    """

    joint: int
    series: Array
    phi: Array
    y: float

    @property
    def time(self) -> float:
        """Time of the first instant [s]."""
        return float(self.series[TIME, 0])


class PlantBins(NamedTuple):
    """Joints of a plant and times of its bins.

    Attributes:
        joints: names of the joints.
        length: duration of a bin divided by the number of joints, since each joint has its own bins [s].
        period: sample time [s].
    """

    joints: tuple[str, ...]
    length: float
    period: float

    def count_bins(self, seconds: float) -> int:
        """Return the number of bins in a time of motion [s]."""
        return round(seconds / self.length)


class Binner:
    """Collection of samples of B plants into bins; bins near stick are left out.

    Attributes:
        plant: joints and times; a pendulum has one joint without a name.
    """

    def __init__(self, rate: float, terms: Sequence[Term], smoothing: Smoothing, batch: int = 1) -> None:
        """Create a binner of the rows of terms for B plants at a sampling rate [Hz]."""
        self._every = max(1, round(BIN * rate))  # samples in a bin
        self._stream = make_stream(terms, [scheme("hamiltonian")], smoothing, 1.0 / rate, batch)
        joints, columns = tuple(self._stream.joints), sum(len(term.columns) for term in terms)
        count = len(joints)
        self.plant = PlantBins(joints, self._every / rate / count, 1.0 / rate)
        shapes = (self._every + MARGIN, 4, batch), (batch, columns + 1), (batch,)
        # of each joint: its last instants, the sum of its equations, and the number of usable ones
        self._parts = [tuple(np.zeros(shape) for shape in shapes) for _ in joints]
        self._step = count * [0]

    def reset(self, which: Mask) -> None:
        """Restart plants (B,) with their next sample."""
        self._stream.reset(which)
        for _, _, n_usable in self._parts:
            n_usable[which] = 0

    def take(self, time: Array, position: Array, torque: Array) -> Iterator[tuple[int, Bin]]:
        """Add a sample of each plant, as `OnlineEstimator.take`; yield plants and their complete bins.

        A bin of n samples is left out if an equation is not usable, or if the instants before it are missing.
        """
        for sample in self._stream.take(time, position, torque):
            j, n_samples, ring = sample.joint, self._every, self._every + MARGIN
            instants, total, n_usable = self._parts[j]
            instants[self._step[j] % ring] = sample.next_instant[[TIME, POSITION, VELOCITY, TORQUE]]
            total += np.where(sample.usable, sample.equations[:, 0], 0.0)
            n_usable += sample.usable[:, 0]
            self._step[j] += 1
            if self._step[j] % n_samples:
                continue
            is_complete, mean = (n_usable == n_samples) & (sample.place > n_samples), total / n_samples
            total[:], n_usable[:] = 0.0, 0
            if is_complete.any():
                series = instants[(self._step[j] + np.arange(ring)) % ring]  # (n + 3, 4, B)
                for b in np.flatnonzero(is_complete).tolist():
                    yield b, Bin(j, series[:, :, b].T.copy(), mean[b, :-1], float(mean[b, -1]))


class ModelRows(NamedTuple):
    """Equations of V models over R bins, and their derivatives by the torque.

    Attributes:
        phi: (R, V, P), divided by the scale of the joint.
        y: (R, V), divided by the scale of the joint [N m].
        slope: derivative of phi by the torque (R, V, P) [1/(N m)].
        y_slope: derivative of y by the torque (R, V).
    """

    phi: Array
    y: Array
    slope: Array
    y_slope: Array

    def linearise(self, theta: Array, error: Array) -> tuple[Array, Array]:
        """Linearise the errors of the predicted torque at theta (..., P), see `competitors`; return phi and y.

        `error` is the error of the torque (...,) [N m].
        """
        return self.phi - error[..., None] * self.slope, self.y - error * np.einsum("...p,...p->...", self.slope, theta)

    def predict(self, theta: Array) -> tuple[Array, Array]:
        """Return the errors of the torque predicted at theta (..., P) [N m], and derivatives of the equations by it.

        The divisor of an error is at least `LEAST_SLOPE`.
        """
        error = self.y - np.einsum("...p,...p->...", self.phi, theta)
        error_slope = self.y_slope - np.einsum("...p,...p->...", self.slope, theta)
        return error / np.maximum(error_slope, LEAST_SLOPE), error_slope

    def select(self, index: Any) -> ModelRows:
        """Select bins or models."""
        return ModelRows(*(series[index] for series in self))


@dataclass(frozen=True)
class Bins:
    """R bins of n samples each, of one or several joints.

    Attributes:
        series: time, position, velocity and torque at n + 3 instants (4, R, n + 3).
        y: mean torque divided by `scale` (R,) [N m].
        period: sample time [s].
        at: name of the joint of each bin (R,).
        link_columns: mean columns of the links of an arm, not divided by `scale` (R, G) [N m]; G = 0 for a pendulum.
        scale: error scale of the joint of each bin, relative to the mean of all joints (R,).
    """

    series: Array
    y: Array
    period: float
    at: NDArray[np.str_]
    link_columns: Array
    scale: Array

    @classmethod
    def stack(cls, bins: Sequence[Bin], period: float, joints: Sequence[str], scale: Array) -> Bins:
        """Stack bins of J joints with an error scale of each (J,); `period` is the sample time [s]."""
        joint = [bin_.joint for bin_ in bins]
        series, bin_scale = np.stack([bin_.series for bin_ in bins], axis=1), scale[joint]
        y, link_columns = np.array([bin_.y for bin_ in bins]) / bin_scale, np.array([bin_.phi for bin_ in bins])
        return cls(series, y, period, np.array(joints)[joint], link_columns, bin_scale)

    def select_joint(self, name: str) -> Bins:
        """Select the bins of one joint."""
        mask = self.at == name
        series = {field: getattr(self, field)[mask] for field in ("y", "at", "link_columns", "scale")}
        return replace(self, series=self.series[:, mask], **series)

    @property
    def middle(self) -> Samples:
        """Return the instants in the middle of the bins, (R,) each."""
        return Samples(*self.series[:, :, self.series.shape[2] // 2])

    def evaluate_rows(self, terms: Sequence[Term], count: int = 1) -> ModelRows:
        """Evaluate the balance of each bin: phi, y and their derivatives by the torque.

        phi and y are divided by `scale`; the derivatives need no scale. Columns of links are those of `link_columns`,
        in the order of `terms`. Each term fills only the bins of its joint. y is the torque minus all fixed columns.
        `count` is the number V of variants; the terms hold their stacked nonlinear parameters.
        """
        shape = len(self.y), count
        phi, slope = np.zeros((2, *shape, sum(len(term.columns) for term in terms)))
        y, y_slope = np.zeros(shape) + self.y[:, None], np.ones(shape)
        j, link_columns = 0, iter(self.link_columns.T)
        for term in terms:
            in_joint = self.at == term.at
            joint_bins = self if in_joint.all() else self.select_joint(term.at)
            scale = joint_bins.scale[:, None]
            for column in term.columns:
                if column.mass is return_zero and column.force is return_zero and column.dry is return_zero:
                    phi[..., j] = (next(link_columns) / self.scale)[:, None]
                elif in_joint.any():
                    value, by_torque = joint_bins._average_column(column, column.of_torque)
                    phi[in_joint, :, j], slope[in_joint, :, j] = value / scale, by_torque
                j += 1
            for column in term.fixed if in_joint.any() else ():
                value, by_torque = joint_bins._average_column(column, True)
                y[in_joint] -= value / scale
                y_slope[in_joint] -= by_torque
        return ModelRows(phi, y, slope, y_slope)

    def evaluate_running(self, terms: Sequence[Term]) -> ModelRows:
        """Evaluate the balance of each bin for one model: (R, P), and (R,)."""
        return self.evaluate_rows(terms).select((slice(None), 0))

    def _average_column(self, column: Column, of_torque: bool) -> tuple[Array, Array | float]:
        """Average a column over the bins (R, V), and differentiate it by the torque; V is 1 for equal variants."""
        x = Samples(*self.series)
        value = self._average_impulse(column, x)
        if not of_torque:
            return value, 0.0
        return value, (self._average_impulse(column, replace(x, torque=x.torque + PERTURBATION)) - value) / PERTURBATION

    def _average_impulse(self, column: Column, x: Samples) -> Array:
        """Average the impulse view of a column (`schemes.six`) over the bins (R, V)."""
        average = _make_averaging_matrix(x.velocity.shape[-1])  # (n + 3, n)
        total: Array | float = 0.0
        if column.mass is not return_zero:
            mass = np.broadcast_to(column.mass(x), x.velocity.shape) if column.mass is return_one else column.mass(x)
            total = np.mean((mass @ average) * np.diff(x.velocity)[..., 1:-1], axis=-1) / self.period
        if column.force is not return_zero or column.dry is not return_zero:
            force = column.force(x)
            if column.dry is not return_zero:
                force = force + column.dry(x) * np.sign(x.velocity)
            force = np.asarray(force)
            total = total + (force @ average.mean(axis=1) if force.ndim > 1 else force)
        return np.atleast_2d(total).T if np.ndim(total) else np.full((len(self.y), 1), float(total))


@functools.cache
def _make_averaging_matrix(length: int) -> Array:
    """Return the matrix that averages over the sample before each instant, of fourth order (n + 3, n)."""
    mean = np.array([-1.0, 13.0, 13.0, -1.0]) / 24
    return np.column_stack([np.r_[np.zeros(k), mean, np.zeros(length - 4 - k)] for k in range(length - MARGIN)])
