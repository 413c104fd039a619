"""White noise of the log in windows: of torque, acceleration and velocity, and errors by jumps of the torque."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from estimators.signals.differentiation import (
    Motion,
    correlate_averages,
    estimate_log_noise,
    estimate_white_noise,
)
from estimators.weak_form.resolution import RESOLUTION
from pendulum_env._typing import Array
from pendulum_env.physics import KnownLoad
from pendulum_env.recording import Recording


@dataclass(frozen=True, eq=False)
class WindowNoise:
    """White noise of the log in a window of 2 m + 1 samples.

    Attributes:
        torque: standard deviation of the torque, with that of the known load [N m].
        acceleration: standard deviation of the acceleration [rad/s^2].
        acceleration_shared: correlation of the acceleration noise of windows half a window apart.
        velocity: standard deviation of the smoothed velocity [rad/s].
        common: covariances of torque noise and acceleration noise, of one window and of windows half a window apart
            [N m rad/s^2].
        load_inertia: largest inertia of the known load [kg m^2].
        kernel: weights of a window (2 m + 1,).
        log_weights: weights of the samples of the log in a window's torque.
        rate: samples per second [Hz].
        excess: variance of the acceleration about each sample beyond that of the recording, over the latter (N,), by
            a position of significant digits; None if its step is constant.
    """

    torque: float
    acceleration: float
    acceleration_shared: float
    velocity: float
    common: tuple[float, float]
    load_inertia: float
    kernel: Array
    log_weights: Array
    rate: float
    excess: Array | None = None

    @classmethod
    def measure(cls, recording: Recording, load: KnownLoad, kernel: Array, motion: Motion) -> WindowNoise:
        """Measure the noise in the windows of a recording with a known load, and with its differentiated motion."""
        log_weights = _average_log(recording, kernel)
        return cls(
            torque=_compute_torque_noise(recording, load, kernel, log_weights),
            acceleration=motion.acceleration_noise,
            acceleration_shared=correlate_averages(motion.noise_weights, len(kernel) // 2),
            velocity=motion.velocity_noise,
            common=_compute_common_noise(recording, kernel, motion),
            load_inertia=float(np.max(load.inertia)),
            kernel=kernel,
            log_weights=log_weights,
            rate=recording.rate,
            excess=_compute_excess(recording, motion),
        )

    @property
    def raw_torque(self) -> float:
        """Standard deviation of the white noise of the torque channel [N m]."""
        return self.torque / float(np.linalg.norm(self.log_weights))

    @property
    def torque_rate(self) -> float:
        """Standard deviation of the time derivative of the torque in a window by noise of its channel [N m/s]."""
        padded = np.pad(self.kernel, 2)
        weights = np.convolve(0.5 * self.rate * (padded[:-2] - padded[2:]), [0.5, 0.5])
        return self.raw_torque * float(np.linalg.norm(weights))

    def with_torque(self, std: float) -> WindowNoise:
        """Return the noise with another standard deviation of the torque [N m]."""
        return replace(self, torque=std)

    def divide_power(self, inertia: float, power: float, shared: float) -> WindowNoise:
        """Return the noise with the power of a residual [(N m)^2], divided between torque and encoder.

        `shared` is the covariance of the residual in windows half a window apart [(N m)^2]. Neither noise is raised.
        """
        load = inertia + self.load_inertia
        of_torque, of_encoder = self.torque**2, (load * self.acceleration) ** 2
        both, both_shared = (
            2 * load * common / max(of_encoder, 1e-300) for common in self.common
        )  # a controller's answer
        difference = self.acceleration_shared - both_shared - self.torque_shared * (1.0 - both)
        encoder = (shared - self.torque_shared * power) / difference
        encoder = min(max(encoder, power - of_torque, 0.0), of_encoder)
        torque = min(max(power - (1.0 - both) * encoder, 0.0), of_torque)
        torque_factor, encoder_share = math.sqrt(torque / max(of_torque, 1e-300)), encoder / max(of_encoder, 1e-300)
        return replace(
            self,
            torque=torque_factor * self.torque,
            acceleration=math.sqrt(encoder_share) * self.acceleration,
            common=(encoder_share * self.common[0], encoder_share * self.common[1]),
        )

    def scale_rows(self, inertia: float) -> Array | None:
        """Return the factor on the equation about each sample (N,): its noise over that with `excess`; None for one."""
        if self.excess is None:
            return None
        of_excess = self.excess * ((inertia + self.load_inertia) * self.acceleration) ** 2
        return np.asarray(1.0 / np.sqrt(1.0 + of_excess / max(self.compute_std(inertia) ** 2, 1e-300)))

    def scale(self, factor: float) -> WindowNoise:
        """Return the noise times a factor."""
        common = (factor**2 * self.common[0], factor**2 * self.common[1])
        return replace(self, torque=factor * self.torque, acceleration=factor * self.acceleration, common=common)

    @property
    def torque_shared(self) -> float:
        """Correlation of the torque noise of windows half a window apart."""
        return correlate_averages(self.log_weights, len(self.kernel) // 2)

    def compute_std(self, inertia: float) -> float:
        """Return the standard deviation of a window's residual by noise [N m]; known loads add inertia."""
        load = inertia + self.load_inertia
        separate = self.torque**2 + (load * self.acceleration) ** 2
        return math.sqrt(max(separate - 2 * load * self.common[0], 0.0))

    def compute_rate_std(self, inertia: float) -> float:
        """Return the standard deviation by noise of the rate of an inertia's torque in a window [N m/s]."""
        padded = np.pad(self.kernel, 3)
        bend, slope = (float(np.linalg.norm(np.diff(padded, order))) for order in (2, 3))
        return (inertia + self.load_inertia) * self.acceleration * self.rate * slope / bend

    def compute_shared_covariance(self, inertia: float) -> float:
        """Return the covariance by noise of the residuals of windows half a window apart [(N m)^2]."""
        of_torque = self.torque**2 * self.torque_shared
        load = inertia + self.load_inertia
        of_motion = (load * self.acceleration) ** 2 * self.acceleration_shared
        return of_torque + of_motion - 2 * load * self.common[1]


