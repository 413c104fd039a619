"""Competing models, sample by sample: the running model, alone and with each variant of each effect.

Rows are those of the Hamiltonian scheme, averaged over a bin of a few samples; laws are evaluated for all variants of
an effect and all samples of a bin at once. The running model's recursion is made once for all: y and an effect's own
columns c are regressed on its rows phi, and what is left of y on what is left of c,

    a <- a + K (y - phi' a)       G <- G + K (c - phi' G)'      K = P phi / (1 + phi' P phi)
    S <- S + r r' / (1 + phi' P phi)    t <- t + r e / (1 + phi' P phi)    r = c - G' phi,  e = y - phi' a

which is recursive least squares in phi and c with parameters a - G delta and delta = S^-1 t, and costs a variant its
own columns alone. Each a-priori error has a Student t density. An effect predicts by the mixture of its variants,
weighted by their past likelihoods: the weights include the penalty for a choice among many, and no variant is chosen in
advance.

Source: Frisch and Waugh, Econometrica 1(4), 1933; Dawid, JRSS A 147(2), 1984 (prequential); Herbster and Warmuth,
Machine Learning 32, 1998 (mixtures that share).
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.online.binning import MARGIN, Bin
from estimators.online.forgetting import ForgettingMixture, cap_density
from estimators.online.recursion import SquareRootLeastSquares
from estimators.regression.balance import LEAST_SLOPE
from estimators.regression.least_squares import RIDGE
from estimators.regression.recursive import PRIOR
from estimators.selection.score import log_student, weighted_squares
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Column, Samples, Term
from pendulum_env.physics.term import one, zero

TIME, POSITION, VELOCITY, TORQUE = range(4)  # series of a bin


@dataclass(frozen=True)
class OnlineDiagnosisSettings:
    """Numbers of the online diagnosis; chosen on simulated plants by `benchmarks.online_diagnosis`."""

    memory: int = 3000  # bins, memory of the scale of errors
    weakest: float = -12.0  # least log weight relative to the best variant, so that a variant can recover
    perturbation: float = 1e-3  # [N m], for slopes by the torque
    turns: int = 20  # of the fixed point for a scale
    calibrate: float = 1.0  # [s] of motion in the first fit of all models
    refine: tuple[int, ...] = (2, 4, 8, 16)  # [s] of motion, after which grids of nonlinear parameters are refined
    kept: float = 16.0  # [s] of motion in the first fit of a model that starts later
    stretches: int = 60  # latest blocks of a second, from which probabilities are computed
    together: int = 5  # bins whose equations are computed at once
    recent: float = 10.0  # [s] of motion, averaging time of the reported error
    fewest: int = 5  # blocks of a second for probabilities; with fewer, those of 0.2 s are used
    worth: float = 0.01  # nat a bin, the least gain that counts: errors smaller by one hundredth
    memories: tuple[float, ...] = (1.0, 4.0)  # [s] of motion, of the running model with forgetting
    few: int = 12  # variants of a grid that are run, where a nonlinear parameter is continuous


ONLINE = OnlineDiagnosisSettings()


class ModelRows(NamedTuple):
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

    def rows(self, terms: Sequence[Term], count: int = 1) -> ModelRows:
        """Equations of some terms, with nonlinear parameters of one variant or of `count` variants.

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
        return ModelRows(phi, y, slope, passed)

    def _column(self, column: Column, of_torque: bool) -> tuple[Array, Array | float]:
        """Mean of a column over the bins (R, V), and its slope by the torque; V is 1 where variants do not differ."""
        x = Samples(*self.series)
        value = self._impulse(column, x)
        if not of_torque:
            return value, 0.0
        return value, (
            self._impulse(column, replace(x, torque=x.torque + ONLINE.perturbation)) - value
        ) / ONLINE.perturbation

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


def _stacked(variants: Sequence[Term]) -> Term:
    """All variants of an effect as one term, whose nonlinear parameters are (V, 1, 1)."""
    if len(variants) == 1:
        return variants[0]
    values = {
        name: np.array([variant.nonlinear_values[name] for variant in variants])
        for name in variants[0].nonlinear_values
    }
    return type(variants[0])(**{name: series[:, None, None] for name, series in values.items()})


