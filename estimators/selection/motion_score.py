"""Evidence of free motion: errors of simulated segments over their noise, for models that torque does not decide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.data.fits import compute_inertia
from estimators.decisions.criterion import Criterion
from estimators.decisions.score import MAX_ITERATIONS, Bootstrap, Gain, compute_log_student, weigh_squares
from estimators.signals.differentiation import estimate_encoder_noise
from estimators.simulation import output_error
from estimators.simulation.free_running import Segments, simulate_errors
from estimators.weak_form.point import Point
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Model, has_transmission

LARGEST_EXPONENT = 20.0  # of a growth, from which a free run shows nothing


def fit_to_motion(segments: Sequence[Segments], start: Model) -> Model:
    """Return the model with the parameters that minimise the errors of simulated segments, from those of `start`."""
    return output_error.make_model(segments, output_error.fit_segments(segments, Point.from_model(start)))


def compute_floor(segments: Sequence[Segments], accuracy: float) -> Array:
    """Return the mean square error of each segment by encoder noise and simulation (B,) [rad^2].

    `accuracy` is the error of a simulation, as a share of the standard deviation of the motion.
    """
    of_simulation = accuracy * float(np.std(np.concatenate([segment.position.ravel() for segment in segments])))
    of_encoder = [estimate_encoder_noise(segment.windows.recording) for segment in segments]
    return of_simulation**2 + np.repeat(np.square(of_encoder), [len(segment.first) for segment in segments])


def compute_growth(segments: Sequence[Segments], model: Model) -> Array:
    """Return the largest growth of an error of the velocity along the measured motion of each segment (B,), at least 1.

    An error grows at the rate -(dF/dv) / J where the friction F falls with the speed v. By a small error, a free run at
    a slow speed sticks or runs away. Terms with states have no share.
    """
    growths = list[Array]()
    for segment in segments:
        w, inertia = segment.windows, compute_inertia(model, segment.windows.samples)
        step = 0.01 * float(np.sqrt(np.mean(w.samples.velocity**2)))
        faster, slower = (_compute_friction(model, w, change) for change in (step, -step))
        rate = np.where(w.moving, (slower - faster) / (2 * step * inertia), 0.0)
        index = segment.first + np.arange(len(segment.torque))[:, None]
        exponent = np.cumsum(rate[index] / w.recording.rate, axis=0)
        growths.append((exponent - np.minimum.accumulate(exponent, axis=0)).max(axis=0))
    return np.exp(np.minimum(np.concatenate(growths), LARGEST_EXPONENT))


def _compute_friction(model: Model, w: Windows, change: float) -> Array:
    """Return the friction of a model in all samples (N,) at speeds that are higher by a change [rad/s]."""
    sign = np.sign(w.samples.velocity)
    x = replace(w.samples, velocity=w.samples.velocity + sign * change)
    terms = [term for term in model.terms if term.kind == "dissipative" and not term.has_state()]
    parts = [
        model.estimates[column.name].value * (column.force(x) * sign + column.dry(x))
        for term in terms
        for column in term.columns
    ]
    return np.asarray(sum(parts, np.zeros(len(sign))))


def exceeds_noise(segments: Sequence[Segments], model: Model, criterion: Criterion) -> bool:
    """Return whether the position errors of a model exceed those by noise `criterion.misfit_ratio` times, RMS of all.

    Noise of each segment is that of torque, initial states and encoder, and the accuracy of the simulation, times the
    growth of errors along the measured motion.
    """
    point = Point.from_model(model)
    noise = output_error.compute_noise(segments, point) + compute_floor(segments, criterion.accuracy)
    noise *= compute_growth(segments, model) ** 2
    errors = [simulate_errors(segment, model.terms, point.theta)[1:] for segment in segments]
    squares = np.concatenate([np.mean(error**2, axis=0) for error in errors])
    return bool(np.mean(squares / noise) > criterion.misfit_ratio**2)


def is_misfit(segments: Sequence[Segments], model: Model, criterion: Criterion) -> bool:
    """Return whether free-running simulation errs by more than `criterion.misfit_ratio` noise levels of each segment.

    That must hold from measured and from fitted initial states; from the latter, errors of the parameters are noise,
    too. It is False for a transmission, with impacts too sharp to simulate, and without segments or a known inertia.
    """
    if has_transmission(model.terms) or not (segments and model.has_known_inertia):
        return False
    if not exceeds_noise(segments, model, criterion):
        return False
    noise = compute_motion_noise(segments, model, criterion.accuracy)
    noise += output_error.compute_uncertainty(segments, model)
    noise *= compute_growth(segments, model) ** 2
    return bool(np.mean(compute_motion_squares(segments, model) / noise) > criterion.misfit_ratio**2)


def compute_motion_squares(segments: Sequence[Segments], model: Model) -> Array:
    """Return the mean square error of each segment with free initial states (B,) [rad^2]."""
    return output_error.compute_segment_rms(segments, Point.from_model(model)) ** 2


def compute_motion_noise(segments: Sequence[Segments], model: Model, accuracy: float) -> Array:
    """Return the mean square error of each segment by torque noise and its floor (B,) [rad^2], see `compute_floor`."""
    noise = output_error.compute_noise(segments, Point.from_model(model), has_free_states=True)
    return noise + compute_floor(segments, accuracy)


def compute_motion_gain(
    owner: Index, after: Array, before: Array, noise: Array, penalty: float = 0.0
) -> tuple[Gain, tuple[float, float]]:
    """Return the gain of one model over another on all segments, and the removed share of squared errors of each part.

    `owner` (B,) is 0 for segments of the training data, 1 for held-out ones. `after` and `before` are the mean square
    errors of both models, `noise` those of noise (B,) [rad^2].
    Errors within a segment are fully correlated: its mean square counts as one squared error, over its known noise. The
    gain is that of Student's t, with a scale of at least the noise in each part. Noise is subtracted from the shares.
    It has no error of the simulation, which is that of both models. `penalty` is that of `Bootstrap.gain`.
    """
    new, old = after / noise, before / noise
    densities = [_compute_density_of_ratios(ratios, owner) for ratios in (new, old)]
    gain = Bootstrap(owner).gain(densities[0], densities[1], penalty)
    old_excess, new_excess = (np.bincount(owner, ratios - 1.0).tolist() for ratios in (old, new))
    first, second = ((a - b) / a if a > 0 else 0.0 for a, b in zip(old_excess, new_excess, strict=True))
    return gain, (first, second)


def _compute_density_of_ratios(ratios: Array, owner: Index) -> Array:
    """Return the log density of squared errors over noise (B,) by Student's t; its scale in each part is at least 1."""
    scale = np.ones(int(owner.max()) + 1)
    for _ in range(MAX_ITERATIONS):
        weighted = np.bincount(owner, weigh_squares(ratios, scale[owner])) / np.bincount(owner)
        scale = np.maximum(weighted, 1.0)
    return compute_log_student(ratios, scale[owner])
