"""Bias of the schemes by encoder noise in the regressor, measured by adding this noise once more.

Noise of the acceleration draws inertia towards zero. With added noise, the sums of phi phi' and phi y exceed those of
the measured motion, on average by D and d. Noise of the encoder makes the same difference to the true motion:

    (phi' phi - D) theta = phi' y - d .

Online estimates are corrected alike, see `estimators.online.noise_bias`.

Source: Fuller, Measurement Error Models, 1987 (normal equations less the moments of the error); Cook and Stefanski,
Journal of the American Statistical Association 89, 1994 (moments by added noise).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.regression.balance import Balance
from estimators.regression.least_squares import Equations, solve_within_bounds
from estimators.regression.noise import UNCERTAINTY, limit_noise
from estimators.schemes.balance import Joints, Segments, add_joint_states
from estimators.signals.differentiation import estimate_encoder_noise
from estimators.signals.measurements import has_encoder_bias
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Term
from pendulum_env.recording import Recording

DRAWS = 4  # noise signals, each with both signs


@dataclass(frozen=True, eq=False)
class NoiseCorrection:
    """Least-squares estimates without the bias by encoder noise.

    Attributes:
        theta: corrected estimates within their bounds (P,).
        has_bias: whether bias remains, because the noise has more than `MAX_NOISE_SHARE` of the information.
        amplification: derivative of the corrected by the least-squares estimates, of the F free parameters (F, F).
        covariance: of the error of the correction itself (F, F).
    """

    theta: Array
    has_bias: bool
    amplification: Array
    covariance: Array

    def widen(self, covariance: Array) -> Array:
        """Convert the covariance of the least-squares estimates (F, F) to that of the corrected estimates."""
        widened: Array = self.amplification @ covariance @ self.amplification.T + self.covariance
        return widened


def copy_with_noise(segments: Segments, recordings: Sequence[Recording], terms: Sequence[Term]) -> list[Segments]:
    """Copy segments with noise of the encoders added; adjacent copies have opposite noise.

    There are no copies if smoothing makes this noise negligible at all joints. Filters and masks stay as measured.
    """
    joints = [recording.joints for recording in recordings]
    if not any(has_encoder_bias(joint) for of_recording in joints for joint in of_recording):
        return []
    noises = [[estimate_encoder_noise(joint) for joint in of_recording] for of_recording in joints]
    rng, copies = np.random.default_rng(0), list[Segments]()
    for _ in range(DRAWS):
        pairs = [
            [_make_noisy_pair(joints, stds, terms, rng) for joints in group]
            for group, stds in zip(segments, noises, strict=True)
        ]
        copies += [[[pair[sign] for pair in group] for group in pairs] for sign in (0, 1)]
    return copies


def _make_noisy_pair(
    joints: Joints, stds: Sequence[float], terms: Sequence[Term], rng: np.random.Generator
) -> tuple[Joints, ...]:
    """Return measurements of joints with added noise of standard deviations `stds` [rad], and with its negative."""
    errors = [std * rng.standard_normal(len(m) + 2 * (m.reach - 1)) for m, std in zip(joints, stds, strict=True)]
    return tuple(
        add_joint_states(tuple(m.add_noise(sign * error) for m, error in zip(joints, errors, strict=True)), terms)
        for sign in (1, -1)
    )


def measure_excess(measured: Equations, copies: Sequence[Equations], weights: Array, usable: Mask) -> Array:
    """Return the excess of the products of phi and y by noise, from each pair of copies (K, P + 1, P + 1)."""
    products = []
    for equations in (measured, *copies):
        rows = np.column_stack([equations.phi, equations.y])[usable] * weights[usable, None]
        products.append(rows.T @ rows)
    pairs = [(plus + minus) / 2 - products[0] for plus, minus in zip(products[1::2], products[2::2], strict=True)]
    return np.array(pairs)


def correct_fit(balance: Balance, theta: Array, excess: Array) -> NoiseCorrection:
    """Correct a least-squares fit theta (P,) for the excess by noise (K, P + 1, P + 1).

    Directions of the parameters that the equations do not determine are left as they are.
    """
    fitted = np.flatnonzero(balance.least < balance.most)
    least, most = balance.least[fitted], balance.most[fitted]
    rows = np.column_stack([balance.phi, balance.y]) * balance.weights[:, None]
    scale = np.sqrt(np.sum(rows[:, fitted] ** 2, axis=0))
    scale = 1.0 / np.where(scale > 0, scale, 1.0)
    # columns of a step from theta in scaled parameters, and the errors at theta
    change = np.column_stack([np.eye(len(theta) + 1)[:, fitted] * scale, np.append(-theta, 1.0)])
    gram, excess = change.T @ (rows.T @ rows) @ change, change.T @ excess @ change
    P = _invert(gram[:-1, :-1])
    determined = np.eye(len(gram))
    determined[:-1, :-1] = P @ gram[:-1, :-1]
    excess = determined.T @ excess @ determined
    factor, share = limit_noise(P, np.zeros(len(fitted)), gram[-1, -1], excess.mean(axis=0))
    excess = factor * excess
    noise = excess.mean(axis=0)
    normal, target = (gram - noise)[:-1, :-1], (gram - noise)[:-1, -1]

    def solve(step: Array, free: Mask) -> Array:
        step = np.where(free, 0.0, step)
        step[free] = _invert(normal[np.ix_(free, free)]) @ (target - normal @ step)[free]
        return step

    ends = (least - theta[fitted]) / scale, (most - theta[fitted]) / scale
    step, free = solve_within_bounds(solve, np.zeros(len(fitted)), np.ones(len(fitted), dtype=bool), *ends)
    corrected = theta.copy()
    corrected[fitted] = np.where(free, theta[fitted] + scale * step, np.where(step <= ends[0], least, most))
    inverse, scale = _invert(normal[np.ix_(free, free)]), scale[free]
    amplification = np.eye(len(scale)) + inverse @ noise[:-1, :-1][np.ix_(free, free)]
    steps = (excess @ np.append(step, -1.0))[:, :-1][:, free] @ inverse * scale  # by the noise of each pair
    bias = (1.0 / share.item() - 1.0 + UNCERTAINTY) * steps.mean(axis=0)
    covariance = np.outer(bias, bias) + np.atleast_2d(np.cov(steps.T)) / len(steps)
    return NoiseCorrection(corrected, share.item() < 1.0, amplification * np.divide.outer(scale, scale), covariance)


def _invert(normal: Array) -> Array:
    """Return the pseudo-inverse of scaled normal equations (F, F), zero for directions without information."""
    return np.asarray(np.linalg.pinv(normal, rcond=1e-10, hermitian=True), dtype=float)