class Rivals:
    """The running model, and the same with each variant of each effect: V regressions as one batch.

    Attributes:
        terms: of the running model.
        families: variants of each effect (F,); those of the running model alone, of which there are none, come first.
        models: which of the V are each family's (F,).
        residual: of the running model on the bins that all were fitted to, in units of their scale (R,).
        of_y: parameters of the running model, fitted to y alone (V, P).
        of_own: the same, fitted to the variants' own K columns, padded with zeros (V, K, P).
        information: S of what is left of these (V, K, K).
        told: t (V, K).
        square: of the errors' scale (V,) [(N m)^2].
        weight: log of the variants' in their family (V,).
    """

    of_y: Array
    of_own: Array
    information: Array
    told: Array
    square: Array
    weight: Array

    def __init__(
        self,
        terms: Sequence[Term],
        bins: Bins,
        effects: Sequence[Sequence[Term]] = (),
        memories: Sequence[float] = (),
    ) -> None:
        """Fit the running model, and it beside the variants of some effects, to bins; all weigh alike so far.

        With memories [bins], the running model with forgetting predicts beside them.
        """
        self.terms, self.families = tuple(terms), ((), *map(tuple, effects))
        self._stacked = [[_stacked(variants)] if variants else [] for variants in self.families]
        sizes = np.array([max(1, len(variants)) for variants in self.families])
        ends = np.cumsum(sizes, dtype=np.intp)
        self._starts: Index = ends - sizes
        self._of = np.repeat(np.arange(len(sizes)), sizes)  # family of each model
        self.models = [slice(first, end) for first, end in zip(self._starts.tolist(), ends.tolist(), strict=True)]
        columns = [variants[0].columns if variants else () for variants in self.families]
        self._least, self._most = np.full((2, len(self._of), max(map(len, columns))), [[[-np.inf]], [[np.inf]]])
        for own, models in zip(columns, self.models, strict=True):
            self._least[models, : len(own)] = [column.least for column in own]
            self._most[models, : len(own)] = [column.most for column in own]
        self._fit(bins)
        self._forgetting = None
        if memories:
            root = self._running.root[0, 0]
            theta = self.theta_of()[0, : len(root)]
            self._forgetting = ForgettingMixture(theta, root, float(self.square[0]), memories)

    def _own(self, family: int, bins: Bins, base: ModelRows) -> ModelRows:
        """What a family's models add to equations of the running model over bins, padded to K columns."""
        models = self.models[family]
        own = bins.rows(self._stacked[family], models.stop - models.start)
        phi, slope = np.zeros((2, *own.y.shape, self._least.shape[1]))
        phi[..., : own.phi.shape[-1]], slope[..., : own.phi.shape[-1]] = own.phi, own.slope
        return ModelRows(phi, base.y + own.y - bins.y[:, None], slope, base.passed + own.passed - 1.0)

    def _fit(self, bins: Bins) -> None:
        """Family by family, as all would need much memory at once."""
        base = bins.rows(self.terms)
        phi = base.phi[:, 0]
        # J = sum phi phi' + 1 / P(0), of columns scaled to length one
        squares = np.einsum("rp,rp->p", phi, phi)
        weak, scale = _weak(squares), np.sqrt(squares + 1.0 / PRIOR)
        information = (phi / scale).T @ (phi / scale) + np.diag(weak / scale**2)
        root = np.linalg.inv(np.linalg.cholesky(information)).T / scale[:, None]  # P = S S'
        spread, (count, width) = root @ root.T, self._least.shape
        self.of_y, self.of_own = np.zeros((count, len(weak))), np.zeros((count, width, len(weak)))
        self.information, self.told = np.zeros((count, width, width)), np.zeros((count, width))
        self.square, self.weight = np.zeros((2, count))
        for family, models in enumerate(self.models):
            own = self._own(family, bins, base)
            self.of_y[models] = of_y = own.y.T @ phi @ spread
            self.of_own[models] = of_own = np.einsum("rvk,rp->vkp", own.phi, phi, optimize=True) @ spread
            error, left = own.y - phi @ of_y.T, own.phi - np.einsum("rp,vkp->rvk", phi, of_own, optimize=True)
            own_weak = _weak(np.einsum("rvk,rvk->vk", own.phi, own.phi))[..., None] * np.eye(width)
            before = np.einsum("vkp,p,vlp->vkl", of_own, weak, of_own, optimize=True)
            self.information[models] = np.einsum("rvk,rvl->vkl", left, left) + own_weak + before
            before = np.einsum("vkp,p,vp->vk", of_own, weak, of_y, optimize=True)
            self.told[models] = np.einsum("rvk,rv->vk", left, error) + before
            missed, _ = _missed(self.theta_of(models), base.slope[:, 0], own.slope, own.passed, error, left)
            if family == 0:
                self.residual = missed[:, 0]
            squares = missed**2  # (R, V)
            square = np.maximum(squares.mean(axis=0), 1e-12)
            for _ in range(ONLINE.turns):
                square = np.maximum(weighted_squares(squares, square).mean(axis=0), 1e-12)
            self.square[models] = square * len(phi) / max(1, len(phi) - len(weak) - width)
        self._count, self._running = len(phi), SquareRootLeastSquares((1, 1), len(weak))
        self._running.root = root[None, None]

    def theta_of(self, models: slice = slice(None)) -> Array:
        """Parameters of the running model and own ones, of some of the models (V, P + K)."""
        delta = np.linalg.solve(self.information[models], self.told[models][..., None])[..., 0]
        base = self.of_y[models] - np.einsum("vk,vkp->vp", delta, self.of_own[models])
        return np.concatenate([base, delta], axis=1)

    def possible(self, theta: Array) -> Mask:
        """Whether the effect is physically possible in each model (V,) of parameters (V, P + K)."""
        own = theta[:, self.of_y.shape[1] :]
        return np.asarray(((own >= self._least) & (own <= self._most)).all(axis=1))

    def leaders(self) -> list[tuple[tuple[Term, ...], Array]]:
        """Of each family the variant that predicted best, of possible ones if there are any, and parameters."""
        theta = self.theta_of()
        weight = np.where(self.possible(theta), self.weight, self.weight - 1e6)
        best = [int(np.argmax(weight[models])) for models in self.models]
        each = zip(self.families, self.models, best, strict=True)
        return [(variants[k : k + 1], theta[models][k]) for variants, models, k in each]

    def take(self, bins: Bins) -> tuple[Array, Array]:
        """Predict R bins one after the other, with an update after each.

        Returns:
            Log density of each under each family (R, F) and, in the last place, of the running model with forgetting,
            if that runs; and the running model's errors (R,) [N m].
        """
        base = bins.rows(self.terms)
        parts = [self._own(family, bins, base) for family in range(len(self.families))]
        own = ModelRows(*(np.concatenate(series, axis=1) for series in zip(*parts, strict=True)))
        rows = zip(base.phi[:, 0], base.slope[:, 0], *own, strict=True)
        densities, errors = zip(*(self._take(*row) for row in rows), strict=True)
        return np.array(densities), np.array(errors) * bins.scale

    def _take(
        self, phi: Array, slope: Array, own: Array, y: Array, own_slope: Array, passed: Array
    ) -> tuple[Array, float]:
        """Predict one bin by all models, then update them."""
        running, theta = self._running, self.theta_of()
        gain = running.root[0, 0] @ (phi @ running.root[0, 0])
        spread = 1.0 + phi @ gain
        error, left = y - self.of_y @ phi, own - self.of_own @ phi  # (V,), (V, K)
        missed, after = _missed(theta, slope, own_slope, passed, error, left)
        # the error is predicted to scatter by scale^2 times this
        unsure = spread + np.einsum("vk,vk->v", left, np.linalg.solve(self.information, left[..., None])[..., 0])
        density = log_student(missed**2, self.square * unsure)
        density = cap_density(density, after, density[0])
        densities = self._mixed(density, self.possible(theta))
        self._count += 1
        if self._forgetting is not None:
            forgetting = self._forgetting.take(phi, slope, float(passed[0]), float(y[0]), float(density[0]))
            densities = np.append(densities, forgetting)
        step = weighted_squares(missed**2 / unsure, self.square) - self.square
        self.square = np.maximum(self.square + step / min(self._count, ONLINE.memory), 1e-12)
        running.take(phi[None, None], np.zeros((1, 1)), np.ones((1, 1), dtype=bool))
        self.of_y += error[:, None] * (gain / spread)
        self.of_own += left[..., None] * (gain / spread)
        self.information += left[:, :, None] * left[:, None] / spread
        self.told += left * error[:, None] / spread
        return densities, float(missed[0])

    def _mixed(self, density: Array, possible: Mask) -> Array:
        """Log density of each mixture (F,), and new weights; impossible variants have that of the running model."""
        starts = self._starts
        before = np.where(possible, self.weight, -np.inf)
        weight = self.weight + density
        self.weight = np.maximum(weight - np.maximum.reduceat(weight, starts)[self._of], ONLINE.weakest)
        known = np.logaddexp.reduceat(before, starts)
        told = np.logaddexp.reduceat(before + density, starts) - np.where(np.isfinite(known), known, 0.0)
        usable = np.isfinite(known) & np.isfinite(told)
        return np.where(usable, told, density[0])

    def narrowed(self, bins: Bins, fresh: Mapping[str, Sequence[Term]]) -> Rivals:
        """Copy with grids of continuous nonlinear parameters narrowed around the best variants.

        Takes all bins so far, and fresh grids by effect. What is as before goes on with all that it has learnt.
        """
        grids = list(self.families[1:])
        for family, ((best,), _) in enumerate(self.leaders()[1:], 1):
            if not all(parameter.integer for parameter in best.nonlinear_parameters):
                grids[family - 1] = self._around(best, family, fresh[best.id])
        new = Rivals(self.terms, bins, grids)
        new._running.root, new._forgetting = self._running.root, self._forgetting
        for before, ours, after, theirs in zip(self.families, self.models, new.families, new.models, strict=True):
            if before == after:
                for name in ("of_y", "of_own", "information", "told", "square"):
                    getattr(new, name)[theirs] = getattr(self, name)[ours]
            old = dict(zip(before, self.weight[ours].tolist(), strict=False))
            share = -np.log(max(1, len(after)))  # the best one's weight, shared among those that are new
            new.weight[theirs] = [old.get(variant, share) for variant in after] or self.weight[ours]
        return new

    def _around(self, best: Term, family: int, fresh: Sequence[Term]) -> tuple[Term, ...]:
        """The best two variants, those halfway to the neighbours of the best, and some of a fresh grid."""
        variants, near = self.families[family], []
        kept = [variants[k] for k in np.argsort(-self.weight[self.models[family]])[:2]]
        for parameter in best.free:
            value = best.nonlinear_values[parameter.name]
            if parameter.integer or not np.isfinite(value):
                continue
            values = np.unique([variant.nonlinear_values[parameter.name] for variant in variants])
            values = values[np.isfinite(values)]
            at = int(np.searchsorted(values, value))
            lower = values[at - 1] if at else value / 2
            upper = values[at + 1] if at + 1 < len(values) else 2 * value
            for other in (lower, upper):
                middle = np.sqrt(value * other) if value * other > 0 else 0.5 * (value + other)
                if parameter.low <= middle <= parameter.high:
                    near.append(replace(best, **{parameter.name: float(middle)}))
        return tuple(dict.fromkeys([*kept, best, *near, *thinned(fresh)]))


