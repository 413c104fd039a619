"""Filters of series, without the import time of `scipy.signal`."""

from math import factorial

import numpy as np
import scipy

from pendulum_env._typing import Array


def filter_lag(series: Array, keep: float, before: float = 0.0) -> Array:
    """Filter a series x (N,) or (N, P) by y[k] = a y[k-1] + (1 - a) x[k], with a = `keep` and y[-1] = `before`.

    Equal to `scipy.signal.lfilter([1 - a], [1, -a], x, axis=0)`, solved as a bidiagonal system.
    """
    driven = (1 - keep) * series
    driven[:1] += keep * before
    bands = np.array([[1.0], [-keep]]) * np.ones(len(series))
    solved, _ = scipy.linalg.lapack.dtbtrs(bands, driven, uplo="L")
    return np.asarray(solved)


def filter_shifted(series: Array, newest: int, weights: Array) -> Array:
    """Filter a series x (N,) by y[k] = sum of weights[j] x[k + newest - j], with weights (L,); its ends repeat."""
    first = newest - len(weights) + 1
    samples = np.arange(first, len(series) + newest)
    return np.convolve(series.take(samples, mode="clip"), weights, "valid")


def filter_savitzky_golay(series: Array, length: int, degree: int, derivative: int = 0, period: float = 1.0) -> Array:
    """Return a derivative (N,) of a series (N,) from polynomials fitted to `length` samples, an odd number.

    Near an end, the polynomial of the first or last `length` samples is used. Equal to `scipy.signal.savgol_filter`.

    Source: Savitzky and Golay, Analytical Chemistry 36(8), 1964.
    """
    half = length // 2
    powers = np.vander(np.arange(-half, half + 1) / max(half, 1), degree + 1, increasing=True)  # (L, D + 1)
    coefficients = np.linalg.pinv(powers)  # (D + 1, L), from samples to coefficients
    factors = np.array([factorial(n) / factorial(n - derivative) for n in range(derivative, degree + 1)])
    slopes = powers[:, : degree + 1 - derivative] * factors / (max(half, 1) * period) ** derivative
    smoother = slopes @ coefficients[derivative:]  # (L, L), from samples to derivatives
    inner = np.correlate(series, smoother[half], mode="valid")
    return np.concatenate([smoother[:half] @ series[:length], inner, smoother[half + 1 :] @ series[-length:]])
