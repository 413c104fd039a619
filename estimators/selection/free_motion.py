"""Comparison of models by free motion: windows of torque leave out rest and reversals, simulated segments do not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Step, Terms
from estimators.decisions.score import Gain
from estimators.memoize import memoized
from estimators.selection.fits import Fits
from estimators.selection.motion_score import (
    compute_motion_gain,
    compute_motion_noise,
    compute_motion_squares,
    is_misfit,
)
from pendulum_env._typing import Array
from pendulum_env.physics import has_transmission

NO_GAIN = Gain(0.0, 0.0, 1.0)


@dataclass(eq=False, repr=False)
class FreeMotion:
    """Errors of simulated segments under models fitted to the motion; results are memoised.

    Attributes:
        fits: fits of terms to torque and motion.
        criterion: limits of decisions.
    """

    fits: Fits
    criterion: Criterion

    @memoized
    def has_misfit(self, terms: Terms) -> bool:
        """Return whether the fit of some terms is a misfit to the motion."""
        return bool(self.fits.train.segments) and self.is_misfit(self.fits.fit(terms))

    def is_misfit(self, step: Step) -> bool:
        """Return whether a step is a misfit to the motion of the training data, see `motion_score.is_misfit`."""
        return is_misfit(self.fits.train.segments, step.model, self.criterion)

    def compute_shares(self, after: Terms, before: Terms) -> tuple[float, float]:
        """Return the shares of the power of free-running errors, training first, that one model has less than another.

        Shares are 0 if the gain over all segments is not significant, and without a simulation.
        """
        gain, shares = self.compare(after, before)
        return shares if gain.p_value <= self.criterion.p_value else (0.0, 0.0)

    @memoized
    def compare(self, after: Terms, before: Terms, penalty: float = 0.0) -> tuple[Gain, tuple[float, float]]:
        """Return the gain of one model over another in free motion, and the shares of the power of errors it removes.

        Both are fitted to the motion, so that parameters of the other model imitate the effect as far as they can. The
        gain is undefined without segments, and with a transmission, because its segments soon diverge.
        """
        if not self.fits.train.segments or has_transmission(after) or has_transmission(before):
            return NO_GAIN, (0.0, 0.0)
        if not all(self.fits.fit_terms_to_motion(terms).has_known_inertia for terms in (after, before)):
            return NO_GAIN, (0.0, 0.0)
        counts = [sum(len(segment.first) for segment in part.segments) for part in self.fits.parts]
        new, old = map(self._compute_squares, (after, before))
        return compute_motion_gain(np.repeat(np.arange(2), counts), new, old, self._compute_noise(before), penalty)

    @memoized
    def _compute_squares(self, terms: Terms) -> Array:
        """Return the mean square error of each segment, training first, of the terms fitted to motion (B,) [rad^2]."""
        model = self.fits.fit_terms_to_motion(terms)
        return np.concatenate([compute_motion_squares(part.segments, model) for part in self.fits.parts])

    @memoized
    def _compute_noise(self, terms: Terms) -> Array:
        """Return the mean square error of the same segments by torque noise and encoder noise (B,) [rad^2]."""
        model = self.fits.fit_terms_to_motion(terms)
        return np.concatenate([compute_motion_noise(part.segments, model, 0.0) for part in self.fits.parts])
