"""Windows of recordings with lengths chosen by noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from estimators.decisions.score import BLOCK
from estimators.regression.least_squares import IdentificationError, solve_least_squares
from estimators.signals.motion import HALF_WIDTHS, LONG_HALF_WIDTHS, compute_fast_speed
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.torque_windows import TorqueWindows, join_windows
from estimators.weak_form.window_columns import WindowColumns, WindowTorque
from estimators.weak_form.windows import WHOLE, Part, Windows, cut
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Term
from pendulum_env.physics.actuation import TorqueOffset
from pendulum_env.physics.friction import PositionDependentFriction, QuadraticDrag, Stribeck, ViscousAsymmetry
from pendulum_env.physics.potential import Cogging, GravityTilt
from pendulum_env.recording import Recording
from pendulum_env.recording.sampling import SAMPLING


def prepare_windows(
    recordings: Sequence[Recording],
    half_widths: Sequence[float] | None = None,
    part: Part = WHOLE,
    margin: float = 0.0,
    fewest: int = RESOLUTION.fewest,
    inertia: float | None = None,
    block: float = BLOCK,
) -> TorqueWindows:
    """Cut recordings into windows, with half widths [s] chosen by their noise unless given; see `cut`.

    A known inertia [kg m^2] scales encoder noise; without it, that of the base model does. A `block` of the score lasts
    so long [s].

    Raises:
        IdentificationError: if fewer windows than `fewest` are clear of stick.
    """
    widths = half_widths or [choose_half_width(recording, inertia) for recording in recordings]
    windows = (cut(recording, width, part, margin) for recording, width in zip(recordings, widths, strict=True))
    data = join_windows([replace(calibrate_noise(w), inertia=inertia) for w in windows], block=block)
    if (usable := len(data.weights)) < fewest:
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: only {usable} stretches of motion are clear of stick, at least {fewest} are needed: record "
            "longer, faster or wider motion"
        )
    return data


def choose_half_width(
    recording: Recording, known_inertia: float | None = None, longest: float = LONG_HALF_WIDTHS[-1]
) -> float:
    """Choose the shortest half width [s] with enough windows clear of stick and little encoder noise.

    Encoder noise, scaled by the known inertia of the joint without load or else by that of the base model [kg m^2],
    must be below torque noise, or negligible for the torque, and bias the inertia by at most its standard error. If no
    half width meets both, that with the smallest error of the inertia is chosen, see `InertiaError.cost`, also among
    long ones, up to `longest`, if others bias it by more. Short windows include samples near reversals, which show
    friction. Encoder noise falls with length^`decay`.

    In a free swing, the shortest windows in which encoder noise would be negligible may be much longer. Such windows
    include reversals, see `cut`. They are taken if noise in the longest of the others is above `negligible`, and are at
    most `longest_swing` long.
    """
    widths, cut_at = _list_half_widths(recording), cache(partial(cut, recording))
    widest, settings = cut_at(widths[-1]), RESOLUTION.width
    load_inertia = widest.noise.load_inertia
    # [kg m^2], and factor on the torque noise by calibration
    inertia, noise_factor = load_inertia + recording.known_inertia, 1.0
    for w in map(cut_at, reversed(widths)):  # long windows have less noise
        if len(w.centers) >= settings.calibrating:
            inertia = load_inertia + (known_inertia or join_windows((w,)).base_inertia)
            noise_factor = calibrate_noise(w).noise.torque / max(w.noise.torque, 1e-300)
            break
    negligible = (settings.negligible_swing if recording.known_inertia else settings.negligible) * widest.torque_scale

    def is_feasible(width: float) -> bool:
        count = len(cut_at(width).centers)
        return count >= settings.enough or count * width >= settings.clear * recording.duration

    @cache
    def bound_error(width: float) -> InertiaError:
        return bound_inertia_error(cut_at(width), inertia, noise_factor)

    def is_quiet(width: float) -> bool:
        noise = cut_at(width).noise
        if inertia * noise.acceleration > max(settings.quiet * noise_factor * noise.torque, negligible):
            return False
        return bound_error(width).is_small

    quiet = next((width for width in widths if is_feasible(width) and is_quiet(width)), None)  # others are not cut
    noise = inertia * widest.noise.acceleration
    if quiet is None and recording.known_inertia and noise > settings.negligible * widest.torque_scale:
        half_width = min(
            widths[-1] * (noise / negligible) ** (1 / settings.decay),
            0.5 * settings.longest_swing * find_period(widest),
        )
        if half_width > HALF_WIDTHS[-1]:
            return half_width
    if quiet is not None:
        return quiet
    best = min(list(filter(is_feasible, widths)) or widths, key=lambda width: bound_error(width).cost)
    for width in (*widths, *(() if recording.known_inertia else LONG_HALF_WIDTHS)):
        if bound_error(best).is_small or width > longest:
            break
        if len(cut_at(width).centers) >= 2 * RESOLUTION.fewest:
            best = min(best, width, key=lambda width: bound_error(width).cost)
    return best


class InertiaError(NamedTuple):
    """Errors of an inertia, relative to it.

    Attributes:
        std: standard error that its fit reports.
        bias: its bias by encoder noise.
    """

    std: float
    bias: float

    @property
    def is_small(self) -> bool:
        """Return whether the standard error covers the bias."""
        return self.bias <= self.std < math.inf

    @property
    def cost(self) -> float:
        """Root of the mean squared error, times the ratio of bias to standard error if that exceeds one."""
        return math.hypot(self.std, self.bias) * max(1.0, self.bias / max(self.std, 1e-300))


def bound_inertia_error(w: Windows, inertia: float, noise_factor: float) -> InertiaError:
    """Return the errors of the inertia in a fit of the base model to windows; infinite for few windows, or no inertia.

    Of a free swing with a known inertia, the error is that of its mean acceleration [rad/s^2].
    Noise of the acceleration lowers the inertia by its share of the square of the acceleration that the other columns
    do not explain. `noise_factor` corrects the torque noise.
    """
    columns = WindowColumns([w])
    acceleration, *others = (columns.columns([term])[0][0][:, 0] for term in BASE)
    if len(acceleration) <= 2 * len(BASE) or inertia <= 0:
        return InertiaError(math.inf, 0.0)
    if w.recording.known_inertia:
        return InertiaError(w.noise.acceleration / math.sqrt(len(acceleration)), 0.0)
    phi = np.column_stack(others)
    free = acceleration - phi @ solve_least_squares(phi, acceleration)
    noise = w.noise.acceleration**2
    square = max(float(free @ free) / (len(free) - len(BASE)) - noise, 1e-3 * noise, 1e-300)
    of_torque = min(noise_factor * w.noise.torque / inertia, 1e100) ** 2
    std, bias = math.sqrt((noise + of_torque) / (len(free) * (noise + square))), noise / (noise + square)
    return InertiaError(std, bias)


def find_period(w: Windows) -> float:
    """Return the period of a swing [s], twice the median time between reversals; 0 with fewer than two reversals."""
    instants = np.flatnonzero(w.moving)
    reversals = instants[1:][np.diff(np.sign(w.samples.velocity[instants])) != 0]
    return 2 * float(np.median(np.diff(reversals))) / w.recording.rate if len(reversals) > 1 else 0.0


def _list_half_widths(recording: Recording) -> tuple[float, ...]:
    """Return the `HALF_WIDTHS` [s] of at least two samples that fit into the recording; else two samples.

    Raises:
        IdentificationError: if the recording is too short.
    """
    shortest, duration = 2.0 / recording.rate, len(recording) / recording.rate
    if duration < SAMPLING.shortest:
        raise IdentificationError(
            f"{recording.name}: lasts {duration:.3g} s, at least {SAMPLING.shortest:g} s are needed: record longer"
        )
    return tuple(h for h in HALF_WIDTHS if 0.99 * shortest <= h < 0.5 * duration) or (shortest,)


def smooth_laws(w: Windows) -> tuple[Term, ...]:
    """Return terms that together fit nearly any smooth torque; their residual is noise."""
    settings = RESOLUTION.width
    fast = max(compute_fast_speed(w.samples.velocity), 1e-6)
    return (
        *BASE,
        TorqueOffset(),
        GravityTilt(),
        ViscousAsymmetry(),
        *(Stribeck(share * fast) for share in settings.shares),
        QuadraticDrag(),
        PositionDependentFriction(),
        *(Cogging(order) for order in settings.orders),
    )


def calibrate_noise(w: Windows) -> Windows:
    """Limit the noise estimate of windows to the residual of a fit of all smooth laws.

    Torque that changes at each sample, as under fast control, counts as noise in the first estimate. The acceleration
    follows this torque, so it leaves no residual.
    """
    columns = WindowColumns([w])
    phi = np.column_stack([columns.columns([law])[0][0] for law in smooth_laws(w)])
    if known := w.recording.known_inertia:
        return limit_noise(w, phi[:, 1:], lambda theta: known, known * phi[:, 0])
    return limit_noise(w, phi, lambda theta: float(theta[0]))


def scale_by_rounding(w: Windows, inertia: float) -> Windows:
    """Return windows whose equations count less where a position of significant digits has larger steps."""
    if (factor := w.noise.scale_rows(inertia)) is None:
        return w
    return replace(w, scale=factor if w.scale is None else 1.0 / np.sqrt(w.scale**-2 + factor**-2 - 1.0))


def limit_noise(w: Windows, phi: Array, inertia: Callable[[Array], float], known: Array | float = 0.0) -> Windows:
    """Lower the noise estimates of windows so that their floor is at most the residual of a linear fit.

    The fit has columns `phi` (R, P) and a known torque (R,) [N m]. With fewer than 2 P rows the windows are unchanged.
    `inertia` maps parameters (P,) to the inertia [kg m^2].

    Neighbouring windows share other parts of the torque's noise than of the encoder's. Their covariance divides the
    power of the residual between both, each at most its estimate; with few neighbours, both have one factor.
    """
    freedom = len(phi) - phi.shape[1]
    if freedom < phi.shape[1]:
        return w
    y = WindowTorque([w]).net - known
    theta = solve_least_squares(phi, y)
    residual, load, noise = y - phi @ theta, abs(inertia(theta)), w.noise
    w = scale_by_rounding(w, load)
    power = float(residual @ residual) / freedom
    if power >= noise.compute_std(load) ** 2:
        return w
    adjacent = np.flatnonzero(np.diff(w.centers) == len(w.kernel) // 2)
    if len(adjacent) < freedom / 2:  # too few neighbours
        return replace(w, noise=noise.scale(math.sqrt(power) / noise.compute_std(load)))
    shared = float(residual[adjacent] @ residual[adjacent + 1]) / len(adjacent) * len(phi) / freedom
    return replace(w, noise=noise.divide_power(load, power, shared))
