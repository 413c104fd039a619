"""Errors of windowed torque: noise floor, numerical precision, structure of a residual, and noise that terms absorb."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.decisions.criterion import ResidualStructure
from estimators.weak_form.blocks import number_blocks
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.window_columns import WindowColumns, WindowTorque
from estimators.weak_form.windows import Windows, average_held_torque
from pendulum_env._typing import Array
from pendulum_env.physics import Term


def compute_precision(windows: Sequence[Windows]) -> float:
    """Return the torque error of smoothing and integration in the windows of one joint [N m]."""
    return RESOLUTION.precision * float(np.std(WindowTorque(windows).applied))


def compute_numerical_error(windows: Sequence[Windows]) -> float:
    """Return the largest numerical error of the joints' torque [N m], see `compute_precision`."""
    joints = dict.fromkeys(w.at for w in windows)
    return max(compute_precision([w for w in windows if w.at == at]) for at in joints)


def compute_noise_floor(windows: Sequence[Windows], inertia: float) -> float:
    """Return the noise floor of a joint with an inertia [kg m^2]: RMS over the windows of the error by noise [N m].

    It is at least `compute_precision`.
    """
    counts = np.array([len(w.centers) for w in windows])
    levels = np.array([w.noise.compute_std(inertia) for w in windows])
    return max(compute_precision(windows), float(np.sqrt(np.sum(counts * levels**2) / max(1, counts.sum()))))


def measure_structure(windows: Sequence[Windows], residual: Array, inertia: float, length: float) -> ResidualStructure:
    """Measure the size of a residual (R,) [N m], and its correlation between windows half a window apart.

    The covariance due to white sensor noise, of a joint with an inertia [kg m^2], is subtracted; this noise is at
    most the residual. The correlation is normalised in blocks of a `length` [s], so blocks with large residuals do not
    dominate. A correlated part below `compute_precision` counts as zero.
    """
    block, start = number_blocks(windows, length), 0
    products, squares, owners = [], [], []
    for w in windows:
        count, m = len(w.centers), len(w.kernel) // 2
        of_recording = residual[start : start + count]
        adjacent = np.flatnonzero(np.diff(w.centers) == m)
        share = min(1.0, float(np.sum(of_recording**2)) / max(count * w.noise.compute_std(inertia) ** 2, 1e-300))
        products.append(
            of_recording[adjacent] * of_recording[adjacent + 1] - share * w.noise.compute_shared_covariance(inertia)
        )
        squares.append(0.5 * (of_recording[adjacent] ** 2 + of_recording[adjacent + 1] ** 2))
        owners.append(block[start + adjacent])
        start += count
    product, square, owner = np.concatenate(products), np.concatenate(squares), np.concatenate(owners)
    rms = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
    if len(product) == 0:
        return ResidualStructure(0.0, 0.0, rms)
    counts = np.bincount(owner)
    is_filled = counts > 0
    correlation = np.bincount(owner, product)[is_filled] / np.maximum(np.bincount(owner, square)[is_filled], 1e-300)
    z_score = float(counts[is_filled] @ correlation) / float(np.sqrt(len(product)))
    size = float(np.sqrt(max(product.mean(), 0.0)))
    return ResidualStructure(size if size > compute_precision(windows) else 0.0, z_score, rms)


def compute_absorbed_noise(windows: Sequence[Windows], term: Term) -> float:
    """Estimate the variance of white torque noise that a term's fixed columns absorb [(N m)^2], mean over all rows.

    The noise is drawn at random.
    """
    counts = [len(w.centers) for w in windows]
    parts = [count * _draw_absorbed_noise(w, term) for count, w in zip(counts, windows, strict=True) if count]
    return sum(parts) / max(1, sum(counts))


def _draw_absorbed_noise(w: Windows, term: Term) -> float:
    """Return the variance that a term absorbs of a draw of the torque noise of one recording [(N m)^2]."""
    noise = np.random.default_rng(0).standard_normal(len(w.recording)) * w.noise.raw_torque
    averages = average_held_torque(noise)
    noisier = w.with_torque(w.recording.torque + noise, w.samples.torque + averages)
    ((_, noisy_fixed),), ((_, fixed),) = (WindowColumns([each]).columns([term]) for each in (noisier, w))
    averaged_noise = w.averages.narrow @ averages
    return max(0.0, float(np.var(averaged_noise) - np.var(averaged_noise - (noisy_fixed - fixed))))
