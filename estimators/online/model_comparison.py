"""Comparison of models on the bins of one plant: fits, predictions, and the gains of these."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.findings import Obstacle
from estimators.online.binning import Bin, Bins, PlantBins
from estimators.online.competitors import CompetingModels, thin_variants
from estimators.online.evidence import ReferenceDistribution
from estimators.online.fit_bins import FitBins
from estimators.online.gains import Gains
from estimators.online.settings import ONLINE
from estimators.online.work import Work
from estimators.search_hints import is_possible, iterate_grid
from estimators.signals.differentiation import estimate_scatter
from pendulum_env._typing import Array
from pendulum_env.physics import Term


class ModelComparison:
    """Predictions of the running model, alone, with each effect and with forgetting, for the bins of one plant.

    Attributes:
        terms: terms of the running model.
        fit_bins: bins of the first seconds of motion, to which all models are fitted before they predict.
        not_run: effects that are not run at present, with the reason.
        gains: gains of the models, from their first fit.
        n_predicted: number of bins that the models have predicted.
    """

    gains: Gains

    def __init__(
        self,
        terms: Sequence[Term],
        library: Mapping[str, type[Term]],
        plant: PlantBins,
        bins: Sequence[Bin] = (),
        reference: ReferenceDistribution | None = None,
        *,
        block: float,
    ) -> None:
        """Begin a comparison of terms with effects of a library and kept bins, before `fit`.

        The reference is the distribution of the gain of forgetting, if it is known. Gains are summed over a
        `block` [s].
        """
        self.terms, self._library, self._plant, self._reference = tuple(terms), library, plant, reference
        self.fit_bins, self._block = FitBins(plant, bins), block
        self._models: CompetingModels | None = None
        self._waiting_bins: list[Bin] = []  # not yet predicted
        self._chunk_density: Array | float = 0.0  # log predictive densities in the chunk to come (F,)
        self._squares: deque[Array] = deque(maxlen=plant.count_bins(ONLINE.models.error_time))
        self.not_run: dict[str, Obstacle] = {}
        self.n_predicted = 0

    # ---------------------------------------------------------------------------------------------------------- a bin

    def take(self, bin_: Bin) -> Work[bool]:
        """Add a bin of motion; return whether a chunk has ended with it.

        Bins are only kept until all models can be fitted. Later bins are predicted `ONLINE.bins.update` at a time. The
        end of a chunk updates the gains, and at `ONLINE.models.refinements` the grids.
        """
        self.fit_bins.take(bin_)
        if self._models is None:
            yield from self.fit()
            return False
        self._waiting_bins.append(bin_)
        if len(self._waiting_bins) < ONLINE.bins.update:
            return False
        waiting = yield from self.fit_bins.stack(self._waiting_bins)
        bin_densities, squares = yield from self._models.take(waiting)
        self._waiting_bins = []
        self._squares.extend(squares)
        self._chunk_density = chunk = self._chunk_density + bin_densities.sum(axis=0)
        self.n_predicted += ONLINE.bins.update
        if self.n_predicted % ONLINE.bins.chunk:
            return False
        self._chunk_density = 0.0
        self.gains.take(chunk)
        kept = self.fit_bins.bins
        if self.gains.has_block_ended and len(kept) == self.n_predicted + self._n_fitted:  # all bins are kept so far
            if round(len(kept) * self._plant.length) in ONLINE.models.refinements:
                bins = yield from self.fit_bins.stack(kept)
                base = yield from CompetingModels.fit(self.terms, bins)
                fresh = yield from self._list_variants(base, bins)
                self._models = yield from self._models.refine(bins, fresh)
        return True

    # ------------------------------------------------------------------------------------------------------ the models

    def linearise_rows(self, bins: Sequence[Bin]) -> Work[tuple[Array, Array]]:
        """Return rows over R bins, linearised at the fitted running model: phi (R, P) and y (R,)."""
        assert self._models is not None
        stacked = yield from self.fit_bins.stack(bins)
        yield
        rows, theta = stacked.evaluate_running(self.terms), self._models.y_on_base[0]
        return rows.linearise(theta, rows.predict(theta)[0])

    @property
    def leaders(self) -> list[tuple[tuple[Term, ...], Array]]:
        """Return the best variant of each effect with its parameters; the running model alone comes first."""
        return [] if self._models is None else self._models.select_best()

    @property
    def error(self) -> float:
        """Return the RMS a-priori error of the running model over the last seconds of motion [N m]."""
        return float(np.sqrt(np.mean(self._squares, axis=0)[0]))

    @property
    def typical_errors(self) -> Array:
        """Return the scaled median error over the last seconds of motion, alone and with each effect (F,) [N m]."""
        return np.asarray(np.sqrt(np.median(self._squares, axis=0)[:-1]) / 0.6745)

    def compute_floor(self, accuracy: float) -> Work[float]:
        """Return the RMS error by noise and discretisation [N m]; NaN while it is unknown, and with links.

        Discretisation leaves the share `accuracy` of the torque. A command that changes in each sample looks like
        noise. Therefore, noise of the torque is at most the scatter of the errors from bin to bin, and the floor at
        most the error.
        """
        columns, kept = [column for term in self.terms for column in term.columns], self.fit_bins.bins
        if self._models is None or len(self._plant.joints) > 1 or kept[0].phi.size:
            return float("nan")
        last_chunk = yield from self.fit_bins.stack(kept[-ONLINE.bins.chunk :])
        x, theta = last_chunk.middle, self._models.y_on_base[0]
        phi, y = yield from self.linearise_rows(kept[-self._plant.count_bins(ONLINE.models.error_time) :])
        scatter = estimate_scatter(y - phi @ theta) / self._plant.scatter_gain
        inertia = sum(value * np.mean(column.mass(x)) for column, value in zip(columns, theta, strict=True))
        noises = np.minimum(kept[-1].torque_noise, scatter), inertia * kept[-1].acceleration_noise
        return float(np.minimum(np.linalg.norm([*noises, accuracy * np.std(y)]), self.error))

    def fit(self) -> Work[None]:
        """Fit all models to the kept bins if these suffice; the models predict from then on."""
        if not self.fit_bins.are_sufficient():
            return
        base, bins = yield from self.fit_bins.fit_running(self.terms)
        variants = {id: grid for id, grid in (yield from self._list_variants(base, bins)).items() if grid}
        self.not_run = {
            id: Obstacle.JOINT_AT_REST if self.fit_bins.is_idle(kind) else Obstacle.NO_VARIANT
            for id, kind in self._library.items()
            if id not in variants
        }
        self._n_fitted, chunk_time = len(self.fit_bins.bins), ONLINE.bins.chunk * self._plant.length
        self.gains = Gains(len(variants) + 1, chunk_time, self._block, self._reference)
        memories = [seconds / self._plant.length for seconds in ONLINE.models.memories]
        grids = [thin_variants(grid) for grid in variants.values()]
        self._models = yield from CompetingModels.fit(self.terms, bins, grids, memories)

    def _list_variants(self, base: CompetingModels, bins: Bins) -> Work[dict[str, list[Term]]]:
        """List the possible variants of each effect at a moving joint on a grid.

        Variants with the fewest columns are kept. Parameters that follow one of the model take its value in `base`.
        """
        names = [column.name for term in self.terms for column in term.columns]
        known = dict(zip(names, base.compute_theta()[0].tolist(), strict=False))
        listed = {}
        for id, effect in self._library.items():
            if self.fit_bins.is_idle(effect):
                continue
            in_joint = bins.at == effect.at
            x, residual = bins.select_joint(effect.at).middle, (base.residual * bins.scale)[in_joint]
            yield
            n_columns: dict[Term, int] = {}  # of possible variants
            for number, term in enumerate(iterate_grid(effect, x, residual), 1):
                if number % ONLINE.work.variants == 0:
                    yield
                if term not in n_columns and is_possible(term, x):
                    n_columns[term] = len(term.columns)
            fewest = min(n_columns.values(), default=0)
            variants = [term for term, count in n_columns.items() if count == fewest]  # a batch needs equal numbers
            follows = {s.name: known[s.follows] for s in effect.nonlinear_parameters if s.follows in known}
            listed[id] = list(dict.fromkeys(replace(term, **follows) for term in variants) if follows else variants)
        yield
        return listed