def _compute_excess(recording: Recording, motion: Motion) -> Array | None:
    """Return the relative excess of the acceleration's variance about each sample; see `WindowNoise`."""
    if (steps := recording.position_steps) is None:
        return None
    of_rounding, weights = steps**2 / 12, motion.noise_weights**2
    of_sensor = max(motion.acceleration_noise**2 / weights.sum() - float(np.median(of_rounding)), 0.0)
    relative = np.convolve(of_sensor + of_rounding, weights, "same") / max(motion.acceleration_noise**2, 1e-300)
    return np.maximum(relative - 1.0, 0.0)


def _average_log(recording: Recording, window: Array) -> Array:
    """Return the weights of the noise of samples in a window's average, with the response of a torque moved in time."""
    average, moved = np.convolve(window, [0.5, 0.5]), recording.moved
    return average if moved is None else np.convolve(average, moved.response)


def _compute_torque_noise(recording: Recording, load: KnownLoad, window: Array, log_weights: Array) -> float:
    """Return the standard deviation of a window's torque by white noise of the log and of the known load [N m]."""
    moved = recording.moved
    noise = estimate_log_noise(recording.torque, recording.position) if moved is None else moved.noise
    of_load = estimate_white_noise(load.get_torque(recording.time)) * np.linalg.norm(np.convolve(window, [0.5, 0.5]))
    return math.hypot(noise * np.linalg.norm(log_weights), of_load)


def _compute_common_noise(recording: Recording, window: Array, motion: Motion) -> tuple[float, float]:
    """Return the covariances of torque and acceleration by noise of the encoder, see `WindowNoise.common`.

    A controller reacts to this noise without delay. A torque that was moved in time includes the reaction to its row;
    the acting torque between the rows does not.
    """
    if recording.moved is None or recording.moved.answer == 0.0:
        return 0.0, 0.0
    half, response = len(window) // 2, recording.moved.response
    of_torque = np.convolve(np.convolve(window, [0.5, 0.5]), response[::-1])  # of samples in the order of time
    of_motion = np.pad(motion.noise_weights, (len(response) // 2, len(response) // 2 - 1))
    variance = (motion.acceleration_noise / float(np.linalg.norm(motion.noise_weights))) ** 2
    shifted = of_torque[half:] @ of_motion[:-half] + of_torque[:-half] @ of_motion[half:]
    slope = recording.moved.answer * variance
    return slope * float(of_torque @ of_motion), 0.5 * slope * float(shifted)


def scale_by_jumps(recording: Recording, window: Array, torque_noise: float) -> Array | None:
    """Return the factor on the equation about each sample (N,): its noise over that with jumps; None if all are one."""
    errors = compute_jump_errors(recording)
    if torque_noise == 0 or not errors.any():
        return None
    variance = np.convolve(errors**2, window**2, "same")
    return np.asarray(1.0 / np.sqrt(1.0 + variance / torque_noise**2))


def compute_jump_errors(recording: Recording) -> Array:
    """Return the standard error of each sample of the torque by a jump at an unknown time (N,) [N m].

    The time of a jump of sampled torque is uniform between two samples, which gives the error jump / sqrt(12). A jump
    is the difference of a change from the median of its neighbours, if it exceeds noise.
    """
    if recording.moved is None or not recording.moved.is_sampled:
        return np.zeros(len(recording))
    changes = np.diff(recording.torque, prepend=recording.torque[0])
    changes[list(recording.starts)] = 0.0
    count = RESOLUTION.cut.neighbours
    jumps = changes - np.median(sliding_window_view(np.pad(changes, count // 2), count), axis=1)
    jumps[np.abs(jumps) < RESOLUTION.cut.jump * np.sqrt(2) * recording.moved.noise] = 0.0
    return np.asarray(np.abs(jumps) / np.sqrt(12))
