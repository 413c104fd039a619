"""Bins of motion, averages of a few samples, and the equations of models on them.

A late torque, of a dead time d and a lag T, is a weighted mean of the torque up to the bin. With the step response
S(t) = 1 - exp(-(t - d) / T) for t > d and its integral G(t), a torque of one held from a to b has the mean

    [G(W - a) - G(W - b) - G(-a) + G(-b)] / W

over a bin from 0 to W.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.online.arm_stream import make_stream
from estimators.online.rows import HELD, INSTANT, POSITION, TIME, TORQUE, VELOCITY
from estimators.online.settings import ONLINE
from estimators.regression.response import LEAST_SLOPE
from estimators.schemes.six import scheme
from estimators.signals.differentiation import STILL, estimate_scatter
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, ArrayLike, Mask
from pendulum_env.physics import Column, Samples, Term
from pendulum_env.physics.term import return_one, return_zero

SERIES = [TIME, POSITION, VELOCITY, TORQUE]  # of a bin
BY_BIN = "y", "at", "link_columns", "scale", "slices", "torque_noise"  # fields of `Bins` with one row per bin
MARGIN = 3  # instants of a bin without a row: two before the first and one after the last


class Bin(NamedTuple):
    """Bin of one joint, with rows of the Hamiltonian scheme.

    Attributes:
        joint: index of the joint.
        series: time, position, velocity and torque at n + 3 instants (4, n + 3).
        phi: mean row of the terms (P,).
        y: mean torque minus the torque of terms without parameters [N m].
        slices: mean torque in slices of `ONLINE.bins.history` bins before the bin, and of the bin (K,) [N m].
        torque_noise, acceleration_noise: standard deviation by noise of mean torque and acceleration [N m], [rad/s^2];
            NaN while it is unknown.
    """

    joint: int
    series: Array
    phi: Array
    y: float
    slices: Array
    torque_noise: float = np.nan
    acceleration_noise: float = np.nan

    @property
    def time(self) -> float:
        """Time of the first instant [s]."""
        return float(self.series[TIME, 0])


@dataclass(frozen=True)
class PlantBins:
    """Joints of a plant, and layout and noise of its bins.

    Attributes:
        joints: names of the joints.
        period: sample time [s].
        n_samples: number of samples in a bin.
        smoothing: smoothing of the measurement.
    """

    joints: tuple[str, ...]
    period: float
    n_samples: int
    smoothing: Smoothing

    @property
    def duration(self) -> float:
        """Return the duration of a bin [s]."""
        return self.n_samples * self.period

    @property
    def length(self) -> float:
        """Return the duration of a bin divided by the number of joints, since each joint has its own bins [s]."""
        return self.duration / len(self.joints)

    def count_bins(self, seconds: float) -> int:
        """Return the number of bins in a time of motion [s]."""
        return round(seconds / self.length)

    @cached_property
    def slice_length(self) -> int:
        """Number of samples in a slice, a divisor of those in a bin."""
        longest = max(1, round(ONLINE.bins.slice / self.period))
        return max(k for k in range(1, longest + 1) if self.n_samples % k == 0)

    @cached_property
    def slice_covariance(self) -> Array:
        """Covariance of the slices by unit white noise of the torque (K, K)."""
        _, held = self.smoothing.make_torque_kernels()
        size, count = self.slice_length, (ONLINE.bins.history + 1) * self.n_samples // self.slice_length
        kernel = np.convolve(held, np.ones(size) / size)
        covariance = np.convolve(kernel, kernel[::-1])[len(kernel) - 1 :: size]
        distance = np.abs(np.arange(count)[:, None] - np.arange(count))
        return np.asarray(np.append(covariance, 0.0)[np.minimum(distance, len(covariance))])

    @cached_property
    def scatter_gain(self) -> float:
        """Scatter of the mean torques of successive bins by white noise, relative to their standard deviation."""
        size = self.n_samples // self.slice_length
        differences = np.repeat([1.0, -4.0, 6.0, -4.0, 1.0], size) / np.sqrt(70.0)  # as `estimate_scatter`
        covariance = self.slice_covariance[: 5 * size, : 5 * size]
        return float(np.sqrt(differences @ covariance @ differences / covariance[:size, :size].sum()))

    def compute_late_weights(self, delay: ArrayLike, lag: ArrayLike) -> Array:
        """Compute weights of slices for the mean torque of a bin after a delay and a lag [s] (V or 1, K)."""
        count = len(self.slice_covariance) + 1
        begin = -ONLINE.bins.history * self.duration
        edges: Array = self.slice_length * self.period * np.arange(count, dtype=float) + begin
        delay, lag = np.reshape(delay, (-1, 1)), np.maximum(np.reshape(lag, (-1, 1)), 1e-9)

        def integrate_step(time: Array) -> Array:
            since = np.maximum(time - delay, 0.0)
            return np.asarray(since + lag * np.expm1(-since / lag))

        later = (integrate_step(self.duration - edges) - integrate_step(-edges)) / self.duration
        weights = -np.diff(later)
        weights[:, 0] += 1.0 - later[:, 0]  # the torque before the history is constant
        return np.asarray(weights)

    @cached_property
    def noise_gains(self) -> tuple[float, float]:
        """Noise of the mean torque over a bin per noise of a sample, and of the mean acceleration per noise [1/s^2]."""
        size = self.n_samples // self.slice_length
        steps = np.append(self.smoothing.make_step_kernels(self.period)[0], np.zeros(self.n_samples))
        of_step = steps - np.roll(steps, self.n_samples)  # change of velocity over a bin
        of_position = np.diff(of_step, prepend=0.0, append=0.0)
        return (
            float(np.sqrt(np.mean(self.slice_covariance[-size:, -size:]))),
            float(np.linalg.norm(of_position)) / self.duration,
        )


class Binner:
    """Collection of samples of B plants into bins; bins near stick are left out.

    Attributes:
        plant: joints and times; a pendulum has one joint without a name.
    """

    def __init__(self, rate: float, terms: Sequence[Term], smoothing: Smoothing, batch: int = 1) -> None:
        """Create a binner of the rows of terms for B plants at a sampling rate [Hz]."""
        n_samples = max(1, round(ONLINE.bins.length * rate))
        self._stream = make_stream(terms, [scheme("hamiltonian")], smoothing, 1.0 / rate, batch)
        joints, columns = tuple(self._stream.joints), sum(len(term.columns) for term in terms)
        self.plant = PlantBins(joints, 1.0 / rate, n_samples, smoothing)
        n_past = max(ONLINE.bins.history * n_samples + 1, MARGIN)
        shapes = (n_samples + n_past, INSTANT, batch), (batch, columns + 1), (batch,)
        # of each joint: its last instants, the sum of its equations, and the number of usable ones
        self._parts = [tuple(np.zeros(shape) for shape in shapes) for _ in joints]
        self._step = len(joints) * [0]
        self._raw = np.zeros((ONLINE.stream.noise, 2, batch * len(joints)))
        self._n_raw, self._noise = 0, np.full((batch * len(joints), 2), np.nan)

    def reset(self, which: Mask) -> None:
        """Restart plants (B,) with their next sample."""
        self._stream.reset(which)
        for *_, n_usable in self._parts:
            n_usable[which] = 0

    def take(self, time: Array, position: Array, torque: Array) -> Iterator[tuple[int, Bin]]:
        """Add a sample of each plant, as `OnlineEstimator.take`; yield plants and their complete bins.

        A bin of n samples is left out if an equation is not usable, or if the instants or torques before it are
        missing.
        """
        raw = self._raw[self._n_raw % ONLINE.stream.noise]
        raw[0], raw[1] = position, torque
        self._n_raw += 1
        if self._n_raw % ONLINE.stream.noise == 0:
            self._update_noise()
        n_samples = self.plant.n_samples
        for sample in self._stream.take(time, position, torque):
            j, step = sample.joint, self._step[sample.joint]
            instants, total, n_usable = self._parts[j]
            instants[step % len(instants)] = sample.next_instant[:INSTANT]
            total += np.where(sample.usable, sample.equations[:, 0], 0.0)
            n_usable += sample.usable[:, 0]
            self._step[j] = step = step + 1
            if step % n_samples:
                continue
            has_past = sample.place > (ONLINE.bins.history + 1) * n_samples
            is_complete, mean = (n_usable == n_samples) & has_past, total / n_samples
            total[:], n_usable[:] = 0.0, 0
            if is_complete.any():
                past = instants[(step + np.arange(len(instants))) % len(instants)]
                series = past[-n_samples - MARGIN :, SERIES]  # (n + 3, 4, B)
                held = past[-(ONLINE.bins.history + 1) * n_samples - 1 : -1, HELD]  # without that of the next instant
                slices = held.reshape(-1, self.plant.slice_length, held.shape[1]).mean(axis=1)
                for b in np.flatnonzero(is_complete).tolist():
                    equation = mean[b, :-1], float(mean[b, -1])
                    noise = self._noise[b + j].tolist()
                    yield b, Bin(j, series[:, :, b].T.copy(), *equation, slices[:, b].copy(), *noise)

    def _update_noise(self) -> None:
        """Estimate the noise of each plant or joint from its last samples, if it moved during most of them."""
        for (position, torque), noise in zip(self._raw.transpose(2, 1, 0), self._noise, strict=True):
            in_motion = np.convolve(np.abs(np.diff(position)) > STILL, np.ones(4), "valid") > 0  # by fourth difference
            if np.isfinite(position + torque).all() and 2 * np.count_nonzero(in_motion) > ONLINE.stream.noise:
                scatter = estimate_scatter(torque), estimate_scatter(position, in_motion)
                noise[:] = np.multiply(scatter, self.plant.noise_gains)


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

        `error` is the error of the torque (...,) [N m]. Equations with a derivative below `LEAST_SLOPE` do not tell
        the torque, and stay as they are.
        """
        by_torque = np.einsum("...p,...p->...", self.slope, theta)
        error = np.where(self.y_slope - by_torque < LEAST_SLOPE, 0.0, error)
        return self.phi - error[..., None] * self.slope, self.y - error * by_torque

    def predict(self, theta: Array) -> tuple[Array, Array]:
        """Return the errors of the torque predicted at theta (..., P) [N m], and derivatives of the equations by it.

        The divisor of an error is at least `LEAST_SLOPE`.
        """
        error = self.y - np.einsum("...p,...p->...", self.phi, theta)
        error_slope = self.y_slope - np.einsum("...p,...p->...", self.slope, theta)
        return error / np.maximum(error_slope, LEAST_SLOPE), error_slope


