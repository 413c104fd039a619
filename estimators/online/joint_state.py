"""A seventh estimator, beyond the paper: position, velocity and parameters in one state, by an unscented Kalman filter.

The position is the only measurement. It is not differentiated, so there is no delay of smoothing, and the model's
simulation includes stick and reversals, so there is no guard around stick. Each sigma point is a pendulum of its own,
with its position, velocity and parameters, simulated under the held torque.

The encoder noise is known. The noise of the acting torque is learnt from the innovations of the filter, which should
have the predicted variance and no correlation between samples.

The filter starts from a regression, whose estimates it repeats until the inertia is known to a tenth. From then on it
uses only later samples, so that none counts twice.

Source: Julier and Uhlmann, Proceedings of the IEEE 92(3), 2004; the weights are those of Arasaratnam and Haykin,
Cubature Kalman Filters, IEEE Transactions on Automatic Control 54(6), 2009; for the noise, Mehra, On the Identification
of Variances and Adaptive Kalman Filtering, IEEE Transactions on Automatic Control 15(2), 1970.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from estimators.online.confidence import Wandering, wandered
from estimators.online.estimates import Estimates
from estimators.signals.motion import SLOWEST
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.simulation import Balance, Prepared, prepared, simulate
from pendulum_env.physics.term import Memory, zero


@dataclass(frozen=True)
class JointStateSettings:
    """Numbers of the joint-state filter; chosen on simulated plants by `benchmarks.joint_state`."""

    known: float = 0.1  # of the inertia, the standard error at which the filter takes over
    motion: float = 1.0  # [s], that the regression has to have seen until then
    doubt: float = 0.1  # of each parameter, that is added to its standard error then
    speed: float = 5.0  # [rad/s], standard deviation of the velocity before it is known
    shaken: float = 0.1  # [N m], standard deviation of the torque that acts about the measured one, before it is known
    learn: float = 0.5  # [s], in which its logarithm follows
    outlier: float = 3.0  # standard deviations, limit of an innovation in learning the noise
    finest: float = 1e-7  # [rad], below which position is not said to be known: the step itself errs


FILTER = JointStateSettings()


@dataclass(frozen=True)
class JointState:
    """Position, velocity and parameters in one state, by filterpy's unscented Kalman filter; the error is in radians.

    Runs online only, beside any of the six.

    Attributes:
        torque_noise: standard deviation of the torque that acts about the measured one, white [N m]; None learns it.
    """

    torque_noise: float | None = None
    id: ClassVar[str] = "joint_state_ukf"
    unit: ClassVar[str] = "rad"

    def __post_init__(self) -> None:
        if self.torque_noise is not None and not 0 < self.torque_noise < np.inf:
            raise ValueError(f"torque_noise cannot be {self.torque_noise}: give a positive number, or None to learn it")


class JointFilters:
    """One filter for each of B pendulums; those that have not started yet are None.

    Each starts from a regression, the last of those beside it, and repeats its estimates until then.

    Attributes:
        position_noise: standard deviation of positions [rad], of filters that start from now on.
    """

    def __init__(
        self,
        torque_noise: float | None,
        terms: Sequence[Term],
        period: float,
        batch: int,
        position_noise: float,
        forgetting: float,
        walk: Array,
    ) -> None:
        """Take the time between samples [s], the noise of positions [rad], and the rest as `OnlineEstimator` does."""
        self._begin = functools.partial(_Filter, torque_noise, tuple(terms), period, forgetting, walk)
        self._period, self.position_noise = period, position_noise
        columns = [column for term in terms for column in term.columns]
        self._inertia = next((k for k, column in enumerate(columns) if column.mass is not zero), None)
        self.filters: list[_Filter | None] = [None] * batch
        self.error = np.zeros((batch, 1))  # what was new in the last sample [rad]
        self._surprise = Wandering((batch, 1), period)

    def reset(self, which: Mask) -> None:
        """Those of the B start anew, from a regression."""
        self.filters = [None if anew else one for one, anew in zip(self.filters, which, strict=True)]
        self._surprise.reset(which)

    @property
    def running(self) -> Mask:
        """Which have started (B,)."""
        return np.array([one is not None for one in self.filters])

    def take(self, time: Array, position: Array, torque: Array, anew: Mask, lent: Estimates) -> None:
        """Take in a sample of every pendulum, and start where the last regression knows enough.

        Those that begin anew (B,), as after a gap, keep their parameters, but not position and velocity.
        """
        self.error, new = np.zeros((2, len(self.filters), 1))
        for b, one in enumerate(self.filters):
            if one is None:
                if lent.usable[b, -1]:
                    self.filters[b] = self._started(lent, b)
                continue
            one.lost = one.lost or bool(anew[b])
            if not np.isfinite(position[b] + torque[b]):
                continue
            try:
                self.error[b, 0], new[b, 0] = one.take(time[b], position[b], torque[b])
            except np.linalg.LinAlgError:  # no longer positive definite: another start
                self.filters[b] = None
        if self._surprise.take(new, new, self.running[:, None]):
            self._surprise.close()

    def _started(self, lent: Estimates, b: int) -> _Filter | None:
        theta, covariance = lent.theta[b, -1], lent.covariance[b, -1]
        if self._inertia is None or lent.index[b] * self._period < FILTER.motion:
            return None
        if not 0 < np.sqrt(covariance[self._inertia, self._inertia]) < FILTER.known * theta[self._inertia]:
            return None
        noise = max(self.position_noise, FILTER.finest)
        return self._begin(noise, theta, covariance + np.diag((FILTER.doubt * theta) ** 2))

    def beside(self, now: Estimates) -> Estimates:
        """Estimates with this one in the place of the last regression, whose own it repeats until it runs."""
        theta, P, covariance = now.theta.copy(), now.P.copy(), now.covariance.copy()
        error, usable, noise = now.error.copy(), now.usable.copy(), np.maximum(self._surprise.noise, 1.0)
        error[:, -1:], usable[:, -1] = self.error, self.running
        for b, one in enumerate(self.filters):
            if one is not None:
                theta[b, -1], P[b, -1], covariance[b, -1] = one.theta, one.P, noise[b] * one.P
        spread, judge = functools.partial(np.asarray, P), functools.partial(_get_covariance, covariance)
        return replace(now, theta=theta, error=error, usable=usable, spread=spread, judge=judge)


def _get_covariance(covariance: Array, P: Array) -> Array:
    """Return a covariance that needs no P."""
    return covariance


class _Filter:
    """The filter of one pendulum: state [q, q', theta]."""

    def __init__(
        self,
        torque_noise: float | None,
        terms: Sequence[Term],
        period: float,
        forgetting: float,
        walk: Array,
        position_noise: float,
        theta: Array,
        P: Array,
    ) -> None:
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter  # loads scipy.stats, which takes long

        self._terms, self._period, self._walk = terms, period, walk
        self._learns = torque_noise is None
        self.log_variance = 2 * np.log(FILTER.shaken if torque_noise is None else torque_noise)
        known = 2 + int(sum(term.delay for term in terms) / period)  # commands that may act within a period
        self._commands = deque(known * [0.0], maxlen=known)
        self._memory: Mapping[str, Memory] | None = None
        self._program: Prepared | None = None
        size = 2 + len(theta)
        points = MerweScaledSigmaPoints(size, alpha=1.0, beta=0.0, kappa=0.0)  # equal weights, none for the mean
        self._ukf = UnscentedKalmanFilter(size, 1, period, _measure, self._forward, points)
        self._ukf.x, self._ukf.P = np.r_[0.0, 0.0, theta], np.zeros((size, size))
        self._ukf.P[2:, 2:] = P
        self._ukf.R[:] = position_noise**2
        self._fade = np.r_[1.0, 1.0, np.full(len(theta), forgetting**-0.5)]
        self._last = 0.0  # of what was new, as far as it is remembered, of unit variance
        self.lost = True

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_program": None}  # a compiled program cannot be pickled

    @property
    def theta(self) -> Array:
        return self._ukf.x[2:]

    @property
    def P(self) -> Array:
        return self._ukf.P[2:, 2:]

    def take(self, time: float, position: float, torque: float) -> tuple[float, float]:
        """Take in a sample; returns what was new in it [rad], and as a share of its standard deviation."""
        ukf = self._ukf
        self._commands.append(torque)
        if self.lost:
            ukf.x[:2], ukf.P[:2], ukf.P[:, :2] = (position, 0.0), 0.0, 0.0
            ukf.P[0, 0], ukf.P[1, 1] = ukf.R[0, 0], FILTER.speed**2
            self.lost, self._memory = False, None
            return 0.0, 0.0
        fade = self._fade if abs(ukf.x[1]) > SLOWEST else np.ones_like(self._fade)  # at rest, nothing is forgotten
        ukf.P *= np.outer(fade, fade)
        self._predict(time - self._period)
        ukf.update(position)
        gain, new = float(ukf.K[0, 0]), float(ukf.y[0] / np.sqrt(ukf.S[0, 0]))
        if self._learns:
            bounded = min(max(new, -FILTER.outlier), FILTER.outlier)
            # the more the torque's noise moves the joint against the encoder's, the more a surprise tells of it
            told = gain * (bounded**2 - 1.0 + 2.0 * bounded * self._last)
            self.log_variance += self._period / FILTER.learn * told
            kept = 1.0 - gain
            self._last = kept * self._last + np.sqrt(max(1.0 - kept**2, 0.0)) * bounded
        return float(ukf.y[0]), new

    def _predict(self, time: float) -> None:
        """Predict the state one period after `time`; state variables of terms follow the mean."""
        ukf = self._ukf
        ukf.Q = self._process_noise()
        self._program = self._program or prepared(self._terms)
        mean, after = ukf.x, list[Samples]()
        ukf.predict(time=time)
        if any(term.remembers for term in self._terms):
            self._forward(mean, self._period, time, after.append)
            self._memory = after[-1].memory

    def _process_noise(self) -> Array:
        """Covariance that a period adds: white torque noise, and parameters that wander."""
        ukf, period = self._ukf, self._period
        x = Samples(np.zeros(1), ukf.x[:1], ukf.x[1:2], np.zeros(1))
        balance = Balance(self._terms, ukf.x[2:])
        inertia = float(np.ravel(balance.mass(replace(x, memory=self._memory or balance.start(x))))[0])
        speed = np.exp(self.log_variance) * (period / inertia) ** 2
        added = np.zeros_like(ukf.P)
        added[:2, :2] = speed * np.array([[period**2 / 3, period / 2], [period / 2, 1.0]])
        added[2:, 2:] = np.diag(wandered(self._walk, ukf.x[2:]) ** 2 * period)
        return added

    def _forward(
        self, state: Array, period: float, time: float, observe: Callable[[Samples], None] | None = None
    ) -> Array:
        """Simulate one sigma point over a period that begins at `time`."""
        commands = np.array(self._commands)
        motion = simulate(
            self._terms,
            state[2:],
            period,
            commands[-1:],
            state[0],
            state[1],
            time,
            before=commands[:-1],
            memory=self._memory,
            observe=observe,
            program=self._program,
        )
        return np.r_[motion.position[-1], motion.velocity[-1], state[2:]]


def _measure(state: Array) -> Array:
    """Return the position."""
    return state[:1]
