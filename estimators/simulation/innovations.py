"""Errors of segments as innovations of a Kalman filter with known noise.

The motion integrates the noise of the recorded torque. Simulation errors therefore grow along a segment and are
correlated between samples, and late samples dominate an unweighted fit. A Kalman filter of position and velocity
errors, linearised along the measured motion, converts them into innovations. These are white with equal variance, so
least squares on them is efficient.

Source: Ljung, System Identification, 2nd edition, sections 7.2 and 7.4; for the velocity error across a reversal,
Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004, section 7.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.signals.differentiation import estimate_encoder_noise
from estimators.simulation.free_running import Segments
from estimators.weak_form.traces import trace_all
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.simulation import TorqueBalance

INTEGRATION_ERROR = 3e-6  # [rad], of a simulated position
PERTURBATION = np.array([1e-4, 1e-3])  # of position [rad] and velocity [rad/s], for derivatives of the acceleration
REVERSAL_FACTOR = 1e4  # of the process noise if the joint reverses or sticks, at an unknown time within the interval
MAX_ERROR_CHANGE = 0.3  # largest relative change of the velocity error within an interval


@dataclass(frozen=True)
class Innovations:
    """Filter of the errors of B segments at N instants.

    Attributes:
        transition: transition matrix of position and velocity errors from the previous instant (N, B, 2, 2).
        gain: gain of the filter (N, B, 2).
        spread: standard deviation of the innovation at each instant (N, B) [rad].
    """

    transition: Array
    gain: Array
    spread: Array

    @classmethod
    def from_segments(cls, segments: Segments, terms: Sequence[Term], theta: Array, grain: int) -> Innovations:
        """Make the filter of the error at every `grain`-th sample, for terms with linear parameters theta (P,).

        Process noise is that of the recorded torque. The initial state has no error, because it is fitted.
        """
        recording = segments.windows.recording
        index = segments.first + grain * np.arange((len(segments.position) - 1) // grain + 1)[:, None]  # (N + 1, B)
        interval = grain / recording.rate
        transition, inertia, reverses = _linearise_motion(segments, index, terms, theta, interval)
        # torque noise is independent between periods: its mean over the interval acts on the velocity
        velocity_variance = (segments.windows.noise.raw_torque * interval / inertia[1:]) ** 2 / grain
        velocity_variance *= np.where(reverses, REVERSAL_FACTOR, 1.0)
        position_ratio = interval**2 * (1 / 3 - 1 / (12 * grain**2))  # held over each period, not white in between
        process = velocity_variance[:, :, None, None] * np.array([[position_ratio, interval / 2], [interval / 2, 1.0]])
        position_variance = max(estimate_encoder_noise(recording), INTEGRATION_ERROR) ** 2
        gain, spread = np.empty(transition.shape[:3]), np.empty(transition.shape[:2])
        covariance = np.zeros((index.shape[1], 2, 2))  # the initial state is fitted
        for k, step in enumerate(transition):
            covariance = step @ covariance @ np.swapaxes(step, 1, 2) + process[k]
            variance = covariance[:, 0, 0] + position_variance
            gain[k], spread[k] = covariance[:, :, 0] / variance[:, None], np.sqrt(variance)
            covariance = covariance - gain[k][:, :, None] * covariance[:, :1, :]
        return cls(transition, gain, spread)

    def whiten(self, errors: Array) -> Array:
        """Return the innovations of V errors of each segment (B, N, V) [rad], in standard deviations."""
        expected = np.zeros((len(errors), 2, errors.shape[2]))
        innovations = np.empty_like(errors)
        for k, step in enumerate(self.transition):
            expected = step @ expected
            innovation = errors[:, k] - expected[:, 0]
            innovations[:, k] = innovation / self.spread[k][:, None]
            expected = expected + self.gain[k][:, :, None] * innovation[:, None]
        return innovations


def _linearise_motion(
    segments: Segments, index: Index, terms: Sequence[Term], theta: Array, interval: float
) -> tuple[Array, Array, Mask]:
    """Linearise the errors of position and velocity along the measured motion at instants `index` (N + 1, B).

    Returns:
        Transition over each interval (N, B, 2, 2), inertia (N + 1, B), and whether the joint reverses in this or the
        previous interval (N, B).
    """
    balance, measured = TorqueBalance(terms, theta, bool(segments.windows.samples.load)), segments.windows.samples
    memory = {
        id: tuple(np.asarray(series)[index] for series in states)
        for term in terms
        for id, states in trace_all([segments.windows], [term])[0][0].memory.items()
    }
    time, position, velocity, torque = (
        np.asarray(values)[index] for values in (measured.time, measured.position, measured.velocity, measured.torque)
    )
    x = Samples(time, position, velocity, torque, memory, measured.load.select(index))
    direction = np.sign(velocity)

    def broadcast(values: object) -> Array:
        return np.broadcast_to(np.asarray(values, dtype=float), index.shape)

    def compute_acceleration(x: Samples) -> Array:
        return (balance.net(x) - balance.dry(x) * direction) / balance.mass(x)

    def compute_slope(name: str, perturbation: float) -> Array:
        value = getattr(x, name)
        displaced = (replace(x, **{name: value + change}) for change in (perturbation, -perturbation))
        raised, down = map(compute_acceleration, displaced)
        values = broadcast((raised - down) / (2 * perturbation))
        return 0.5 * (values[1:] + values[:-1])

    rates = np.zeros((len(index) - 1, index.shape[1], 2, 2))
    rates[:, :, 0, 1] = 1.0
    limit = MAX_ERROR_CHANGE / interval**2
    rates[:, :, 1, 0] = np.clip(compute_slope("position", PERTURBATION[0]), -limit, limit)
    rates[:, :, 1, 1] = np.clip(compute_slope("velocity", PERTURBATION[1]), -1 / interval, MAX_ERROR_CHANGE / interval)
    step = rates * interval
    transition = np.eye(2) + step + 0.5 * step @ step
    # Friction reverses with the joint: a late reversal leaves with less acceleration than it entered with.
    net, dry = np.abs(broadcast(balance.net(x))), np.maximum(broadcast(balance.dry(x)), 0.0)
    passed_share = np.clip((net - dry) / (net + dry + 1e-12), 0.0, 1.0)
    reverses = direction[1:] != direction[:-1]
    transition[:, :, 1] *= np.where(reverses, passed_share[1:], 1.0)[:, :, None]
    reverses[1:] |= reverses[:-1]
    return transition, broadcast(balance.mass(x)), reverses
