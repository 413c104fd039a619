"""Reasons to refuse a recording that can be parsed but not be true, or not be used.

Every check takes whole columns in SI units and raises RecordingError, or returns nothing.
"""

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.recording.record import RecordingError

SHORTEST = 1.0  # [s]; about one swing of an arm of 0.3 m
FEWEST = 100  # samples
SLOWEST = 10.0  # [Hz]; an arm swings at about 1 Hz
FASTEST = 200.0  # [rad/s]; direct-drive arms reach some 40
WINDOW = 0.02  # [s] over which speeds are taken: longer than encoder steps, shorter than a swing
SMOOTHING = 0.05  # [s] window of the second derivative
DEGREE = np.pi / 180  # [rad]
UNWRAP = "read it with --unwrap (unwrap=True)"  # what mends a wrapped angle, on the command line and in Python


def refuse_not_finite(values: dict[str, Array]) -> None:
    """Refuse empty cells, NaN and infinity."""
    for quantity, column in values.items():
        if not (finite := np.isfinite(column)).all():
            row = int(np.argmin(finite))
            came = "empty or NaN" if np.isnan(column[row]) else "infinite"
            raise RecordingError(
                f"data row {row + 1} (header not counted) has {quantity} that is {came}: repair or remove that row"
            )


def refuse_too_few(time: Array) -> None:
    """Refuse fewer samples than any estimate could be made from."""
    if len(time) < FEWEST:
        raise RecordingError(f"it holds {len(time)} samples, of which at least {FEWEST} are needed: record longer")


def refuse_too_short(time: Array) -> None:
    """Refuse sampling too slow for a pendulum (time in milliseconds, perhaps) and recordings shorter than a swing."""
    duration = time[-1] - time[0]
    rate = (len(time) - 1) / duration
    if rate < SLOWEST:
        raise RecordingError(
            f"{1 / rate:.3g} s pass between samples, too long for a pendulum ({SLOWEST:g} Hz is the least): "
            "name the column time_ms if it is in milliseconds, or sample faster"
        )
    if duration + 1 / rate < 0.99 * SHORTEST:
        raise RecordingError(f"it lasts {duration:.3g} s, of which at least {SHORTEST:g} s are needed: record longer")


def refuse_still(position: Array) -> None:
    """Refuse a position that never changes: nothing can be learned from it, whatever the torque."""
    if (position == position[0]).all():
        raise RecordingError(
            f"position is {position[0]:.6g} rad in every row, so nothing can be learned: check the encoder, "
            "or record the arm moving"
        )


def refuse_jumps(position: Array, *, allow_wrapped: bool) -> None:
    """Refuse angles that jump by more than half a turn between samples: wrapped, or not an angle at all."""
    jumps = np.abs(np.diff(position))
    if (size := float(jumps.max())) <= np.pi:
        return
    row = int(np.argmax(jumps > size / 2)) + 2
    what = f"position jumps by {size:.4g} rad from one sample to the next at data row {row} (header not counted)"
    if np.ptp(position) < 2 * np.pi + 0.1 or abs(size - 2 * np.pi) < 0.5:
        if not allow_wrapped:
            raise RecordingError(f"{what}, as an angle wrapped at 2 pi does: {UNWRAP}")
    elif 270 < size < 361:
        raise RecordingError(
            f"{what}, as an angle wrapped at 360 degrees does: name the column position_deg, and {UNWRAP}"
        )
    else:
        raise RecordingError(
            f"{what}: name the column position_deg if it is in degrees, or repair the glitch if it is one"
        )


def refuse_too_fast(rate: float, position: Array) -> None:
    """Refuse speeds that no arm reaches."""
    span = max(1, round(WINDOW * rate))
    speed = np.abs(position[span:] - position[:-span]) * (rate / span)  # [rad/s]
    if (top := float(speed.max())) > FASTEST:
        raise RecordingError(
            f"position moves at {top:.0f} rad/s near data row {int(np.argmax(speed)) + 1} (header not counted), faster "
            "than any arm: name the column position_deg if it is in degrees, or repair the glitch if it is one"
        )


