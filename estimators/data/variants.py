"""Variants of one effect, compared by the rows of recordings: a grid of nonlinear parameters, and its best, refined."""

from __future__ import annotations

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.memoize import memoized
from estimators.regression.balance import place_columns
from estimators.regression.least_squares import project_out
from estimators.search_hints import count_variants, find_hints, make_grid
from estimators.weak_form.rows import ScoredTerms, Terms
from pendulum_env._typing import Array
from pendulum_env.physics import Samples, Table, Term, count_term_parameters

STARTS = 2  # best variants per form from which a search over nonlinear parameters starts
COARSE_GRID = 24  # largest number of variants of continuous parameters, where each fit takes seconds


def make_variants(data: RegressionData, terms: Terms, effect: type[Term]) -> list[Term]:
    """Return the variants of an effect on a grid of its nonlinear parameters, for a search with the terms.

    The grid depends on the motion and the residual of the terms. If fits are slow, it has at most `COARSE_GRID`
    variants of continuous parameters.
    """
    variants = make_grid(effect, *_compute_unexplained_torque(data, terms, effect))
    if not data.layout.has_fast_fits and any(not parameter.integer for parameter in effect.nonlinear_parameters):
        variants = variants[:: max(1, -(-len(variants) // COARSE_GRID))]
    return [variant.without_known_functions(terms) if isinstance(variant, Table) else variant for variant in variants]


@memoized
def count_tried(data: RegressionData, terms: Terms, effect: type[Term]) -> int:
    """Return the number of variants of an effect that a search tries, for its penalty; see `count_variants`."""
    return count_variants(effect, *_compute_unexplained_torque(data, terms, effect))


def _compute_unexplained_torque(data: RegressionData, terms: Terms, effect: type[Term]) -> tuple[Samples, Array]:
    """Return samples at the joint of an effect, and the torque residual of some terms at the joint (R,) [N m]."""
    residual = data.torque.equations(terms).error(data.torque.fits.solve(terms))
    return data.data.part(effect.at).samples, residual[data.data.locate_rows(effect.at)]


@memoized
def rank_variants(data: RegressionData, terms: Terms, effect: type[Term]) -> list[ScoredTerms]:
    """Compare the terms with each variant of the grid of an effect, the smallest error first.

    Variants of one effect may differ in class, or in the number of columns.
    """
    kinds: dict[tuple[type[Term], int], list[Term]] = {}
    for variant in make_variants(data, terms, effect):
        kinds.setdefault((type(variant), len(variant.columns)), []).append(variant)
    trials = [trial for of_kind in kinds.values() for trial in try_variants(data, terms, of_kind)]
    return sorted(trials, key=lambda trial: trial.fitted_rms)


@memoized
def refine_variants(data: RegressionData, terms: Terms, effect: type[Term]) -> list[ScoredTerms]:
    """Return the best refined variant of each form of an effect, those with the fewest parameters first.

    A form is a set of free nonlinear parameters and a number of columns. A multimodal effect has one form; without any
    variant the list is empty.
    """
    if find_hints(effect).multimodal:
        variants = make_variants(data, terms, effect)
        return [data.maker.search_basins(terms, variants)] if variants else []
    ranked = rank_variants(data, terms, effect)
    if len(ranked) < 2:
        return ranked
    forms: dict[object, list[ScoredTerms]] = {}
    for trial in ranked:
        last = trial.terms[-1]
        forms.setdefault((last.free, len(last.columns)), []).append(trial)
    sought = effect.nonlinear_parameters
    is_integer = bool(sought) and all(parameter.integer for parameter in sought)
    best = [
        trials[0]
        if is_integer
        else min((data.maker.refine(trial, effect.id) for trial in trials[:STARTS]), key=lambda trial: trial.fitted_rms)
        for trials in forms.values()
    ]
    return sorted(best, key=lambda trial: (count_term_parameters(trial.terms[-1]), trial.fitted_rms))


def try_variants(data: RegressionData, terms: Terms, variants: Terms) -> list[ScoredTerms]:
    """Compare the terms with each variant of one further effect; errors may be extrapolated."""
    errors = data.maker.compare(terms, variants)
    return [ScoredTerms((*terms, variant), error) for variant, error in zip(variants, errors, strict=True)]


def compute_unique_share(data: RegressionData, terms: Terms, term: Term) -> float:
    """Return the part of a term's columns outside the span of other terms' columns, from 0 to 1; the largest of all."""
    (part,), weights = data.maker.columns([term]), data.equations(terms).weights[:, None]
    of_term = place_columns(len(weights), [(data.locate_rows(term.at), np.column_stack([part.linear, part.fixed]))])
    of_term = of_term[:, np.linalg.norm(of_term, axis=0) > 0] * weights
    outside = project_out(data.maker.make_frame(tuple(terms)), of_term)
    return float(max(np.linalg.norm(outside, axis=0) / np.linalg.norm(of_term, axis=0), default=0.0))
