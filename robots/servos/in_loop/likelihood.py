"""Likelihood of the errors of rollouts.

Errors of a rollout last for seconds. Some are large, because a servo sticks at another position than its model. Their
density is that of a hyperbolic secant, sech(pi e / 2 s) / 2 s: normal in the middle, exponential in its tails. No error
is left out. A large error counts by its absolute value, as in the mean distance that compares servos. One scale s
serves all recordings of a servo. The score of a search uses Student's t, which limits the weight of a single block.

Source: Fischer, Generalized Hyperbolic Secant Distributions, 2014.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.decisions.score import MAX_ITERATIONS
from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.settings import LOOP


def compute_error_scales(rollouts: Rollouts, errors: Array) -> Array:
    """Return the scale (...) of errors (R, ...) of models [rad], at least the resolution of the encoder.

    The likeliest scale s solves mean(a tanh(a / s)) = s with a = pi |e| / 2, by Newton's method for the logarithms.
    """
    absolute = np.pi / 2 * np.abs(errors)
    scale = np.maximum(np.mean(absolute, axis=0), rollouts.noise.resolution)
    for _ in range(MAX_ITERATIONS):
        relative = absolute / scale
        slope = np.tanh(relative)
        ratio = np.maximum(np.einsum("r...,r...->...", relative, slope) / len(absolute), 1e-300)
        bend = np.einsum("r...,r...,r...->...", relative, relative, 1.0 - slope**2) / len(absolute)
        before, scale = scale, np.maximum(scale * ratio ** (ratio / (ratio + bend)), rollouts.noise.resolution)
        if (np.abs(scale - before) <= LOOP.fit.settled * before).all():
            break
    return np.asarray(scale)


def compute_log_densities(rollouts: Rollouts, errors: Array) -> Array:
    """Return the log density (R, ...) of errors (R, ...) with the scale of each model, without a constant [nat]."""
    scale = compute_error_scales(rollouts, errors)
    relative = np.pi / 2 * np.abs(errors) / scale
    return np.asarray(-np.log(scale) - relative - np.log1p(np.exp(-2 * relative)))


def compute_log_likelihood(rollouts: Rollouts, errors: Array) -> Array:
    """Return the log density (...) of all errors (R, ...) of models, see `compute_log_densities` [nat]."""
    return np.asarray(compute_log_densities(rollouts, errors).sum(axis=0))


def compute_likelihood_scale(rollouts: Rollouts, error: Array) -> float:
    """Return the scale with the same likelihood as the errors (R,) [rad]; a smaller scale is likelier."""
    return float(np.exp(-compute_log_likelihood(rollouts, error) / len(error)))


def choose_likeliest_point(rollouts: Rollouts, points: Sequence[Point]) -> tuple[Point, float, Array]:
    """Return the likeliest of some points, its log density without a constant [nat], and its errors (R,) [rad]."""
    errors = rollouts.compute_position_errors(points)
    likelihoods = compute_log_likelihood(rollouts, errors)
    best = int(np.argmax(likelihoods))
    return points[best], float(likelihoods[best]), errors[:, best].copy()