def refuse_degrees(rate: float, position: Array, torque: Array) -> None:
    """Refuse degrees by the look of it: gravity acts with the sine of position in degrees, and not of radians.

    The acceleration is fitted with torque and friction alone, then with sin q and cos q as well, q read either way;
    only position that covers more than 2 pi is judged, and only if it accelerates at all.
    """
    if np.ptp(position) <= 2 * np.pi:
        return
    from scipy.signal import savgol_filter  # here, as it takes half a second

    stride = max(1, round(rate / 200.0))  # some 200 Hz are enough, and 100,000 samples
    count = min(len(position) // stride, 100_000)
    torque = torque / max(np.abs(torque).max(), np.finfo(float).tiny)  # only its shape matters
    q, tau = (x[: count * stride].reshape(count, stride).mean(axis=1) for x in (position, torque))
    step = stride / rate
    window = min(max(5, round(SMOOTHING / step)), count) | 1  # odd
    v, a = (savgol_filter(q, window, 3, deriv=order, delta=step) for order in (1, 2))
    q, tau = savgol_filter(q, window, 3), savgol_filter(tau, window, 3)
    plain = np.column_stack([tau, v, np.sign(v), np.ones_like(v)])  # (N, 4)

    def misfit(*gravity: Array) -> float:
        phi = np.column_stack([plain, *gravity])
        phi /= np.abs(phi).max(axis=0) + np.finfo(float).tiny
        return float(np.linalg.norm(a - phi @ np.linalg.lstsq(phi, a, rcond=None)[0]))

    none, radians, degrees = misfit(), misfit(np.sin(q), np.cos(q)), misfit(np.sin(DEGREE * q), np.cos(DEGREE * q))
    # Of 60 real and simulated runs, all have ratios below 0.89 and above 0.98 here if in degrees; if in radians, those
    # that cover more than 2 pi have ratios above 1.7 and below 0.4.
    if degrees < 0.95 * radians and radians > 0.9 * none and none > 1e-3 * np.sqrt(len(a)):  # [rad/s^2], not mere noise
        raise RecordingError(
            f"position runs from {position.min():.4g} to {position.max():.4g} and gravity acts on it as on degrees: "
            "convert it to radians, or name the column position_deg (position_rad if it is radians after all)"
        )


def refuse_foreign_velocity(rate: float, position: Array, velocity: Array) -> None:
    """Refuse a velocity column that is not the slope of position: other units, other sign, another signal."""
    span = max(1, round(WINDOW * rate))
    count = (len(position) - 1) // span
    moved = np.diff(position[: count * span + 1 : span])  # (count,) [rad]
    mean = (velocity[:-1] + velocity[1:]) / 2
    expected = mean[: count * span].reshape(count, span).sum(axis=1) / rate  # (count,) [rad]
    remedy = "mend or remove that column, which is optional"
    with np.errstate(over="ignore", invalid="ignore"):  # absurd values are no correlation
        size = float(np.linalg.norm(moved) * np.linalg.norm(expected))
        correlation = float(moved @ expected / size) if 0 < size < np.inf else 0.0
    if abs(correlation) < 0.5:
        if np.ptp(position) > 0.2:  # [rad]; below, encoder steps may drown the motion
            raise RecordingError(
                f"velocity does not follow the slope of position ({correlation:.2f} correlated): {remedy}"
            )
        return
    ratio = float(correlation * np.linalg.norm(moved) / np.linalg.norm(expected))
    if correlation < 0:
        raise RecordingError(f"velocity has the opposite sign of the slope of position: {remedy}")
    if 40 < ratio < 80:
        raise RecordingError(
            f"position changes {ratio:.3g} times as fast as velocity says, as if in degrees: "
            "convert it to radians, or name the column position_deg"
        )
    if 40 < 1 / ratio < 80:
        raise RecordingError(
            f"velocity is {1 / ratio:.3g} times the slope of position, as if in degrees per second: "
            "convert it to rad/s, or name the column velocity_deg/s"
        )
    if not 0.5 < ratio < 2:
        raise RecordingError(f"velocity is {1 / ratio:.3g} times the slope of position: {remedy}")
