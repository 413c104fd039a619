"""Bias of the schemes by encoder noise, measured by adding this noise once more.

Noise of the acceleration stands in the regressor, which draws inertia towards zero by the square of its share of the
acceleration. Noise of twice the variance shifts the estimates by as much again.
Source: Cook and Stefanski, Journal of the American Statistical Association 89, 1994 (simulation-extrapolation).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.regression.least_squares import IdentificationError
from estimators.schemes.fitting import Identified
from estimators.signals.differentiation import estimate_encoder_noise
from estimators.signals.measurements import has_encoder_bias
from pendulum_env.recording import Recording

DRAWS = 4  # noise signals, each with both signs: only the even part of the shift is bias


def remove_encoder_bias(
    results: dict[str, Identified],
    recordings: Sequence[Recording],
    fit: Callable[[Sequence[Recording]], Mapping[str, Identified]],
) -> dict[str, Identified]:
    """Return the results of schemes without the bias by encoder noise, if smoothing leaves too much of this noise.

    `fit` maps recordings to results of the same schemes. The scatter of the measured bias is added to standard errors.
    The results are unchanged if too little motion is clear of stick under the added noise.
    """
    noises = [_list_noises(recording) for recording in recordings]
    if not any(noise.any() for noise in noises):
        return results
    rng, shifts = np.random.default_rng(0), {id: list[np.ndarray]() for id in results}
    for _ in range(DRAWS):
        errors = [noise * rng.standard_normal(r.position.shape) for noise, r in zip(noises, recordings, strict=True)]
        try:
            pair = [
                fit([replace(r, position=r.position + sign * e) for r, e in zip(recordings, errors, strict=True)])
                for sign in (1, -1)
            ]
        except IdentificationError:
            return results
        for id, result in results.items():
            shifts[id].append(sum(noisy[id].model.theta for noisy in pair) / 2 - result.model.theta)
    return {
        id: result.without_bias(np.mean(shifts[id], axis=0), np.std(shifts[id], axis=0, ddof=1) / np.sqrt(DRAWS))
        for id, result in results.items()
    }


def _list_noises(recording: Recording) -> np.ndarray:
    """Return the standard deviation of encoder noise per joint (n,), or () of a pendulum; zero if it causes no bias."""
    joints = recording.joints
    biased = any(has_encoder_bias(joint) for joint in joints)
    noises = [biased * estimate_encoder_noise(joint.position) for joint in joints]
    return np.array(noises if recording.position.ndim > 1 else noises[0])
