"""Fits of a link before the encoder: the likelihood has many local minima, so fits begin at many starts."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from estimators.search_hints import find_hints
from estimators.simulation.multiple_shooting import add_link_friction
from estimators.weak_form.nonlinear import set_values
from estimators.weak_form.point import Point
from pendulum_env.physics import Term
from robots.servos.in_loop.fit import fit_rollouts
from robots.servos.in_loop.likelihood import compute_likelihood_scale, compute_log_likelihood
from robots.servos.in_loop.linearisation import LinearErrors, TypicalSizes, linearise_errors
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.settings import LOOP


def fit_link(
    rollouts: Rollouts, sizes: TypicalSizes, point: Point, variants: Sequence[Term], least_share: float
) -> LinearErrors:
    """Fit a model with a link from several starts, and return the errors around the best fit.

    The likeliest start at each value of the parameter with many local minima is fitted with longer secants and without
    counts, and the best of these fits to convergence. If the likeliest start explains too little, no other start is
    tried.

    Args:
        rollouts: to fit.
        sizes: typical sizes of linear parameters.
        point: fit without the link.
        variants: of the link.
        least_share: of the squared error that the likeliest start must explain before others are tried.
    """
    smooth, profiled = rollouts.without_counts, find_hints(type(variants[0])).profiled
    starts = list_link_starts(point, variants)
    typical = sizes.list_sizes(starts[0].terms)
    likelihood = compute_log_likelihood(smooth, smooth.compute_position_errors(starts))
    likeliest: dict[float, Point] = {}  # at each value, the likeliest of all first
    for k in np.argsort(-likelihood):
        likeliest.setdefault(starts[k].terms[-1].nonlinear_values[profiled], starts[k])

    def fit_roughly(start: Point) -> list[LinearErrors]:
        begun = [add_link_friction(start, share) for share in LOOP.link.friction]
        secants = LOOP.fit.secants[:1]
        return [fit_rollouts(smooth, start, typical, nonlinear=True, secants=secants) for start in begun]

    first, *others = [*likeliest.values()][: LOOP.link.starts]
    rough = fit_roughly(first)
    before, *after = (
        compute_likelihood_scale(smooth, error)
        for error in (smooth.compute_position_errors([point])[:, 0], *(fit.error for fit in rough))
    )
    if min(after) ** 2 >= (1.0 - least_share) * before**2:
        best = min(rough, key=lambda fit: compute_likelihood_scale(smooth, fit.error))
        return linearise_errors(rollouts, best.point, typical, nonlinear=True)
    rough += [fit for start in others for fit in fit_roughly(start)]
    rough.sort(key=lambda fit: compute_likelihood_scale(smooth, fit.error))
    finalists = rough[: LOOP.link.finalists]
    fits = [fit_rollouts(rollouts, fit.point, typical, nonlinear=True, share=0.0) for fit in finalists]
    return min(fits, key=lambda fit: compute_likelihood_scale(rollouts, fit.error))


def list_link_starts(point: Point, variants: Sequence[Term]) -> list[Point]:
    """Return starts of a fit of a model with a link, from variants of the link; its weight is that of the joint.

    `point` is the fit without a link. Variants that differ by weight or damping alone have the same starts.
    """
    inertia, weight = point.linear_values.get("inertia", 0.0), abs(point.linear_values.get("gravity", 0.0))
    points: dict[tuple[Term, float], Point] = {}
    for variant, factor, share, ratio in product(
        variants, LOOP.link.stiffnesses, LOOP.link.shares, LOOP.link.damping_ratios
    ):
        resonance = factor * variant.nonlinear_values["resonance"]
        link_values = {
            "resonance": resonance,
            "damping": 2.0 * ratio * resonance,
            "gravity": weight / max(share * inertia, 1e-9),
        }
        parameters = [p for p in variant.nonlinear_parameters if p.name in link_values]
        term = set_values(variant, parameters, [link_values[p.name] for p in parameters])
        points[term, share] = Point.from_parameters((*point.terms, term), np.append(point.theta, share * inertia))
    return [*points.values()]
