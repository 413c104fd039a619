"""Averages of series over windows, of one recording or of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import scipy

from estimators.weak_form.resolution import RESOLUTION
from pendulum_env._typing import Array, ArrayLike, Index, Mask
from pendulum_env.physics import Column, KnownLoad, Samples, Term
from pendulum_env.physics.term import Memory

Averages: TypeAlias = "scipy.sparse.csr_array | scipy.sparse.linalg.LinearOperator"  # text: loaded when used


@dataclass(frozen=True, eq=False)
class WindowAverages:
    """Averages over the R windows of one recording, or of several concatenated ones: rows of a regression.

    Attributes:
        samples: samples at N instants.
        moving: mask of instants with a significant velocity (N,); dry friction counts as zero at others.
        acceleration: acceleration at the instants (N,), see `Windows`.
        narrow: matrix (R, N) of averages of series that are already averages over the triangle, as held torque is.
        wider: matrix (R, N) of averages of smooth functions, which includes the triangle.
    """

    samples: Samples
    moving: Mask
    acceleration: Array
    narrow: Averages
    wider: Averages

    @classmethod
    def from_kernel(
        cls, samples: Samples, moving: Mask, acceleration: Array, kernel: Array, centers: Index, scale: Array
    ) -> WindowAverages:
        """Build the averages with a kernel (2 m + 1,) about R centers, times a factor `scale` (R,)."""
        wide = np.convolve(kernel, [1 / 12, 10 / 12, 1 / 12])
        narrow, wider = (_make_averages(weights, centers, scale, len(moving)) for weights in (kernel, wide))
        return cls(samples, moving, acceleration, narrow, wider)

    @classmethod
    def join(cls, parts: Sequence[WindowAverages]) -> WindowAverages:
        """Join the averages of several recordings."""
        if len(parts) == 1:
            return parts[0]
        narrow, wider = (_join_diagonally(every) for every in zip(*((p.narrow, p.wider) for p in parts), strict=True))
        moving, acceleration = (
            np.concatenate(series) for series in zip(*((p.moving, p.acceleration) for p in parts), strict=True)
        )
        return cls(concatenate_samples([series.samples for series in parts]), moving, acceleration, narrow, wider)

    def column(self, column: Column, x: Samples) -> Array:
        """Return a column of the regressor (R,), averaged over the windows, from samples with states (N,)."""
        smooth, dry = column.force(x), column.dry(x)
        if np.ndim(dry) or dry:
            smooth = smooth + dry * np.sign(x.velocity) * self.moving
        averages = _average_series(self.narrow if column.of_torque else self.wider, smooth)
        mass = column.mass(x)
        if np.ndim(mass) or mass:
            averages = averages + self.narrow @ (mass * self.acceleration)
        return np.where(np.isfinite(averages), averages, 0.0)  # a diverged state has no column

    def columns(self, variants: Sequence[Term], samples: Sequence[Samples]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect.

        `samples` has for each variant the samples with its state variables.
        """
        parts = []
        zeros = np.zeros(self.narrow.shape[0])
        for variant, x in zip(variants, samples, strict=True):
            linear = [self.column(c, x) for c in variant.columns]
            # fixed columns are held torques, which are already averages over the triangle
            fixed = sum((_average_series(self.narrow, c.force(x)) for c in variant.fixed), zeros)
            fixed = np.where(np.isfinite(fixed), fixed, 0.0)
            parts.append((np.column_stack(linear) if linear else np.empty((len(zeros), 0)), fixed))
        return parts

    def perturb_fixed_columns(self, term: Term, perturbations: Array) -> Array:
        """Return the fixed columns of a term without memory (R, J) under perturbations of the torque (J,) [N m]."""
        total = np.zeros((self.narrow.shape[0], len(perturbations)))
        for k, perturbation in enumerate(perturbations):  # one at a time fits the processor cache
            samples = replace(self.samples, torque=self.samples.torque + perturbation)
            total[:, k] = sum(_average_series(self.narrow, column.force(samples)) for column in term.fixed)
        return total


def _make_averages(kernel: Array, centers: Index, scale: Array, n: int) -> Averages:
    """Return the sparse matrix (R, n) of averages with a kernel, or an operator if it would be dense."""
    count, length = len(centers), len(kernel)
    first = centers - length // 2
    if count * length > RESOLUTION.density * n:
        return scipy.sparse.linalg.LinearOperator(
            (count, n),
            matvec=lambda series: scale * np.correlate(np.ravel(series), kernel, "valid")[first],
            dtype=np.float64,
        )
    samples = first[:, None] + np.arange(length)
    parts = np.outer(scale, kernel).ravel(), samples.ravel(), length * np.arange(count + 1)
    return scipy.sparse.csr_array(parts, shape=(count, n))


def _join_diagonally(parts: Sequence[Averages]) -> Averages:
    """Join the averages of several recordings to one block-diagonal matrix or operator."""
    if all(scipy.sparse.issparse(averages) for averages in parts):
        return scipy.sparse.csr_array(scipy.sparse.block_diag(parts, "csr"))
    rows, columns = (sum(averages.shape[axis] for averages in parts) for axis in (0, 1))
    ends = np.cumsum([averages.shape[1] for averages in parts])[:-1]

    def average(series: Array) -> Array:
        pieces = np.split(np.ravel(series), ends)
        return np.concatenate([averages @ piece for averages, piece in zip(parts, pieces, strict=True)])

    return scipy.sparse.linalg.LinearOperator((rows, columns), matvec=average, dtype=np.float64)


def _average_series(averages: Averages, series: ArrayLike) -> Array:
    """Average a series (N,), or a constant, over the windows (R,)."""
    return np.asarray(averages @ np.broadcast_to(np.asarray(series, dtype=float), averages.shape[1:]))


def concatenate_samples(parts: Sequence[Samples]) -> Samples:
    """Concatenate samples of several recordings, with the states of the same terms."""
    loads = [
        np.concatenate([np.broadcast_to(value, x.time.shape) for value, x in zip(values, parts, strict=True)])
        for values in zip(*(x.load for x in parts), strict=True)
    ]
    return Samples(
        np.concatenate([x.time for x in parts]),
        np.concatenate([x.position for x in parts]),
        np.concatenate([x.velocity for x in parts]),
        np.concatenate([x.torque for x in parts]),
        concatenate_memory(parts),
        KnownLoad(*loads),
        np.concatenate([np.broadcast_to(x.temperature, x.time.shape) for x in parts]),
    )


def concatenate_memory(parts: Sequence[Samples]) -> dict[str, Memory]:
    """Concatenate the states of the same terms along several recordings."""
    return {
        id: tuple(np.concatenate(series) for series in zip(*(x.memory[id] for x in parts), strict=True))
        for id in parts[0].memory
    }
