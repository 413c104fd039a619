"""Observations and torque limits of excitation policies.

`Observer` turns samples into observations and limits the torques of a policy. The environment for training and the
rig use the same class. Parameters are in nominal units: x = 1 is the nominal plant, and a row holds the torque of each
nominal parameter. The estimate is Bayesian, with a prior around the nominal plant:

    M = M0 + sum phi phi'                              information, P times P, in units of the noise
    x = (m0 + sum phi phi')^-1 (m0 1 + sum phi y)      estimates

The prior M0 of the information sets the scale of rewards and observations. The prior m0 of the estimates is smaller: it
only keeps the first solutions finite.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array, Index
from pendulum_env.errors import UserError
from pendulum_env.lookup import find
from pendulum_env.plant import PAPER
from pendulum_env.policy import Policy, State
from pendulum_env.spaces import MAX_TORQUE

NOMINAL = np.array(list(PAPER.values()))  # inertia, gravity, viscous, coulomb
MIN_SPEED = 0.2  # [rad/s]; slower ticks are left out: near stick, information rises and errors do not fall
INFORMATION_PRIOR = 0.1  # (noise / spread)^2 with 0.1 N m of noise per tick and a spread of the plants of 30 %
ESTIMATE_PRIOR = 1e-3  # (noise / spread)^2 with 0.01 N m of noise per tick, encoder included
LOG_SCALE = 10.0  # divisor of log information, which is then about 1 at the end of an episode
N_PARAMETERS = len(NOMINAL)
PAIRS: tuple[Index, Index] = np.triu_indices(N_PARAMETERS, 1)
N_FEATURES = 2 * N_PARAMETERS + len(PAIRS[0])
EPISODE = 10.0  # [s], default duration of an episode
TICK = 0.02  # [s], duration of one torque: decisions at 50 Hz
SPEED_SCALE = 10.0  # [rad/s], divisor of the velocity in the observation
OBSERVATION_BOUND = 5.0
OBSERVATION_SIZE = 3 + N_FEATURES + 3
MIRRORED_INDICES = (0, 2)  # elements of an observation that change sign in a mirror

Batch = NDArray[np.float32]


@dataclass(frozen=True)
class Constraint:
    """Limits of the torque.

    Attributes:
        peak: bound of |torque| [N m].
        rms: bound of its root mean square over the episode [N m], enforced as a budget of energy.
        angle: bound of |q| [rad], a turn of the cable; not enforced, excesses are counted.
        speed: bound of |q'| [rad/s], from which the rig reduces the torque; not enforced, excesses are counted.
    """

    peak: float
    rms: float | None = None
    angle: float = 2 * np.pi
    speed: float = 25.0


ARM = "arm"  # constraint of policies that choose the motion of links
CONSTRAINTS = {
    "peak": Constraint(6.0),  # peak of the paper's two tones
    "rms": Constraint(MAX_TORQUE, 3.0),  # root mean square of the two tones; the motor bounds the peak
}


class ObservedState(NamedTuple):
    """Content of an observation in SI units; arrays (B, ...)."""

    position: Array  # in (-pi, pi] [rad]
    velocity: Array  # [rad/s]
    information: Array  # (B, P, P) in nominal units
    estimates: Array  # shares of the nominal parameters (B, P)
    time_left: Array  # share of the episode
    budget_left: Array  # share of the torque budget; 1 without a budget
    is_stuck: Array  # 1 where the last tick was slower than `MIN_SPEED`


def decode_observation(observation: Array | Batch) -> ObservedState:
    """Decode observations (B, N)."""
    o = np.asarray(observation, dtype=float)
    own_information, upper, deviations = np.split(
        o[:, 3 : 3 + N_FEATURES], [N_PARAMETERS, N_FEATURES - N_PARAMETERS], axis=1
    )
    scale = np.sqrt(INFORMATION_PRIOR * np.exp(LOG_SCALE * own_information))
    correlations = np.tile(np.eye(N_PARAMETERS), (len(o), 1, 1))
    correlations[:, PAIRS[0], PAIRS[1]] = correlations[:, PAIRS[1], PAIRS[0]] = upper
    information = correlations * scale[:, :, None] * scale[:, None, :]
    time_left, budget_left, is_stuck = o[:, 3 + N_FEATURES : OBSERVATION_SIZE].T
    position = np.arctan2(o[:, 0], o[:, 1])
    motion = position, SPEED_SCALE * o[:, 2]
    return ObservedState(*motion, information, 1.0 + deviations, time_left, budget_left, is_stuck)


def compute_log_det(information: Array) -> Array:
    """Compute log determinants (...) of information matrices (..., P, P) [nat]; D-optimality (Fedorov 1972)."""
    return np.linalg.slogdet(information).logabsdet


def mirror_observation(observation: Any) -> tuple[Array, Array]:
    """Mirror observations (B, N) to positive velocity, and return the sign (B,) that restores their torques.

    By symmetry, a policy learns one direction only.
    """
    mirrored = np.array(observation, dtype=float)
    sign = np.where(mirrored[..., 2] < 0, -1.0, 1.0)
    mirrored[..., MIRRORED_INDICES] *= sign[..., None]
    return mirrored, sign


class Observer:
    """Estimator of B pendulums during an episode, updated tick by tick.

    Attributes:
        samples_per_tick: number of samples in a tick.
        ticks: number of ticks in an episode.
        tick: index of the current tick.
        information: M (B, P, P).
    """

    def __init__(self, constraint: Constraint, seconds: float, rate: float) -> None:
        """Create an observer of episodes of some duration [s] at a sampling rate [Hz].

        Raises UserError if the episode is shorter than a tick, or a tick is not a whole number of at least two samples.
        """
        if not TICK <= seconds < np.inf:
            raise UserError(f"an episode of {seconds:g} s is too short: give {TICK:g} s or more")
        self.samples_per_tick = round(TICK * rate)
        if self.samples_per_tick < 2 or abs(self.samples_per_tick - TICK * rate) > 1e-6:
            raise UserError(
                f"a torque is held for {TICK:g} s, which is no whole number of samples at {rate:g} Hz: give a multiple "
                "of 50 Hz"
            )
        self.constraint, self.rate, self.ticks = constraint, rate, round(seconds / TICK)
        self._ramp = max(1, self.samples_per_tick // 4)
        from_edge = np.minimum(np.arange(self.samples_per_tick + 1), np.arange(self.samples_per_tick, -1, -1))
        window: Array = np.clip(from_edge / self._ramp, 0.0, 1.0)
        self._weights_at_samples: Array = window / window.sum()
        self._weights_over_samples = 0.5 * (self._weights_at_samples[1:] + self._weights_at_samples[:-1])
        self._budget = np.inf if constraint.rms is None else constraint.rms**2 * self.ticks  # [(N m)^2 ticks]

    def start(self, position: Array, velocity: Array) -> None:
        """Begin an episode at positions [rad] and velocities [rad/s] (B,)."""
        batch = len(position)
        self.tick = 0
        self.information = np.tile(INFORMATION_PRIOR * np.eye(N_PARAMETERS), (batch, 1, 1))
        self._moment = np.full((batch, N_PARAMETERS), ESTIMATE_PRIOR)  # m0 1 + sum phi y
        self._position, self._velocity = position, velocity
        self._is_stuck = np.ones(batch, dtype=bool)
        self._budget_left = np.full(batch, self._budget)

    def limit_torque(self, share: Array) -> Array:
        """Convert shares of the peak (B,) into torques within the constraint (B,) [N m]; spend the budget."""
        torque = self.constraint.peak * np.clip(share, -1.0, 1.0)
        affordable = np.sqrt(np.maximum(self._budget_left, 0.0))
        torque = np.clip(torque, -affordable, affordable)
        self._budget_left = self._budget_left - torque**2
        return torque

    def add_tick(self, positions: Array, torques: Array) -> None:
        """Add a tick: positions [rad] and torques [N m] measured after each sample (samples_per_tick, B).

        The tick gives one row, the mean of the torque balance under a window w that rises and falls linearly:

            int w tau dt = -I int w' q' dt + mgl int w sin q dt + b int w q' dt + fc sgn q' int w dt

        Positions at the samples give the first integral exactly, without a velocity at an instant.
        """
        path, ramp = np.concatenate([self._position[None], positions]), self._ramp
        velocity = self.rate * np.diff(path, axis=0)  # mean over each sample
        is_fast = (np.abs(velocity) >= MIN_SPEED).all(axis=0) & (np.ptp(np.sign(velocity), axis=0) == 0)
        parts = [
            (velocity[-ramp:].mean(axis=0) - velocity[:ramp].mean(axis=0)) * self.rate / (self.samples_per_tick - ramp),
            self._weights_at_samples @ np.sin(path),
            self._weights_over_samples @ velocity,
            np.sign(velocity[-1]),
        ]
        rows = np.stack(parts, axis=1) * NOMINAL * is_fast[:, None]
        self.information = self.information + rows[:, :, None] * rows[:, None, :]
        self._moment = self._moment + rows * (self._weights_over_samples @ torques)[:, None]
        self._position, self._velocity = positions[-1], velocity[-1]
        self._is_stuck = np.asarray((np.abs(velocity) < MIN_SPEED).all(axis=0))
        self.tick += 1

    @property
    def estimates(self) -> Array:
        """Estimate the parameters as shares of the nominal ones (B, P)."""
        learnt = self.information - (INFORMATION_PRIOR - ESTIMATE_PRIOR) * np.eye(N_PARAMETERS)
        return np.asarray(np.linalg.solve(learnt, self._moment[..., None])[..., 0], dtype=np.float64)

    def compute_features(self) -> Array:
        """Return log information, correlations, and deviations of the estimates from nominal (B, N_FEATURES)."""
        diagonal = np.einsum("bii->bi", self.information)
        scale = np.sqrt(diagonal)
        correlations = (self.information / scale[:, :, None] / scale[:, None, :])[:, PAIRS[0], PAIRS[1]]
        return np.concatenate(
            [np.log(diagonal / INFORMATION_PRIOR) / LOG_SCALE, correlations, self.estimates - 1.0], axis=1
        )

    def observe(self) -> Batch:
        """Compute observations (B, OBSERVATION_SIZE)."""
        q, batch = self._position, len(self._position)
        time_left = np.full(batch, max(0.0, 1.0 - self.tick / self.ticks))
        budget_left = np.ones(batch) if np.isinf(self._budget) else self._budget_left / self._budget
        parts = np.stack([np.sin(q), np.cos(q), self._velocity / SPEED_SCALE]), self.compute_features().T
        progress = np.stack([time_left, budget_left, self._is_stuck])
        return np.clip(np.concatenate([*parts, progress]).T, -OBSERVATION_BOUND, OBSERVATION_BOUND).astype(np.float32)


class Pilot:
    """Controller that moves a simulated or real pendulum by a policy of `ExcitationDesign`.

    It implements `pendulum_env.policy.Controller`: it takes the `info` of a step of any backend and returns the torque
    of the next step. A torque is held for 20 ms and stays within the constraint. An episode begins at time 0.
    """

    def __init__(
        self, policy: Policy, constraint: str = "peak", seconds: float = EPISODE, rate: float = 1000.0
    ) -> None:
        """Create a controller of episodes of some duration [s] at a sampling rate [Hz].

        Raises ValueError if the constraint is unknown, or the rate is no multiple of 50 Hz.
        """
        self.policy, self.rate = policy, rate
        self.constraint = find("constraint", constraint, CONSTRAINTS)
        self.observer = Observer(self.constraint, seconds, rate)
        self._samples: list[tuple[float, float]] | None = None

    @property
    def amplitude(self) -> float:
        """Return the bound of |torque| [N m]."""
        return self.constraint.peak

    def torque(self, info: Mapping[str, Any]) -> float:
        """Return the torque for the next sample [N m]; the torque of `info` is measured over the last sample."""
        if self._samples is None or info["time"] == 0:
            self.observer.start(*(np.array([info[name]], dtype=float) for name in ("position", "velocity")))
            self._state: State = None
            self._decide(first=True)
            return self._torque
        self._samples.append((info["position"], info["torque"]))
        if len(self._samples) == self.observer.samples_per_tick:
            positions, torques = np.array(self._samples).T[..., None]
            self.observer.add_tick(positions, torques)
            self._decide()
        return self._torque

    def _decide(self, first: bool = False) -> None:
        share, self._state = self.policy.predict(
            self.observer.observe(), self._state, np.array([first]), deterministic=True
        )
        self._torque = float(self.observer.limit_torque(np.asarray(share, dtype=float)[:, 0])[0])
        self._samples = []
