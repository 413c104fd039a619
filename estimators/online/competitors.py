"""Competing models: the running model, alone and with each variant of each effect.

Rows are those of the Hamiltonian scheme, averaged over a bin of a few samples. Laws are evaluated together for all
variants of an effect and all samples of a bin. All models share the recursion of the running model: y and the columns c
of an effect are regressed on its rows phi, and then the residual of y on the residual of c,

    a <- a + K (y - phi' a)       G <- G + K (c - phi' G)'      K = P phi / (1 + phi' P phi)
    S <- S + r r' / (1 + phi' P phi)    t <- t + r e / (1 + phi' P phi)    r = c - G' phi,  e = y - phi' a

which equals recursive least squares in phi and c with parameters a - G delta and delta = S^-1 t. A variant costs only
its own columns. Parameters of effects stay within their bounds. Each a-priori error has a Student t density. The
prediction of an effect is the mixture of its variants, weighted by their past likelihoods. The mixture includes the
penalty for the choice among variants.

The last family is the running model with exponential forgetting of parameters and error scale, with several memories
and without. It predicts better than the running model after parameters have changed. The running model in the mixture
bounds the loss if no parameter changes. Each weight is at least a share of the largest, so a memory recovers quickly.

A column may depend on the explained torque, as that of load-dependent friction. Least squares would then explain torque
by torque. The error of the predicted torque is e = (y - phi' theta) / (dy - dphi' theta), with derivatives by the
torque. It is linearised at the current estimates (Gauss-Newton): rows phi - e dphi explain y - e dphi' theta.

Source: Frisch and Waugh, Econometrica 1(4), 1933; Dawid, JRSS A 147(2), 1984 (prequential); Herbster and Warmuth,
Machine Learning 32, 1998 (mixtures that share); Ljung, System Identification, 2nd edition, section 11.2 (forgetting).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.decisions.score import MAX_ITERATIONS, compute_log_student, weigh_squares
from estimators.online.binning import Bins, ModelRows, PlantBins, is_late
from estimators.online.recursion import RootRecursion
from estimators.online.settings import ONLINE
from estimators.online.work import Work
from estimators.regression.least_squares import RIDGE
from estimators.regression.recursive import PRIOR
from estimators.regression.response import LEAST_SLOPE
from pendulum_env._typing import Array, ArrayLike, Index, Mask
from pendulum_env.physics import Term


def _stack_variants(variants: Sequence[Term]) -> Term:
    """Stack V > 1 variants of an effect into one term with nonlinear parameters (V, 1, 1): variant, bin, sample."""
    if len(variants) == 1:
        return variants[0]
    values = {name: np.array([getattr(variant, name) for variant in variants]) for name in variants[0].nonlinear_values}
    return type(variants[0])(**{name: series[:, None, None] for name, series in values.items()})


class LateTorque(NamedTuple):
    """Variants of a late torque, with the derivative by its delay or lag as a column.

    Attributes:
        values: delay or lag of each variant (V,) [s].
        weights: weights of the slices of torque (V, K).
        change: the same minus those of a torque without delay (V, K).
        slope: derivative of the weights by the delay or lag (V, K) [1/s].
        at: name of the joint.
    """

    values: Array
    weights: Array
    change: Array
    slope: Array
    at: str

    @classmethod
    def build(cls, term: Term, plant: PlantBins) -> LateTorque:
        """Build the weights of a term with stacked nonlinear parameters."""
        delay, lag = (np.ravel(value) for value in np.broadcast_arrays(term.delay, term.lead))
        weights = plant.compute_late_weights(delay, lag)
        step = ONLINE.models.late_step
        more = plant.compute_late_weights(delay * (1.0 + step), lag * (1.0 + step))
        slope = (more - weights) / (step * (delay + lag))[:, None]
        return cls(delay + lag, weights, weights - plant.compute_late_weights(0.0, 0.0), slope, term.at)

    def select(self, models: slice) -> LateTorque:
        """Select some variants."""
        values, weights, change, slope, at = self
        return LateTorque(values[models], weights[models], change[models], slope[models], at)

    def compute_noise_share(self, covariance: Array) -> Array:
        """Compute the share of the variance of torque noise that passes, as a quadratic in changes of `values` (3, V).

        `covariance` is that of the slices (K, K).
        """
        on_time = self.weights - self.change
        products = ((self.weights, self.weights), (2.0 * self.weights, self.slope), (self.slope, self.slope))
        variances = [np.sum((a @ covariance) * b, axis=1) for a, b in products]
        return np.asarray(variances / np.sum((on_time @ covariance) * on_time, axis=1))

    def evaluate_rows(self, bins: Bins, base: ModelRows, width: int) -> ModelRows:
        """Evaluate the torque balance with each variant, see `CompetingModels`; `width` is the number of columns."""
        slices = np.where(bins.at == self.at, 1.0 / bins.scale, 0.0)[:, None] * bins.slices
        phi, slope = np.zeros((2, len(slices), len(self.values), width))
        phi[..., 0] = -slices @ self.slope.T
        y = base.y[:, None] + slices @ self.change.T
        return ModelRows(phi, y, slope, np.broadcast_to(base.y_slope[:, None], y.shape))


class CompetingModels:
    """The running model, alone and with each variant of each effect: V regressions as one batch.

    Attributes:
        terms: terms of the running model.
        families: variants of each effect (F,). The first family, the running model alone, is empty. With memories, the
            last family, the running model without and with forgetting, is also empty.
        models: slice of the V models of each family (F,).
        residual: residual of the running model on the fitted bins, in units of their scale (R,).
        y_on_base: a, regression of y on the rows of the running model (V, P).
        columns_on_base: G, regression of the K columns of the variants, padded with zeros (V, K, P).
        information: S (V, K, K).
        moment: t (V, K).
        square: squared error scale (V,) [(N m)^2].
        weight: log weight of each variant in its family (V,).
    """

    def __init__(
        self,
        terms: Sequence[Term],
        plant: PlantBins,
        effects: Sequence[Sequence[Term]] = (),
        memories: Sequence[float] = (),
    ) -> None:
        """Create the running model, with variants of each effect and memories of forgetting [bins], without a fit.

        All variants have the same weight.
        """
        self.terms, self._plant, self._memories = tuple(terms), plant, tuple(memories)
        self.families = ((), *map(tuple, effects), *([()] if memories else []))
        self._n_named = 1 + len(effects)  # families without that of the memories
        self._stacked = [[_stack_variants(variants)] if variants else [] for variants in self.families]
        sizes = np.array([max(1, len(variants)) for variants in self.families])
        sizes[-1] += len(self._memories)
        ends = np.cumsum(sizes, dtype=np.intp)
        self._starts: Index = ends - sizes
        self._family = np.repeat(np.arange(len(sizes)), sizes)  # family of each model
        self.models = [slice(first, end) for first, end in zip(self._starts.tolist(), ends.tolist(), strict=True)]
        columns = [variants[0].columns if variants else () for variants in self.families]
        self._lower, self._upper = np.full(
            (2, len(self._family), max(1, *map(len, columns))), [[[-np.inf]], [[np.inf]]]
        )
        for family_columns, models in zip(columns, self.models, strict=True):
            self._lower[models, : len(family_columns)] = [column.least for column in family_columns]
            self._upper[models, : len(family_columns)] = [column.most for column in family_columns]
        self._forgets = np.arange(len(self._family)) >= len(self._family) - len(memories)  # models (V,)
        setting = ONLINE.models
        self._min_weight = np.where(self._family < self._n_named, setting.least_weight, setting.least_memory_weight)
        self._noise_share = np.repeat([[1.0], [0.0], [0.0]], len(self._family), axis=1)  # see `_compute_absorbed_noise`
        self._late: dict[int, LateTorque] = {}  # by family
        for family, stacked in enumerate(self._stacked):
            for term in filter(is_late, stacked):
                self._late[family] = late = LateTorque.build(term, plant)
                self._noise_share[:, self.models[family]] = late.compute_noise_share(plant.slice_covariance)
                self._lower[self.models[family], 0] = -0.5 * late.values
                self._upper[self.models[family], 0] = late.values
        parameters, (count, width) = sum(len(term.columns) for term in self.terms), self._lower.shape
        self.y_on_base, self.columns_on_base = np.zeros((count, parameters)), np.zeros((count, width, parameters))
        self.information, self.moment = np.zeros((count, width, width)), np.zeros((count, width))
        self.square, self.weight = np.zeros((2, count))
        self.weight[self._forgets] = ONLINE.models.least_memory_weight

    @classmethod
    def fit(
        cls,
        terms: Sequence[Term],
        bins: Bins,
        effects: Sequence[Sequence[Term]] = (),
        memories: Sequence[float] = (),
    ) -> Work[CompetingModels]:
        """Create models as the constructor, and fit them to bins."""
        yield
        models = cls(terms, bins.plant, effects, memories)
        yield from models._fit_families(bins, range(len(models.families)))
        return models

    def _evaluate_effect_rows(self, family: int, part: slice, bins: Bins, base: ModelRows) -> ModelRows:
        """Evaluate the columns that variants of a family add to the running model, padded to K columns."""
        variants, models = self.families[family], self.models[family]
        count = len(range(models.stop - models.start)[part])
        if family in self._late:
            return self._late[family].select(part).evaluate_rows(bins, base, self._lower.shape[1])
        is_whole = count == models.stop - models.start
        stacked = self._stacked[family] if is_whole or not variants else [_stack_variants(variants[part])]
        rows = bins.evaluate_rows(stacked, count)
        phi, slope = np.zeros((2, *rows.y.shape, self._lower.shape[1]))
        phi[..., : rows.phi.shape[-1]], slope[..., : rows.phi.shape[-1]] = rows.phi, rows.slope
        y, y_slope = base.y[:, None] + rows.y - bins.y[:, None], base.y_slope[:, None] + rows.y_slope - 1.0
        return ModelRows(phi, y, slope, y_slope)

    def _fit_families(self, bins: Bins, families: Sequence[int]) -> Work[None]:
        """Fit the running model and some families, with their error scales, to bins."""
        yield
        base, root, self.residual = _fit_running(bins.evaluate_running(self.terms))
        self._count = len(base.phi)
        factors = (1.0, *(1.0 - 1.0 / max(memory, 2.0) for memory in self._memories))
        self._recursion = RootRecursion(root, factors)
        for family in families:
            for part in self._split_family(family, self._count):
                yield
                yield from self._fit_variants(family, part, bins, base, root @ root.T)

    def _split_family(self, family: int, rows: int) -> Iterator[slice]:
        """Split the variants of a family into parts with a limited number of rows."""
        count, size = self.models[family].stop - self.models[family].start, max(1, ONLINE.work.rows // rows)
        return (slice(first, min(first + size, count)) for first in range(0, count, size))

    def _fit_variants(self, family: int, part: slice, bins: Bins, base: ModelRows, P: Array) -> Work[None]:
        """Fit variants of a family; `base` are the linearised rows of the running model, P its covariance."""
        first = self.models[family].start
        models = slice(first + part.start, first + part.stop)
        (rows, parameters), width = base.phi.shape, self._lower.shape[1]
        # the prior of the running model as further rows; their y and effect columns are 0
        phi = np.concatenate([base.phi, np.eye(parameters) / np.sqrt(PRIOR)])
        family_rows = self._evaluate_effect_rows(family, part, bins, base)
        residual, delta = np.repeat(self.residual[:, None], family_rows.y.shape[1], axis=1), self.moment[models]
        for _ in range(ONLINE.models.tangents if family_rows.slope.any() else 1):
            yield
            columns, y = family_rows.linearise(delta, residual)
            self.y_on_base[models] = y.T @ base.phi @ P
            self.columns_on_base[models] = np.einsum("rvk,rp->vkp", columns, base.phi, optimize=True) @ P
            error = -phi @ self.y_on_base[models].T
            remaining = -np.einsum("rp,vkp->rvk", phi, self.columns_on_base[models], optimize=True)
            error[:rows] += y
            remaining[:rows] += columns
            prior = 1.0 / PRIOR + RIDGE * (np.einsum("rvk,rvk->vk", columns, columns) + 1.0 / PRIOR)
            self.information[models] = np.einsum("rvk,rvl->vkl", remaining, remaining)
            self.information[models] += prior[..., None] * np.eye(width)
            self.moment[models] = np.einsum("rvk,rv->vk", remaining, error)
            theta = self.compute_theta(models)
            residual, _ = _predict(theta, base, family_rows)
            delta = theta[:, parameters:]
        yield
        square = np.maximum((residual**2).mean(axis=0), 1e-12)
        for _ in range(MAX_ITERATIONS):
            noise = self._compute_absorbed_noise(theta, bins.torque_noise[:, None], square, models)  # (R, V)
            square = np.maximum(weigh_squares(residual**2 + noise, square).mean(axis=0), 1e-12)
        self.square[models] = square * rows / max(1, rows - parameters - width)

    def compute_theta(self, models: slice = slice(None)) -> Array:
        """Compute the parameters of the running model and of the effect for some models (V, P + K)."""
        return self._solve_parameters(models)[0]

    def _solve_parameters(self, models: slice = slice(None)) -> tuple[Array, Array]:
        """Solve for parameters within their bounds (V, P + K), and the information of those within (V, K, K)."""
        bounds = self._lower[models], self._upper[models]
        delta, information = solve_each_within_bounds(self.information[models], self.moment[models], *bounds)
        base = self.y_on_base[models] - np.einsum("vk,vkp->vp", delta, self.columns_on_base[models])
        return np.concatenate([base, delta], axis=1), information

    def select_best(self) -> list[tuple[tuple[Term, ...], Array]]:
        """Return the variant of each family that predicted best, and its parameters; those of memories are left out."""
        theta = self.compute_theta()
        pairs = zip(self.families[: self._n_named], self.models[: self._n_named], strict=True)
        best = []
        for family, (variants, models) in enumerate(pairs):
            k = int(np.argmax(self.weight[models]))
            variant, of_variant = variants[k : k + 1], theta[models][k]
            if family in self._late:
                (parameter,) = variant[0].nonlinear_parameters
                value = self._late[family].values[k] + of_variant[len(self.y_on_base[0])]
                variant = (replace(variant[0], **{parameter.name: float(value)}),)
            best.append((variant, of_variant))
        return best

    def take(self, bins: Bins) -> Work[tuple[Array, Array]]:
        """Predict R bins in sequence, with an update after each.

        Returns:
            Log density of each bin under each family, and its squared error (R, F) each [(N m)^2].
        """
        base, family_rows, predictions = bins.evaluate_running(self.terms), [], []
        for family in range(len(self.families)):
            yield
            family_rows.append(self._evaluate_effect_rows(family, slice(None), bins, base))
        rows = ModelRows(*(np.concatenate(series, axis=1) for series in zip(*family_rows, strict=True)))
        of_bins = [map(ModelRows._make, zip(*series, strict=True)) for series in (base, rows)]
        for bin_ in zip(*of_bins, bins.torque_noise, strict=True):
            yield
            predictions.append(self._predict_bin(*bin_))
        densities, squares = zip(*predictions, strict=True)
        return np.array(densities), np.array(squares) * bins.scale[:, None] ** 2

    def _compute_absorbed_noise(
        self, theta: Array, noise: ArrayLike, square: Array, models: slice = slice(None)
    ) -> Array:
        """Return the variance of torque noise that late torques of some models do not pass (..., V) [(N m)^2].

        It is added to their squared errors; else a lag would predict better by smoothing noise. The noise of y
        [N m] explains at most the squared error scale (V,).
        """
        (value, slope, curvature), delta = self._noise_share[:, models], theta[:, self.y_on_base.shape[1]]
        absorbed = 1.0 - (value + slope * delta + curvature * delta**2)
        return np.asarray(np.maximum(absorbed, 0.0) * np.fmin(np.square(noise), square))

    def _predict_bin(self, base: ModelRows, rows: ModelRows, noise: float) -> tuple[Array, Array]:
        """Predict one bin with torque noise [N m] by all models, then update them.

        `base` is the row of the running model (P,), `rows` those of the effects (V, K), see `_evaluate_effect_rows`.

        Returns:
            The log density under each family, and its squared error, a mean over its variants (F,) each.
        """
        (theta, information), parameters = self._solve_parameters(), len(base.phi)
        residual, error_slope = _predict(theta, base, rows)
        columns, y = rows.linearise(theta[:, parameters:], residual)
        phi, y = base._replace(y=y).linearise(theta[0, :parameters], residual[0])
        of_memory = np.where(self._forgets, np.cumsum(self._forgets), 0)  # number of the memory of each model
        gain = self._recursion.compute_direction(phi)[of_memory]
        variance = 1.0 + gain @ phi
        gain /= variance[:, None]
        error, remaining = y - self.y_on_base @ phi, columns - self.columns_on_base @ phi  # (V,), (V, K)
        # predicted variance of the error, relative to the squared scale
        variance_ratio = variance + np.einsum("vk,vk->v", remaining, _solve_positive(information, remaining))
        squares = residual**2 + self._compute_absorbed_noise(theta, noise, self.square)
        density = compute_log_student(squares, self.square * variance_ratio)
        # a law that passes almost none of the torque always has small errors
        density = np.where(error_slope < LEAST_SLOPE, np.minimum(density, density[0]), density)
        densities = self._mix_variants(density)
        self._count += 1
        scale_memory = np.append(min(self._count, ONLINE.models.scale_memory), self._memories)[of_memory]
        step = weigh_squares(squares / variance_ratio, self.square) - self.square
        self.square = np.maximum(self.square + step / scale_memory, 1e-12)
        self._recursion.take(phi)
        self.y_on_base += error[:, None] * gain
        self.columns_on_base += remaining[..., None] * gain[:, None]
        weighted = remaining / variance[:, None]
        self.information += weighted[:, :, None] * remaining[:, None]
        self.moment += weighted * error[:, None]
        share = np.exp(self.weight)
        of_family = np.add.reduceat(share * residual**2, self._starts) / np.add.reduceat(share, self._starts)
        return densities, of_family

    def _mix_variants(self, density: Array) -> Array:
        """Compute the log density of a bin under the mixture of each family (F,) from those of its variants (V,).

        The log weights of the variants are updated; the best of a family has zero.
        """
        weight = self.weight + density
        mixed = np.logaddexp.reduceat(weight, self._starts) - np.logaddexp.reduceat(self.weight, self._starts)
        best = np.maximum.reduceat(weight, self._starts)
        self.weight = np.maximum(weight - best[self._family], self._min_weight)
        return mixed

    def refine(self, bins: Bins, fresh: Mapping[str, Sequence[Term]]) -> Work[CompetingModels]:
        """Return a copy with finer grids of continuous nonlinear parameters around the best variants.

        Families with unchanged variants keep their state; the others are fitted to `bins`, all bins so far. `fresh` has
        a new grid for each effect; some of its variants are added, since the optimum may have moved.
        """
        grids = list(self.families[1 : self._n_named])
        for family, ((best,), _) in enumerate(self.select_best()[1:], 1):
            if not all(parameter.integer for parameter in best.nonlinear_parameters):
                yield
                grids[family - 1] = self._refine_grid(best, family, fresh[best.id])
        yield
        new = CompetingModels(self.terms, self._plant, grids, self._memories)
        is_new = [old != variants for old, variants in zip(self.families, new.families, strict=True)]
        yield from new._fit_families(bins, np.flatnonzero(is_new).tolist())
        new._recursion, new._count = self._recursion, self._count
        for family, (old_models, new_models) in enumerate(zip(self.models, new.models, strict=True)):
            if not is_new[family]:
                for name in ("y_on_base", "columns_on_base", "information", "moment", "square", "weight"):
                    getattr(new, name)[new_models] = getattr(self, name)[old_models]
                continue
            weights = dict(zip(self.families[family], self.weight[old_models].tolist(), strict=True))
            new_weight = -np.log(len(new.families[family]))  # new variants share the weight of the best
            new.weight[new_models] = [weights.get(variant, new_weight) for variant in new.families[family]]
        return new

    def _refine_grid(self, best: Term, family: int, fresh: Sequence[Term]) -> tuple[Term, ...]:
        """Return the best two variants, variants halfway to the neighbours of the best, and some of a new grid."""
        variants, neighbours = self.families[family], []
        best_two = [variants[k] for k in np.argsort(-self.weight[self.models[family]])[:2]]
        for parameter in best.free:
            value = best.nonlinear_values[parameter.name]
            if parameter.integer or not np.isfinite(value):
                continue
            values = np.unique([variant.nonlinear_values[parameter.name] for variant in (best, *variants)])
            values = values[np.isfinite(values)]
            place = int(np.searchsorted(values, value))
            lower = values[place - 1] if place else value / 2
            upper = values[place + 1] if place + 1 < len(values) else 2 * value
            for neighbour in (lower, upper):
                middle = np.sqrt(value * neighbour) if value * neighbour > 0 else 0.5 * (value + neighbour)
                if parameter.low <= middle <= parameter.high:
                    neighbours.append(replace(best, **{parameter.name: float(middle)}))
        return tuple(dict.fromkeys([*best_two, best, *neighbours, *thin_variants(fresh)]))


def solve_each_within_bounds(information: Array, moment: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Solve V least-squares problems for K parameters within bounds, information (V, K, K) and moment (V, K).

    The parameter farthest beyond a bound is set to the bound and the others are solved again, until none is beyond.

    Returns:
        Parameters, and information of those within the bounds; a parameter at a bound has unit information.
    """
    theta, matrix = _solve_positive(information, moment), information.copy()
    is_at_bound: Mask = np.zeros(moment.shape, dtype=bool)
    models = np.flatnonzero(((theta < lower) | (theta > upper)).any(axis=1))
    while len(models):
        scale = np.sqrt(np.einsum("vkk->vk", information[models]))
        excess = np.maximum(lower[models] - theta[models], theta[models] - upper[models]) * scale
        is_at_bound[models, np.argmax(np.where(is_at_bound[models], 0.0, excess), axis=1)] = True
        is_fixed = is_at_bound[models]
        values = np.where(is_fixed, np.clip(theta[models], lower[models], upper[models]), 0.0)
        right_side = moment[models] - np.einsum("vkl,vl->vk", information[models], values)
        either = is_fixed[:, :, None] | is_fixed[:, None]
        matrix[models] = np.where(either, np.eye(is_fixed.shape[1]), information[models])
        theta[models] = _solve_positive(matrix[models], np.where(is_fixed, values, right_side))
        is_beyond = (theta[models] < lower[models]) | (theta[models] > upper[models])
        models = models[(is_beyond & ~is_fixed).any(axis=1)]
    return theta, matrix


