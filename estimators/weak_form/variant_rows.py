"""Rows of some terms with each variant of one further effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from estimators.regression.balance import Balance, Columns, condense
from estimators.weak_form.columns import has_known_parameter, is_torque_dependent, list_bounds
from estimators.weak_form.nonlinear import ResidualFunction
from estimators.weak_form.row_fits import RowFits
from estimators.weak_form.rows import Terms
from pendulum_env._typing import Array
from pendulum_env.physics import Term


@dataclass(frozen=True, eq=False)
class VariantRows:
    """Rows of fitted terms plus each variant of one further effect."""

    fits: RowFits
    terms: tuple[Term, ...]

    def with_variant(self, here: slice) -> Callable[[Term, Columns], Balance]:
        """Make the function from a variant and its columns to the rows of the terms plus the variant.

        `here` are the rows of the variant's joint. Weights are those of the terms alone. Rows of other joints are
        condensed to their tangent. Rows with a term that filters torque (`lead`) are assembled for each variant.
        """
        terms, regressor, fits = self.terms, self.fits.regressor, self.fits
        if not terms or any(term.lead for term in terms):
            shared, w = regressor.list_term_columns(terms), fits.weights(terms)
            return lambda variant, columns: regressor.assemble(
                (*terms, variant), [*shared, regressor.add_fixed_change(variant, columns)], w
            )
        shared_rows, perturbations = fits.equations(terms), regressor.perturbations
        elsewhere = np.ones(len(perturbations), dtype=bool)
        elsewhere[here] = False
        if elsewhere.any():
            tangent, of_joint = fits.linearise(terms), perturbations[here]
            shared_rows = condense(shared_rows, elsewhere, tangent.slopes[elsewhere], tangent.target[elsewhere])
            largest = np.tile(perturbations.max(axis=0), (len(shared_rows.y) - len(of_joint), 1))
            here, perturbations = slice(0, len(of_joint)), np.concatenate([of_joint, largest])
        return lambda variant, columns: shared_rows.with_columns(
            [(here, regressor.add_fixed_change(variant, columns))], *list_bounds((*terms, variant)), perturbations
        )

    def make_residual_function(self) -> ResidualFunction[Term]:
        """Make the function from variants to the weighted residual (R,) of the fit of the terms plus each variant.

        The columns of the unknown parameters are projected out once, so each variant takes a small solve. A variant
        that leaves the bounds, has known parameters or depends on the torque is fitted exactly.
        """
        terms, regressor, fits = self.terms, self.fits.regressor, self.fits
        shared, w = regressor.list_term_columns(terms), fits.weights(terms)
        tangent, frame = fits.linearise(terms), fits.make_frame_of_unknown(terms)
        least, most = list_bounds(terms)
        is_free = least < most
        start = np.where(is_free, tangent.theta, least)
        scale, target = w * tangent.scale, w * (tangent.error - tangent.slopes @ (start - tangent.theta))
        inverse = np.linalg.pinv(frame.T @ (w[:, None] * tangent.slopes[:, is_free]))

        def project_out(columns: Array, here: slice) -> Array:
            projected = -frame @ (frame[here].T @ columns)
            projected[here] += columns
            return np.asarray(projected)

        remaining = project_out(target, slice(None))
        with_variant = cache(lambda at: self.with_variant(regressor.data.locate_rows(at)))

        def exact(balance: Balance) -> Array:
            return balance.weights * balance.error(balance.solve())

        def residual(variant: Term, variant_columns: Columns) -> Array:
            if has_known_parameter(variant) or not variant.columns:
                return exact(regressor.assemble((*terms, variant), [*shared, variant_columns], w))
            here = regressor.data.locate_rows(variant.at)
            columns = scale[here, None] * variant_columns.linear
            free = project_out(columns, here)
            size = np.maximum(np.linalg.norm(free, axis=0), 1e-300)
            free = free / size
            theta = np.linalg.solve(free.T @ free + 1e-12 * np.eye(len(size)), free.T @ remaining) / size
            others = start.copy()
            others[is_free] += inverse @ (frame.T @ target - frame[here].T @ (columns @ theta))
            (least, most), parameters = list_bounds((*terms, variant)), np.append(others, theta)
            if np.any((parameters < least) | (parameters > most)):
                return exact(regressor.assemble((*terms, variant), [*shared, variant_columns], w))
            return np.asarray(remaining - (free * size) @ theta)

        def residuals(variants: Terms) -> list[Array]:
            pairs = list(zip(variants, regressor.make_columns(variants), strict=True))
            if not is_torque_dependent(variants[0]):
                return [residual(*pair) for pair in pairs]
            return [exact(with_variant(variants[0].at)(*pair)) for pair in pairs]

        return residuals
