"""Evidence for models: gains in prediction, penalties, explained shares, and decisions by them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.variants import count_tried
from estimators.decisions.criterion import Criterion
from estimators.decisions.decision import Decision, Policy, decide
from estimators.decisions.errors import Step, Terms
from estimators.decisions.score import Bootstrap, Gain
from estimators.memoize import memoized
from estimators.progress import Progress, no_progress
from estimators.selection.densities import Densities, number_recordings
from estimators.selection.fits import Fits
from estimators.selection.free_motion import FreeMotion
from estimators.selection.residuals import Residuals
from estimators.selection.shares import ExplainedShares
from pendulum_env.physics import BASE, COMPETING, Term, effects, is_dry, list_ids


@dataclass(eq=False, repr=False)
class Evidence:
    """Evidence for models of the same data, and decisions between them, each computed once.

    Attributes:
        fits: fits of terms to rows, segments and links.
        densities: log predictive densities of blocks.
        residuals: residuals of fits, noise or structure.
        motion: comparison by free motion.
        shares: shares of residual and motion error that a larger model explains.
        library: effects that may be selected, by id.
        tables: nonparametric functions that compete with the effects.
        criterion: limits of the decisions.
        progress: called with the present work and the share that is done.
    """

    fits: Fits
    densities: Densities
    residuals: Residuals
    motion: FreeMotion
    shares: ExplainedShares
    library: Mapping[str, type[Term]]
    tables: Sequence[type[Term]]
    criterion: Criterion
    progress: Progress

    @classmethod
    def from_data(
        cls,
        train: RegressionData,
        holdout: RegressionData,
        *,
        base: Terms = BASE,
        library: Mapping[str, type[Term]] | None = None,
        tables: Sequence[type[Term]] = COMPETING,
        criterion: Criterion = Criterion(),
        rng: np.random.Generator | None = None,
        progress: Progress = no_progress,
    ) -> Evidence:
        """Return the evidence of data to fit and data to predict.

        Args:
            train: data to fit.
            holdout: data to predict.
            base: terms that the search starts from.
            library: effects that may be selected, by id; by default all.
            tables: nonparametric functions that compete with the effects; those of the base are removed.
            criterion: limits of the decisions.
            rng: random numbers of the bootstrap; by default seed 0.
            progress: called with the present work and the share that is done.
        """
        fits, ids = Fits(train, holdout, base), list_ids(base)
        bootstrap = Bootstrap(number_recordings(fits), rng)
        competing = [table for table in tables if table.id not in ids]
        library = effects() if library is None else library
        return cls._from_fits(fits, bootstrap, library, competing, criterion, progress)

    @classmethod
    def _from_fits(
        cls,
        fits: Fits,
        bootstrap: Bootstrap,
        library: Mapping[str, type[Term]],
        tables: Sequence[type[Term]],
        criterion: Criterion,
        progress: Progress,
    ) -> Evidence:
        """Return the evidence of some fits under random weights of their blocks."""
        residuals = Residuals(fits.train, fits.holdout, criterion, fits.base)
        densities, motion = Densities(fits, residuals, criterion, bootstrap), FreeMotion(fits, criterion)
        shares = ExplainedShares(residuals, motion)
        return cls(fits, densities, residuals, motion, shares, library, tables, criterion, progress)

    @property
    def train(self) -> RegressionData:
        """Data to fit."""
        return self.fits.train

    @property
    def holdout(self) -> RegressionData:
        """Data to predict."""
        return self.fits.holdout

    def with_fits(self, fits: Fits) -> Evidence:
        """Return the evidence of other fits, as with estimated states of a link, or of more blocks of time."""
        others = self.library, self.tables, self.criterion, self.progress
        bootstrap, of_block = self.densities.bootstrap, number_recordings(fits)
        if len(of_block) != len(bootstrap.of_block):
            bootstrap = Bootstrap(of_block)
        return self._from_fits(fits, bootstrap, *others)

    def with_library(self, library: Mapping[str, type[Term]]) -> Evidence:
        """Return the evidence with other effects that may be selected."""
        return replace(self, library=library)

    def decide(self, after: Terms | Step, before: Terms | Step, policy: Policy[Hypothesis]) -> Decision:
        """Decide whether one model takes the place of another; a step has parameters of its own."""
        if isinstance(after, Step) or isinstance(before, Step):
            return decide(Hypothesis.make(self, after), Hypothesis.make(self, before), policy)
        return self._decide_by_fits(after, before, policy)

    @memoized
    def _decide_by_fits(self, after: Terms, before: Terms, policy: Policy[Hypothesis]) -> Decision:
        """Decide between the fits of two sets of terms."""
        return decide(Hypothesis(self, after), Hypothesis(self, before), policy)

    def screening_score(self, terms: Terms) -> float:
        """Return the negative log density of all blocks [nat], a sort key: the most probable model first."""
        return -float(self.densities.compute(terms).sum())

    @memoized
    def gain(self, after: Terms, before: Terms) -> Gain:
        """Return the gain of a model over another in the density of torque; its p-value includes the `penalty`."""
        bootstrap, (new, old) = self.densities.compare(after, before)
        return bootstrap.gain(new, old, self.penalty(after, before))

    def penalty(self, after: Terms, before: Terms, n_effects: int | None = None) -> float:
        """Return the multiple-comparison penalty [nat]: ln(number of effects times `count_compared_variants`).

        The effects are those of the library unless their number is given.
        """
        n_effects = len(self.library) if n_effects is None else n_effects
        return float(np.log(max(1, n_effects * self.count_compared_variants(after, before))))

    def count_compared_variants(self, after: Terms, before: Terms) -> int:
        """Return the number of tried variants of the terms that only `after` has, plus values of its freed integers.

        It is at least one.
        """
        terms_before = {other.id: other for other in before}
        counts = [count_tried(self.fits.train, before, type(term)) for term in after if term.id not in terms_before]
        freed = [
            parameter
            for term in after
            if term.id in terms_before
            for parameter in term.free
            if parameter not in terms_before[term.id].free
        ]
        return max(
            1, sum(counts) + sum(int(parameter.high - parameter.low) for parameter in freed if parameter.integer)
        )

    def best_gain(self, after: Terms, before: Terms) -> Gain:
        """Return the gain of a larger model in torque, or in free motion if only that is significant.

        Windows of torque leave out rest and reversals, where dry friction acts in full. So free motion is simulated if
        the terms that `after` adds are dry friction, and if `before` is a misfit to the motion. Only effects of dry
        friction are compared in free motion, so the penalty counts them alone.
        """
        by_torque = self.gain(after, before)
        if by_torque.p_value <= self.criterion.p_value or not self.may_act_at_rest(after, before):
            return by_torque
        by_motion = self.gain_in_friction(after, before)
        return by_motion if by_motion.p_value <= self.criterion.p_value else by_torque

    def may_act_at_rest(self, after: Terms, before: Terms) -> bool:
        """Return whether dry friction alone is added to a misfit to the motion."""
        return adds_dry_friction(after, before) and self.motion.has_misfit(before)

    def gain_in_friction(self, after: Terms, before: Terms) -> Gain:
        """Return the gain in free motion of a model over another with less dry friction."""
        n_effects = sum(is_dry(kind()) for kind in self.library.values())
        return self.motion.compare(after, before, self.penalty(after, before, n_effects))[0]


@dataclass(frozen=True)
class Hypothesis:
    """Model under test.

    Attributes:
        evidence: of the data.
        terms: of the model.
        fitted: step with parameters of its own; None for those of the fit to torque.
    """

    evidence: Evidence
    terms: Terms
    fitted: Step | None = field(default=None)

    @classmethod
    def make(cls, evidence: Evidence, model: Terms | Step) -> Hypothesis:
        """Return the hypothesis of some terms or of a step."""
        return cls(evidence, model.model.terms, model) if isinstance(model, Step) else cls(evidence, model)

    @cached_property
    def step(self) -> Step:
        """Parameters and errors of the model."""
        return self.fitted or self.evidence.fits.fit(self.terms)


def adds_dry_friction(after: Terms, before: Terms) -> bool:
    """Return whether a model has further terms, all of dry friction."""
    ids = list_ids(before)
    added = [term for term in after if term.id not in ids]
    return bool(added) and all(map(is_dry, added))
