"""Competing models, sample by sample: the running model, alone and with each variant of each effect.

All regressions are one batch of the square-root recursion, padded to equal length. Rows are those of the Hamiltonian
scheme, averaged over a bin of a few samples; laws are evaluated for all variants of an effect and all samples of a bin
at once. Each a-priori error has a Student t density. An effect predicts by the mixture of its variants, weighted by
their past likelihoods: the weights include the penalty for a choice among many, and no variant is chosen in advance.

Source: Dawid, JRSS A 147(2), 1984 (prequential); Herbster and Warmuth, Machine Learning 32, 1998 (mixtures that share).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.online.binning import MARGIN, Bin
from estimators.online.recursion import SquareRootLeastSquares
from estimators.regression.least_squares import LEAST_SLOPE, RIDGE
from estimators.regression.recursive import PRIOR
from estimators.selection.score import NU
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Column, Samples, Term
from pendulum_env.physics.term import one, zero

TIME, POSITION, VELOCITY, TORQUE = range(4)  # series of a bin
MEMORY = 3000  # bins, memory of the scale of errors
WEAKEST = -12.0  # least log weight relative to the best variant, so that a variant can recover
PERTURBATION = 1e-3  # [N m], for slopes by the torque
TURNS = 20  # of the fixed point for a scale


class Rows(NamedTuple):
    """Equations of V models over R bins, and their slopes by the torque.

    Attributes:
        phi: (R, V, P).
        y: (R, V) [N m].
        slope: of phi by the torque (R, V, P) [1/(N m)].
        passed: of y by the torque (R, V).
    """

    phi: Array
    y: Array
    slope: Array
    passed: Array

    def error(self, theta: Array) -> Array:
        """Prediction error of the torque with parameters (V, P), (R, V) [N m]."""
        left = self.passed - np.einsum("rvp,vp->rv", self.slope, theta)
        return (self.y - np.einsum("rvp,vp->rv", self.phi, theta)) / np.maximum(left, LEAST_SLOPE)


@dataclass(frozen=True)
class Bins:
    """R bins of n samples each, of one joint or of several.

    Attributes:
        series: time, position, velocity and torque at n + 3 instants (4, R, n + 3).
        y: left-hand side, in units of `scale` (R,).
        period: between samples [s].
        at: name of each one's joint (R,).
        given: columns that come with the bins, of terms whose laws are no functions of one joint (R, G) [N m].
        scale: of errors at each one's joint, relative to those of all (R,).
    """

    series: Array
    y: Array
    period: float
    at: NDArray[np.str_]
    given: Array
    scale: Array

    @classmethod
    def of(cls, bins: Sequence[Bin], period: float, joints: Sequence[str], scale: Array) -> Bins:
        """Several beside each other, of samples so far apart [s], of joints whose errors are so large (J,)."""
        joint = [one.joint for one in bins]
        series, own = np.stack([one.series for one in bins], axis=1), scale[joint]
        y, given = np.array([one.y for one in bins]) / own, np.array([one.phi for one in bins])
        return cls(series, y, period, np.array(joints)[joint], given, own)

    def of_joint(self, name: str) -> Bins:
        """Those of one joint."""
        own = self.at == name
        return Bins(self.series[:, own], self.y[own], self.period, self.at[own], self.given[own], self.scale[own])

    @property
    def middle(self) -> Samples:
        """The instants in the middle of the bins, (R,) each."""
        return Samples(*self.series[:, :, self.series.shape[2] // 2])

    def rows(self, terms: Sequence[Term], count: int = 1) -> Rows:
        """Equations of some terms, whose shape parameters may be those of several variants, of which they are `count`.

        The left-hand side is the torque less all fixed columns.
        """
        shape = len(self.y), count
        phi, slope = np.zeros((2, *shape, sum(len(term.columns) for term in terms)))
        y, passed = np.zeros(shape) + self.y[:, None], np.ones(shape)
        j, given = 0, iter(self.given.T)
        for term in terms:
            own = self.at == term.at
            of_joint = self if own.all() else self.of_joint(term.at)
            scale = of_joint.scale[:, None]
            for column in term.columns:
                if column.mass is zero and column.force is zero and column.dry is zero:
                    phi[..., j] = (next(given) / self.scale)[:, None]
                elif own.any():
                    value, by_torque = of_joint._column(column, column.of_torque)
                    phi[own, :, j], slope[own, :, j] = value / scale, by_torque
                j += 1
            for column in term.fixed if own.any() else ():
                value, by_torque = of_joint._column(column, True)
                y[own] -= value / scale
                passed[own] -= by_torque
        return Rows(phi, y, slope, passed)

    def _column(self, column: Column, of_torque: bool) -> tuple[Array, Array | float]:
        """Mean of a column over the bins (R, V), and its slope by the torque; V is 1 where variants do not differ."""
        x = Samples(*self.series)
        value = self._impulse(column, x)
        if not of_torque:
            return value, 0.0
        return value, (self._impulse(column, replace(x, torque=x.torque + PERTURBATION)) - value) / PERTURBATION

    def _impulse(self, column: Column, x: Samples) -> Array:
        """The impulse view of a column (`schemes.six`), averaged over the bins (R, V)."""
        average = _average(x.velocity.shape[-1])  # (n + 3, n)
        total: Array | float = 0.0
        if column.mass is not zero:
            mass = np.broadcast_to(column.mass(x), x.velocity.shape) if column.mass is one else column.mass(x)
            total = np.mean((mass @ average) * np.diff(x.velocity)[..., 1:-1], axis=-1) / self.period
        if column.force is not zero or column.dry is not zero:
            force = column.force(x)
            if column.dry is not zero:
                force = force + column.dry(x) * np.sign(x.velocity)
            force = np.asarray(force)
            total = total + (force @ average.mean(axis=1) if force.ndim > 1 else force)
        return np.atleast_2d(total).T if np.ndim(total) else np.full((len(self.y), 1), float(total))


@functools.cache
def _average(length: int) -> Array:
    """Mean over the sample before each instant but the margins, of fourth order, as in `schemes.six` (n + 3, n)."""
    mean = np.array([-1.0, 13.0, 13.0, -1.0]) / 24
    return np.column_stack([np.r_[np.zeros(k), mean, np.zeros(length - 4 - k)] for k in range(length - MARGIN)])


def _joined(base: Rows, own: Rows, y: Array, width: int) -> Rows:
    """Equations of the running model with those of V variants beside it, padded to `width` columns."""
    shape = (*own.y.shape, width)
    phi, slope = np.zeros((2, *shape))
    first, last = base.phi.shape[-1], base.phi.shape[-1] + own.phi.shape[-1]
    phi[..., :first], slope[..., :first] = base.phi, base.slope
    phi[..., first:last], slope[..., first:last] = own.phi, own.slope
    return Rows(phi, base.y + own.y - y[:, None], slope, base.passed + own.passed - 1.0)


def _stacked(variants: Sequence[Term]) -> Term:
    """All variants of an effect as one term, whose shape parameters are (V, 1, 1)."""
    if len(variants) == 1:
        return variants[0]
    values = {name: np.array([variant.shape[name] for variant in variants]) for name in variants[0].shape}
    return type(variants[0])(**{name: series[:, None, None] for name, series in values.items()})


class Family:
    """Regressions of the running model with each variant of one effect; the running model alone is a family, too."""

    def __init__(self, terms: Sequence[Term], variants: Sequence[Term], bins: Bins, width: int) -> None:
        """Fit V models with `width` columns at most to R bins; of equal weight so far."""
        self.terms, self.variants, self.width = tuple(terms), tuple(variants), width
        self._stacked = [_stacked(variants)] if variants else []
        own = [column for variant in variants[:1] for column in variant.columns]
        self.first = sum(len(term.columns) for term in terms)
        self.least, self.most = (np.array([getattr(c, name) for c in own]) for name in ("least", "most"))
        rows = self.rows(bins, bins.rows(terms))
        # J = sum phi phi' + 1 / P(0) = L L', of columns scaled to length one;  S = L'^-1, theta = S S' sum phi y
        scale = np.sqrt(np.einsum("rvp,rvp->vp", rows.phi, rows.phi) + 1.0 / PRIOR)
        phi = rows.phi / scale
        information = np.einsum("rvp,rvq->vpq", phi, phi, optimize=True)
        information += np.eye(width) * (RIDGE + 1.0 / (PRIOR * scale**2))[..., None]
        self.root = np.swapaxes(np.linalg.inv(np.linalg.cholesky(information)), 1, 2) / scale[..., None]
        told = np.einsum("rvp,rv->vp", rows.phi, rows.y)
        self.theta = (self.root @ (np.swapaxes(self.root, 1, 2) @ told[..., None]))[..., 0]
        self.residual = rows.error(self.theta)  # (R, V)
        squares = self.residual**2
        square = np.maximum(squares.mean(axis=0), 1e-12)
        for _ in range(TURNS):
            square = np.maximum(((NU + 1) * squares / (NU + squares / square)).mean(axis=0), 1e-12)
        self.square = square * len(squares) / max(1, len(squares) - width)
        self.weight = np.zeros(len(self.theta))  # log

    def rows(self, bins: Bins, base: Rows) -> Rows:
        """Equations of the V models, from those of the running one."""
        return _joined(base, bins.rows(self._stacked, max(1, len(self.variants))), bins.y, self.width)

    @property
    def possible(self) -> Array:
        """Whether the effect is physically possible in each variant (V,)."""
        own = self.theta[:, self.first : self.first + len(self.least)]
        return np.asarray(((own >= self.least) & (own <= self.most)).all(axis=1))

    @property
    def best(self) -> int:
        """Index of the variant that predicted best, among physically possible ones if there are any."""
        return int(np.argmax(np.where(self.possible, self.weight, self.weight - 1e6)))


class Rivals:
    """The running model and the families of effects beside it, as one batch."""

    def __init__(self, families: Sequence[Family], count: int) -> None:
        """Take the families, the running model's own first, and the number of bins that they were fitted to."""
        self.families = tuple(families)
        sizes = [len(family.theta) for family in families]
        width, total, ends = families[0].width, sum(sizes), np.cumsum(sizes, dtype=np.intp)
        self._starts: Index = ends - sizes
        self._of = np.repeat(np.arange(len(sizes)), sizes)  # family of each model
        self._slices = [slice(*pair) for pair in zip(self._starts.tolist(), ends.tolist(), strict=True)]
        self._squares = SquareRootLeastSquares((1, total), width)
        self._squares.theta = np.concatenate([family.theta for family in families])[None]
        self._squares.root = np.concatenate([family.root for family in families])[None]
        self._square = np.concatenate([family.square for family in families])
        self._weight = np.concatenate([family.weight for family in families])
        self._least, self._most = np.full((2, total, width), -np.inf)
        self._most[:] = np.inf
        for family, own in zip(families, self._slices, strict=True):
            columns = slice(family.first, family.first + len(family.least))
            self._least[own, columns], self._most[own, columns] = family.least, family.most
        self._count = count
        self._usable = np.ones((1, total), dtype=bool)

    def take(self, bins: Bins) -> tuple[Array, Array]:
        """Predict R bins one after the other, with an update after each.

        Returns:
            Log density of each under each family (R, F), and the running model's errors (R,) [N m].
        """
        base = bins.rows(self.families[0].terms)
        parts = [family.rows(bins, base) for family in self.families]
        rows = Rows(*(np.concatenate(series, axis=1) for series in zip(*parts, strict=True)))
        told = [self._take(Rows(*(series[r : r + 1] for series in rows))) for r in range(len(bins.y))]
        for family, own in zip(self.families, self._slices, strict=True):
            family.theta, family.root = self._squares.theta[0, own], self._squares.root[0, own]
            family.square, family.weight = self._square[own], self._weight[own]
        densities, errors = zip(*told, strict=True)
        return np.array(densities), np.array(errors) * bins.scale

    def _take(self, rows: Rows) -> tuple[Array, float]:
        """Predict one bin by all models, then update them."""
        squares = self._squares
        error = rows.error(squares.theta[0])[0]
        # e is predicted to scatter by scale^2 (1 + phi' P phi)
        f = (rows.phi[0, :, None] @ squares.root[0])[:, 0]
        spread = 1.0 + np.einsum("vq,vq->v", f, f)
        relative = error**2 / spread
        density = -0.5 * np.log(self._square * spread) - (NU + 1) / 2 * np.log1p(relative / (NU * self._square))
        densities = self._mixed(density)
        self._count += 1
        step = (NU + 1) / (NU + relative / self._square) * relative - self._square
        self._square = np.maximum(self._square + step / min(self._count, MEMORY), 1e-12)
        squares.take(rows.phi[:1], rows.y[:1], self._usable)
        return densities, float(error[0])

    def _mixed(self, density: Array) -> Array:
        """Log density of each mixture (F,), and new weights; impossible variants have that of the running model."""
        theta, starts = self._squares.theta[0], self._starts
        possible = ((theta >= self._least) & (theta <= self._most)).all(axis=1)
        before = np.where(possible, self._weight, -np.inf)
        weight = self._weight + density
        self._weight = np.maximum(weight - np.maximum.reduceat(weight, starts)[self._of], WEAKEST)
        known = np.logaddexp.reduceat(before, starts)
        told = np.logaddexp.reduceat(before + density, starts) - np.where(np.isfinite(known), known, 0.0)
        usable = np.isfinite(known) & np.isfinite(told)
        return np.where(usable, told, density[0])
