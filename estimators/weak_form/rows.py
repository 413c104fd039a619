"""Rows of regressions y = phi(terms) theta: their layout and noise, and the interface of their makers.

Windows of torque make rows of one or several joints (`TorqueRows`). Rollouts with a controller make rows that
are linearised at the fit of each set of terms (`RolloutRows`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from estimators.decisions.criterion import ResidualStructure
from estimators.decisions.errors import Errors
from estimators.decisions.score import Blocks
from estimators.regression.balance import Balance, Columns
from estimators.weak_form.point import Point
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Term

Terms = Sequence[Term]


@dataclass(frozen=True)
class RowLayout:
    """Joints, blocks and noise of R rows.

    Attributes:
        joints: rows of each joint, by its name; the one joint of a pendulum has an empty name.
        clusters: block of time of each row (R,), for standard errors under correlated residuals.
        precision: error of the rows of each joint without sensor noise, by its name.
        blocks: maps a length [s] to block and entry of each row, (R,) each, and the recording of each block (S,).
        block: length of a block of folds and score [s].
        is_bounded: mask of rows (R,) with a bound of the error, see `Blocks`; None if all have noise.
        least_scale: least scale of the errors in the score, see `Blocks`.
        noise: maps a joint and its inertia [kg m^2] to the noise floor of its rows.
        structure: maps a joint, a residual of its rows and its inertia to the structure of the residual.
        errors: maps a residual (R,) of positions to the errors of its model; None for rows of torque.
        predicts_torque: whether rows are of torque [N m], with estimated states of a link; else of simulated positions
            [rad].
        has_fast_fits: whether a fit is fast enough to compare many sets of terms; otherwise it takes seconds.
    """

    joints: Mapping[str, slice]
    clusters: Index
    precision: Mapping[str, float]
    blocks: Callable[[float], tuple[Index, Index, Index]]
    block: float
    noise: Callable[[str, float], float]
    structure: Callable[[str, Array, float], ResidualStructure]
    errors: Callable[[Array], Errors] | None = None
    predicts_torque: bool = True
    has_fast_fits: bool = True
    is_bounded: Mask | None = None
    least_scale: float = 0.0

    def compute_joint_errors(self, residual: Array) -> dict[str, float]:
        """Return the root mean square of a residual (R,) at each joint."""
        return {at: float(np.sqrt(np.mean(residual[rows] ** 2))) for at, rows in self.joints.items()}

    @cached_property
    def scored(self) -> Blocks:
        """Blocks of the score; the same object gives the folds of the fits, so no fit sees a block that it predicts."""
        return self.make_blocks(self.block)

    def make_blocks(self, piece: float) -> Blocks:
        """Return the blocks of the score, with folds made of pieces of a length [s]."""
        return Blocks(*self.blocks(self.block), self.blocks(piece)[0], self.is_bounded, self.least_scale)


class FoldFits(NamedTuple):
    """Fits of one set of terms for the score of the search.

    Attributes:
        terms: with nonlinear parameters that follow linear ones set.
        theta: linear parameters, fitted to all rows (P,).
        theta_without_fold: linear parameters, fitted without each fold (FOLDS, P).
    """

    terms: tuple[Term, ...]
    theta: Array
    theta_without_fold: Array


class ScoredTerms(NamedTuple):
    """Set of terms with the RMS error of its fit, in torque [N m] or in the loop [rad]."""

    terms: tuple[Term, ...]
    fitted_rms: float


class RowMaker(Protocol):
    """Maker of the rows of some recordings."""

    @property
    def layout(self) -> RowLayout:
        """Joints, blocks and noise of the rows."""

    def equations(self, terms: Terms, by_noise: bool = False) -> Balance:
        """Return the rows of some terms, linearised at their fit if nonlinear.

        Recordings with larger residuals have smaller weights, unless weights are `by_noise` alone.
        """

    def fit(self, terms: Terms, exactly: bool = False) -> Point:
        """Fit the linear parameters of some terms, and set nonlinear ones that follow these.

        `exactly` continues an iterative fit to convergence.
        """

    def fit_folds(self, terms: Terms) -> FoldFits:
        """Fit some terms to all rows and without each fold; linearised around the fit without the last, if accurate."""

    def columns(self, variants: Terms) -> list[Columns]:
        """Return the columns of each variant of one effect, on the rows of its joint."""

    def make_frame(self, terms: Terms) -> Array:
        """Return an orthonormal basis (R, P) of the weighted columns of some terms, linearised at their fit."""

    def nonlinear_jacobian(self, terms: Terms, theta: Array) -> tuple[Array, list[str]]:
        """Return derivatives (R, S) of phi theta by continuous nonlinear parameters, and the names of these."""

    def residual(self, terms: Terms, theta: Array) -> Array:
        """Return the measured minus the predicted values (R,) at some parameters."""

    def compare(self, terms: Terms, variants: Terms) -> list[float]:
        """Return the error of the terms with each variant of one further effect; it may be extrapolated."""

    def score_terms(self, terms: Terms) -> ScoredTerms:
        """Return a set of terms with the error of its fit."""

    def search_basins(self, terms: Terms, variants: Terms) -> ScoredTerms:
        """Return the best trial of the terms with a variant of a multimodal effect, searched from several variants."""

    def refine(self, trial: ScoredTerms, id: str) -> ScoredTerms:
        """Optimise the continuous nonlinear parameters of the term `id` of a trial, from their values."""
