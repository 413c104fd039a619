"""Limits of a correction for noise in the regressor, which least squares and the online recursion share."""

import numpy as np

from pendulum_env._typing import Array

MAX_NOISE_SHARE = 0.5  # largest share of information that is subtracted as noise
UNCERTAINTY = 0.3  # of the variance of the encoder noise, relative


def limit_noise(P: Array, theta: Array, squares: Array, excess: Array) -> tuple[Array, Array]:
    """Return the factor of the excess by noise that is subtracted from normal equations, and its limited part.

    Noise is scaled down to explain at most the errors. At most `MAX_NOISE_SHARE` of the information is subtracted.

    Args:
        P: inverse of phi' phi (..., P, P).
        theta: estimates (..., P).
        squares: sums of squared errors (...).
        excess: excess of the products of phi and y by noise (..., P + 1, P + 1).

    Returns:
        The factor, and the share of the noise in it, 1 within the limit, (..., 1, 1) each.
    """
    errors = np.append(-theta, np.ones((*theta.shape[:-1], 1)), axis=-1)  # times an equation
    noise = np.einsum("...i,...ij,...j", errors, excess, errors)
    scale = np.where(noise > squares, squares / np.where(noise > squares, noise, 1.0), 1.0)[..., None, None]
    noise_share = np.einsum("...ii", P @ (scale * excess[..., :-1, :-1]))[..., None, None]
    share = MAX_NOISE_SHARE / np.maximum(noise_share, MAX_NOISE_SHARE)
    factor: Array = scale * share
    return factor, share