def _missed(
    theta: Array, slope: Array, own_slope: Array, passed: Array, error: Array, left: Array
) -> tuple[Array, Array]:
    """Residuals of V models (..., V) as torques: over their slopes by the torque, which is in their columns, too.

    Also returns these slopes (..., V).

    Takes parameters (V, P + K), slopes of the running model's columns (..., P), of own ones (..., V, K) and of y
    (..., V), and what the running model's columns leave of y and of own columns.
    """
    base, delta = theta[:, : slope.shape[-1]], theta[:, slope.shape[-1] :]
    after = passed - slope @ base.T - np.einsum("...vk,vk->...v", own_slope, delta)
    missed = error - np.einsum("...vk,vk->...v", left, delta)
    return np.asarray(missed / np.maximum(after, LEAST_SLOPE)), after


def _weak(squares: Array) -> Array:
    """Information on each parameter before any equation, for sums of squares of its column."""
    return 1.0 / PRIOR + RIDGE * (squares + 1.0 / PRIOR)


def thinned(variants: Sequence[Term]) -> list[Term]:
    """List all variants with whole parameters alone; of others as many as are run."""
    if len(variants) <= ONLINE.few or all(parameter.integer for parameter in variants[0].nonlinear_parameters):
        return list(variants)
    return [variants[k] for k in np.unique(np.linspace(0, len(variants) - 1, ONLINE.few).round().astype(int))]
