"""Variants of effects in the loop, by how well a linear fit foresees that the motion follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimators.in_loop.fit import LOOP, scale_of
from estimators.in_loop.regression import LoopRegression
from estimators.memoize import memoized
from estimators.selection.prepared import Trial
from estimators.selection.screening import best_of_forms, ranked
from pendulum_env.physics import Term


@dataclass(eq=False)
class LoopScreen:
    """Variants of effects beside the terms of a model, by the scale of the errors that they leave of rollouts.

    Attributes:
        regression: fits of sets of terms to the rollouts.
    """

    regression: LoopRegression

    def trial(self, terms: Sequence[Term]) -> Trial:
        """One set of terms, with the scale of its errors [rad]."""
        return Trial(tuple(terms), scale_of(self.regression.data, self.regression.near(terms).error))

    def trials(self, terms: Sequence[Term], variants: Sequence[Term]) -> list[Trial]:
        """The terms with each of several variants of one further effect added, and the errors that are foreseen."""
        scales = self.regression.foreseen(tuple(terms), variants)
        return [Trial((*terms, variant), scale) for variant, scale in zip(variants, scales, strict=True)]

    def grid(self, terms: Sequence[Term], effect: type[Term]) -> list[Term]:
        """Variants of an effect beside the terms, from which a search starts."""
        variants = self.regression.windows.screen.grid(terms, effect)
        coarse = any(not parameter.integer for parameter in effect.nonlinear_parameters) and len(variants) > LOOP.most
        return variants[:: -(-len(variants) // LOOP.most)] if coarse else variants

    def n_tried(self, terms: Sequence[Term], effect: type[Term]) -> int:
        """Number of variants among which `grid` chose."""
        return self.regression.windows.screen.n_tried(tuple(terms), effect)

    @memoized
    def ranked(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """The terms with each variant of the grid of an effect, the smallest error as foreseen first."""
        return ranked(self.trials, terms, self.grid(terms, effect))

    @memoized
    def variants(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """Best variants of an effect beside the terms, one for each set of nonlinear parameters that are told."""
        return best_of_forms(self.ranked(terms, effect), effect, self.refine)

    def refine(self, trial: Trial, id: str) -> Trial:
        """Fit all continuous nonlinear parameters of a trial from where they are."""
        return self.trial(self.regression.with_nonlinear(trial.terms))