def _solve_positive(matrix: Array, right_side: Array) -> Array:
    """Solve V positive definite systems (V, K, K) of few unknowns by elimination, faster than LAPACK for each."""
    upper, solution = matrix.copy(), right_side.copy()
    for k in range(solution.shape[1]):
        for j in range(k + 1, solution.shape[1]):
            factor = upper[:, j, k] / upper[:, k, k]
            upper[:, j, k:] -= factor[:, None] * upper[:, k, k:]
            solution[:, j] -= factor * solution[:, k]
    for k in reversed(range(solution.shape[1])):
        solution[:, k] -= np.einsum("vj,vj->v", upper[:, k, k + 1 :], solution[:, k + 1 :])
        solution[:, k] /= upper[:, k, k]
    return solution


def _predict(theta: Array, base: ModelRows, rows: ModelRows) -> tuple[Array, Array]:
    """Compute the errors of the torque that V models predict, and derivatives of the equations by it (..., V).

    `base` has the rows of the running model (..., P), `rows` those of the effects (..., V, K).
    """
    of_base, parameters = theta[:, : base.phi.shape[-1]].T, base.phi.shape[-1]
    y, y_slope = rows.y - base.phi @ of_base, rows.y_slope - base.slope @ of_base
    return rows._replace(y=y, y_slope=y_slope).predict(theta[:, parameters:])