@dataclass(frozen=True)
class Bins:
    """R bins of n samples each, of one or several joints.

    Attributes:
        series: time, position, velocity and torque at n + 3 instants (4, R, n + 3).
        y: mean torque divided by `scale` (R,) [N m].
        plant: joints and layout of the bins.
        at: name of the joint of each bin (R,).
        link_columns: mean columns of the links, not divided by `scale` (R, G) [N m]; G = 0 for a pendulum.
        scale: error scale of the joint of each bin, relative to the mean of all joints (R,).
        slices: mean torque in slices, see `Bin` (R, K) [N m].
        torque_noise: standard deviation of the noise of y (R,) [N m]; NaN while it is unknown.
    """

    series: Array
    y: Array
    plant: PlantBins
    at: NDArray[np.str_]
    link_columns: Array
    scale: Array
    slices: Array
    torque_noise: Array

    @classmethod
    def stack(cls, bins: Sequence[Bin], plant: PlantBins, scale: Array) -> Bins:
        """Stack bins of J joints with an error scale of each (J,)."""
        joint = [bin_.joint for bin_ in bins]
        series, bin_scale = np.stack([bin_.series for bin_ in bins], axis=1), scale[joint]
        y, link_columns = np.array([bin_.y for bin_ in bins]) / bin_scale, np.array([bin_.phi for bin_ in bins])
        slices, noise = (np.array([getattr(bin_, name) for bin_ in bins]) for name in ("slices", "torque_noise"))
        at = np.array(plant.joints)[joint]
        return cls(series, y, plant, at, link_columns, bin_scale, slices, noise / bin_scale)

    @classmethod
    def join(cls, parts: Sequence[Bins]) -> Bins:
        """Join bins of one plant in the order of the parts."""
        if len(parts) == 1:
            return parts[0]
        by_bin: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in BY_BIN}
        return replace(parts[0], series=np.concatenate([part.series for part in parts], axis=1), **by_bin)

    def select_joint(self, name: str) -> Bins:
        """Select the bins of one joint."""
        mask = self.at == name
        by_bin: dict[str, Any] = {name: getattr(self, name)[mask] for name in BY_BIN}
        return replace(self, series=self.series[:, mask], **by_bin)

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
            if is_late(term):
                late = self.plant.compute_late_weights(term.delay, term.lead) - self.plant.compute_late_weights(
                    0.0, 0.0
                )
                y[in_joint] += joint_bins.slices @ late.T / scale
                continue
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
        return ModelRows(*(series[:, 0] for series in self.evaluate_rows(terms)))

    def _average_column(self, column: Column, of_torque: bool) -> tuple[Array, Array | float]:
        """Average a column over the bins (R, V), and differentiate it by the torque; V is 1 for equal variants."""
        x = Samples(*self.series)
        value = self._average_impulse(column, x)
        if not of_torque:
            return value, 0.0
        step = ONLINE.bins.torque_step
        return value, (self._average_impulse(column, replace(x, torque=x.torque + step)) - value) / step

    def _average_impulse(self, column: Column, x: Samples) -> Array:
        """Average the impulse view of a column (`schemes.six`) over the bins (R, V)."""
        average = _make_averaging_matrix(x.velocity.shape[-1])  # (n + 3, n)
        total: Array | float = 0.0
        if column.mass is not return_zero:
            mass = np.broadcast_to(column.mass(x), x.velocity.shape) if column.mass is return_one else column.mass(x)
            total = np.mean((mass @ average) * np.diff(x.velocity)[..., 1:-1], axis=-1) / self.plant.period
        if column.force is not return_zero or column.dry is not return_zero:
            force = column.force(x)
            if column.dry is not return_zero:
                force = force + column.dry(x) * np.sign(x.velocity)
            force = np.asarray(force)
            total = total + (force @ average.mean(axis=1) if force.ndim > 1 else force)
        return np.atleast_2d(total).T if np.ndim(total) else np.full((len(self.y), 1), float(total))


def is_late(term: Term) -> bool:
    """Return whether a term delays or filters the torque."""
    return bool(np.any(term.delay) or np.any(term.lead))


@functools.cache
def _make_averaging_matrix(length: int) -> Array:
    """Return the matrix that averages over the sample before each instant, of fourth order (n + 3, n)."""
    mean = np.array([-1.0, 13.0, 13.0, -1.0]) / 24
    return np.column_stack([np.r_[np.zeros(k), mean, np.zeros(length - 4 - k)] for k in range(length - MARGIN)])
