"""Seventh estimator, not in the paper: position, velocity and parameters in one state of an unscented Kalman filter.

The only measurement is the position. It is not differentiated, so smoothing adds no delay. The simulation of the model
includes stick and reversals, so stick needs no guard. Each sigma point is a pendulum with its own position,
velocity and parameters, simulated under the held torque.

The encoder noise is given. The noise of the torque is estimated from the innovations of the filter: with the right
noise, they have the predicted variance and no correlation between samples.

The filter starts from a regression when the inertia is known to a tenth, and then uses only later samples. Before, the
estimates are those of the regression.

Source: Julier and Uhlmann, Proceedings of the IEEE 92(3), 2004; the weights are those of Arasaratnam and Haykin,
Cubature Kalman Filters, IEEE Transactions on Automatic Control 54(6), 2009; for the noise, Mehra, On the Identification
of Variances and Adaptive Kalman Filtering, IEEE Transactions on Automatic Control 15(2), 1970.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from estimators.online.estimates import Estimates
from estimators.online.settings import ONLINE
from estimators.signals.motion import SLOWEST
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Samples, Term, simulate
from pendulum_env.physics.simulation import StepPrograms, TorqueBalance, compile_step
from pendulum_env.physics.term import Memory, return_zero


@dataclass(frozen=True)
class JointState:
    """Scheme with position, velocity and parameters in one state of an unscented Kalman filter; errors are in radians.

    It runs online only, together with any of the six schemes.
    """

    id: ClassVar[str] = "joint_state_ukf"
    unit: ClassVar[str] = "rad"


class JointFilters:
    """Filters of B pendulums; a filter is None before its start.

    Each filter starts from the last regression, and returns the estimates of the regression before.

    Attributes:
        position_noise: standard deviation of positions [rad] for filters that start later.
    """

    def __init__(
        self, terms: Sequence[Term], period: float, batch: int, position_noise: float, forgetting: float
    ) -> None:
        """Create the filters of a batch of B pendulums; the other arguments are those of `OnlineEstimator`."""
        self._make_filter = functools.partial(_Filter, tuple(terms), period, forgetting)
        self._period, self.position_noise = period, position_noise
        columns = [column for term in terms for column in term.columns]
        self._inertia = next((k for k, column in enumerate(columns) if column.mass is not return_zero), None)
        self.filters: list[_Filter | None] = [None] * batch
        self._error = np.zeros((batch, 1))  # last innovations [rad]

    def reset(self, which: Mask) -> None:
        """Restart filters (B,) from a regression."""
        self.filters = [None if is_reset else old for old, is_reset in zip(self.filters, which, strict=True)]

    def take(self, time: Array, position: Array, torque: Array, restarted: Mask, regression: Estimates) -> None:
        """Update with a sample of every pendulum, and start filters if the last regression is accurate enough.

        Pendulums that restart (B,), as after a gap, keep their parameters, and lose position and velocity.
        """
        self._error = np.zeros((len(self.filters), 1))
        for b, joint_filter in enumerate(self.filters):
            if joint_filter is None:
                if regression.usable[b, -1]:
                    self.filters[b] = self._start_filter(regression, b)
                continue
            joint_filter.is_lost = joint_filter.is_lost or bool(restarted[b])
            if not np.isfinite(position[b] + torque[b]):
                continue
            try:
                self._error[b] = joint_filter.take(time[b], position[b], torque[b])
            except np.linalg.LinAlgError:  # no longer positive definite: another start
                self.filters[b] = None

    def _start_filter(self, regression: Estimates, b: int) -> _Filter | None:
        """Start the filter of pendulum b from the estimates of the last scheme.

        Returns:
            The filter; None while the pendulum has moved too briefly, or its inertia is too uncertain.
        """
        theta, covariance = regression.theta[b, -1], regression.covariance[b, -1]
        if self._inertia is None or regression.index[b] * self._period < ONLINE.joint_state.motion_time:
            return None
        std, inertia = np.sqrt(covariance[self._inertia, self._inertia]), theta[self._inertia]
        if not 0 < std < ONLINE.joint_state.start_std * inertia:
            return None
        noise = max(self.position_noise, ONLINE.joint_state.least_noise)
        return self._make_filter(noise, theta, covariance + np.diag((ONLINE.joint_state.start_std * theta) ** 2))

    def insert_estimates(self, estimates: Estimates) -> Estimates:
        """Return estimates with those of started filters in the place of the last regression.

        P and covariance of a filter are the same. Errors of the last scheme are innovations [rad], 0 before the start.
        """
        theta, P, covariance = estimates.theta.copy(), estimates.P.copy(), estimates.covariance.copy()
        error, usable = estimates.error.copy(), estimates.usable.copy()
        error[:, -1:], usable[:, -1] = self._error, [joint_filter is not None for joint_filter in self.filters]
        for b, joint_filter in enumerate(self.filters):
            if joint_filter is not None:
                theta[b, -1], P[b, -1], covariance[b, -1] = joint_filter.theta, joint_filter.P, joint_filter.P
        state = replace(estimates.state, theta=theta, compute_P=functools.partial(np.asarray, P))
        values = estimates.index, estimates.time, state, error, usable, estimates.regressor
        return Estimates(*values, functools.partial(np.asarray, covariance))


class _Filter:
    """Filter of one pendulum with state [q, q', theta]."""

    def __init__(
        self, terms: Sequence[Term], period: float, forgetting: float, position_noise: float, theta: Array, P: Array
    ) -> None:
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter  # loads scipy.stats, which is slow

        self._terms, self._period = terms, period
        self.log_variance = 2 * np.log(ONLINE.joint_state.torque_std)  # of the torque noise
        n_commands = 2 + int(sum(term.delay for term in terms) / period)  # commands that act within a period
        self._commands = deque(n_commands * [0.0], maxlen=n_commands)
        self._memory: Mapping[str, Memory] | None = None
        self._compiler = functools.partial(StepPrograms().find, compile_step)
        size = 2 + len(theta)
        points = MerweScaledSigmaPoints(size, alpha=1.0, beta=0.0, kappa=0.0)  # equal weights, none for the mean
        self._ukf = UnscentedKalmanFilter(size, 1, period, _measure, None, points)
        self._ukf.compute_process_sigmas = self._simulate_sigma_points  # in place of one at a time
        self._ukf.x, self._ukf.P = np.r_[0.0, 0.0, theta], np.zeros((size, size))
        self._ukf.P[2:, 2:] = P
        self._ukf.R[:] = position_noise**2
        self._fade = np.r_[1.0, 1.0, np.full(len(theta), forgetting**-0.5)]
        self._filtered_innovation = 0.0  # filtered past innovations, of unit variance
        self.is_lost = True  # position and velocity are unknown

    @property
    def theta(self) -> Array:
        return self._ukf.x[2:]

    @property
    def P(self) -> Array:
        return self._ukf.P[2:, 2:]

    def take(self, time: float, position: float, torque: float) -> float:
        """Update with a sample; return the innovation [rad].

        The first sample after a loss sets the position, and returns 0.
        """
        ukf = self._ukf
        self._commands.append(torque)
        if self.is_lost:
            ukf.x[:2], ukf.P[:2], ukf.P[:, :2] = (position, 0.0), 0.0, 0.0
            ukf.P[0, 0], ukf.P[1, 1] = ukf.R[0, 0], ONLINE.joint_state.velocity_std**2
            self.is_lost, self._memory = False, None
            return 0.0
        is_moving = abs(ukf.x[1]) > SLOWEST
        if is_moving:  # no forgetting and no update of the noise at rest
            ukf.P *= np.outer(self._fade, self._fade)
        self._predict(time - self._period)
        ukf.update(position)
        if is_moving:
            self._learn_noise(float(ukf.K[0, 0]), float(ukf.y[0] / np.sqrt(ukf.S[0, 0])))
        return float(ukf.y[0])

    def _learn_noise(self, gain: float, innovation: float) -> None:
        """Update the torque noise by an innovation, in units of its predicted standard deviation.

        `gain` is the Kalman gain of the position, between 0 and 1. It weights the innovation by the share of the torque
        noise in its variance.
        """
        bounded = min(max(innovation, -ONLINE.joint_state.outlier), ONLINE.joint_state.outlier)
        gradient = gain * (bounded**2 - 1.0 + 2.0 * bounded * self._filtered_innovation)
        self.log_variance += self._period / ONLINE.joint_state.learning_time * gradient
        decay = 1.0 - gain
        self._filtered_innovation = decay * self._filtered_innovation + np.sqrt(max(1.0 - decay**2, 0.0)) * bounded

    def _predict(self, time: float) -> None:
        """Predict the state one period after `time`."""
        self._ukf.Q = self._compute_process_noise()
        self._ukf.predict(time=time)

    def _compute_process_noise(self) -> Array:
        """Compute the process noise of one period (S, S), of position, velocity and parameters.

        White torque noise acts on position and velocity. `exp(log_variance)` is the variance of its mean over a period
        [(N m)^2]. Parameters have no process noise.
        """
        ukf, period = self._ukf, self._period
        x = Samples(np.zeros(1), ukf.x[:1], ukf.x[1:2], np.zeros(1))
        balance = TorqueBalance(self._terms, ukf.x[2:])
        inertia = float(np.ravel(balance.mass(replace(x, memory=self._memory or balance.start(x))))[0])
        velocity_variance = np.exp(self.log_variance) * (period / inertia) ** 2
        noise = np.zeros_like(ukf.P)
        noise[:2, :2] = velocity_variance * np.array([[period**2 / 3, period / 2], [period / 2, 1.0]])
        return noise

    def _simulate_sigma_points(self, period: float, _: None, time: float) -> None:
        """Simulate all sigma points over a period that begins at `time`; states of terms follow the first, the mean."""
        ukf, samples = self._ukf, list[Samples]()
        position, velocity, *theta = ukf.points_fn.sigma_points(ukf.x, ukf.P).T
        *before, command = self._commands
        options: dict[str, Any] = {"before": np.array(before), "memory": self._memory, "compiler": self._compiler}
        if any(term.has_memory for term in self._terms):
            options["observe"] = samples.append
        arguments = np.array(theta), period, np.array([command]), position, velocity, time
        motion = simulate(self._terms, *arguments, **options)
        ukf.sigmas_f = np.column_stack([motion.position[-1], motion.velocity[-1], *theta])
        for x in samples[-1:]:
            self._memory = {id: tuple(state[:1] for state in states) for id, states in x.memory.items()}


def _measure(state: Array) -> Array:
    """Return the measured part of a state, which is the position (1,)."""
    return state[:1]