def _fit_running(rows: ModelRows) -> tuple[ModelRows, Array, Array]:
    """Fit the running model; return its linearised rows, the root of P (P, P), and the errors of the torque (R,).

    The first of several iterations omits columns that depend on the torque; they would explain torque by torque.
    """
    depends_on_torque = rows.slope.any(axis=0)
    theta, error = np.zeros(rows.phi.shape[1]), np.zeros(len(rows.y))
    for k in range(ONLINE.models.tangents if depends_on_torque.any() else 1):
        phi, y = rows.linearise(theta, error) if k else (rows.phi * ~depends_on_torque, rows.y)
        # |theta|^2 / PRIOR + |y - phi theta|^2 by QR; the triangle is the root of information, R'R = 1 / P
        prior = np.eye(len(theta), len(theta) + 1) / np.sqrt(PRIOR)
        triangle = np.asarray(np.linalg.qr(np.vstack([prior, np.column_stack([phi, y])]), mode="r"))
        root: Array = np.linalg.inv(triangle[:-1, :-1])
        theta = root @ triangle[:-1, -1]
        error, _ = rows.predict(theta)
    return rows._replace(phi=phi, y=y), root, error


def thin_variants(variants: Sequence[Term]) -> list[Term]:
    """Reduce a grid of variants to `ONLINE.models.variants`; grids with only integer parameters stay complete."""
    most = ONLINE.models.late_variants if is_late(variants[0]) else ONLINE.models.variants
    if len(variants) <= most or all(parameter.integer for parameter in variants[0].nonlinear_parameters):
        return list(variants)
    return [variants[k] for k in np.unique(np.linspace(0, len(variants) - 1, most).round().astype(int))]
