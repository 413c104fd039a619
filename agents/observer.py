"""What an agent sees of pendulums, and what it may do to them: samples in, observations out, shares made torques.

One definition serves the environment in which policies learn and the rig on which they act. What is learnt is
in nominal units: parameters as shares of the nominal ones, so that x = 1 is the nominal plant, and rows as the torque
that each nominal parameter takes. It is that of Bayes from a prior around the nominal plant:

    M = M0 + sum phi phi'                              information, P times P, in units of the noise
    x = (m0 + sum phi phi')^-1 (m0 1 + sum phi y)      estimates

The prior M0 of the information sets the scale of rewards and observations. That of the estimates, m0, is smaller: it
only has to hold estimates of which nothing is known yet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array, Index
from pendulum_env.interface import MAX_TORQUE, check_positive
from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake
from pendulum_env.plant import PAPER
from pendulum_env.policy import Policy, State

NOMINAL = np.array(list(PAPER.values()))  # inertia, gravity, viscous, coulomb
SLOW = 0.2  # [rad/s]; slower than this nothing is learnt: near stick information rises and real errors do not fall
PRIOR = 0.1  # of the information: (noise / spread)^2 with 0.1 N m of noise on a tick and plants within some 30 %
ESTIMATE_PRIOR = 1e-3  # prior of the estimates: (noise / spread)^2 with 0.01 N m of noise on a tick, encoder included
DECADES = 10.0  # by which log information is divided, for it to be about 1 in the end
COUNT = len(NOMINAL)
PAIRS: tuple[Index, Index] = np.triu_indices(COUNT, 1)
FEATURES = 2 * COUNT + len(PAIRS[0])
EPISODE = 10.0  # [s], the usual length of one
TICK = 0.02  # [s], over which a torque is held: decisions at 50 Hz
FAST = 10.0  # [rad/s], by which velocity is divided in the observation
BOUND = 5.0  # of the observation
INPUTS = 3 + FEATURES + 3  # of the observation; with a limit on turns it has one more
ODD = (0, 2, INPUTS)  # places of an observation that change sign in a mirror

Batch = NDArray[np.float32]


@dataclass(frozen=True)
class Constraint:
    """What the torque must keep to."""

    peak: float  # bound of |torque| [N m]
    rms: float | None = None  # bound of its root mean square over the episode [N m], enforced as a budget of energy


ARM = "arm"  # what stands for a constraint of the torque where the motion of an arm is chosen
CONSTRAINTS = {
    "peak": Constraint(6.0),  # what the paper's two tones reach
    "rms": Constraint(MAX_TORQUE, 3.0),  # their root mean square; the drive bounds the peak
}


class Seen(NamedTuple):
    """What an observation says, in SI units but for the shares; arrays (B, ...)."""

    position: Array  # within a turn [rad]
    velocity: Array  # [rad/s]
    information: Array  # (B, P, P) in nominal units
    estimates: Array  # shares of the nominal parameters (B, P)
    time_left: Array  # share
    budget_left: Array  # share; 1 where there is none to keep
    stuck: Array  # 1 where the last tick was slower than what teaches


def read(observation: Array | Batch) -> Seen:
    """Meaning of observations (B, N)."""
    o = np.asarray(observation, dtype=float)
    own, upper, deviations = np.split(o[:, 3 : 3 + FEATURES], [COUNT, FEATURES - COUNT], axis=1)
    scale = np.sqrt(PRIOR * np.exp(DECADES * own))
    correlations = np.tile(np.eye(COUNT), (len(o), 1, 1))
    correlations[:, PAIRS[0], PAIRS[1]] = correlations[:, PAIRS[1], PAIRS[0]] = upper
    information = correlations * scale[:, :, None] * scale[:, None, :]
    time_left, budget_left, stuck = o[:, 3 + FEATURES : INPUTS].T
    position = np.arctan2(o[:, 0], o[:, 1])
    return Seen(position, FAST * o[:, 2], information, 1.0 + deviations, time_left, budget_left, stuck)


def log_det(information: Array) -> Array:
    """Logarithm of determinants (...) of (..., P, P) [nat]: what D-optimality counts (Fedorov 1972)."""
    return np.linalg.slogdet(information).logabsdet


def mirrored(observation: Any) -> tuple[Array, Array]:
    """Observations (B, N) as if the arm turned in the positive direction, and the sign (B,) their torques then need.

    Pendulum and information look the same in a mirror, so nobody has to learn both directions.
    """
    turned = np.array(observation, dtype=float)
    sign = np.where(turned[..., 2] < 0, -1.0, 1.0)
    turned[..., [place for place in ODD if place < turned.shape[-1]]] *= sign[..., None]
    return turned, sign


class Observer:
    """Sees B pendulums from their start on, tick by tick.

    Attributes:
        held: samples in a tick.
        ticks: of an episode.
        tick: that begins now.
        information: M (B, P, P).
    """

    def __init__(
        self,
        constraint: Constraint,
        seconds: float,
        rate: float,
        max_speed: float | None = None,
        max_turns: float | None = None,
    ) -> None:
        """Take the constraint, the length of an episode [s], the samples per second [Hz], and limits if there are any.

        Raises:
            ValueError: if a limit is not positive.
            Mistake: if the episode is too short, or ticks are not a whole number of samples, two or more.
        """
        limits = {"max_speed": max_speed, "max_turns": max_turns}
        check_positive("a design", **{name: limit for name, limit in limits.items() if limit is not None})
        if not TICK <= seconds < np.inf:
            raise Mistake(f"an episode cannot last {seconds:g} s: give {TICK:g} s or more")
        self.held = round(TICK * rate)
        if self.held < 2 or abs(self.held - TICK * rate) > 1e-6:
            raise Mistake(f"torque is chosen every {TICK:g} s, so {rate:g} Hz will not do: give a multiple of 50 Hz")
        self.constraint, self.rate, self.ticks = constraint, rate, round(seconds / TICK)
        self._ramp = max(1, self.held // 4)
        from_edge = np.minimum(np.arange(self.held + 1), np.arange(self.held, -1, -1))
        window: Array = np.clip(from_edge / self._ramp, 0.0, 1.0)
        self._at_samples: Array = window / window.sum()
        self._over_samples = 0.5 * (self._at_samples[1:] + self._at_samples[:-1])
        self.inputs = INPUTS + (max_turns is not None)
        self._max_speed = np.inf if max_speed is None else max_speed
        self._max_angle = None if max_turns is None else 2 * np.pi * max_turns
        self._budget = np.inf if constraint.rms is None else constraint.rms**2 * self.ticks  # [(N m)^2 ticks]

    def start(self, position: Array, velocity: Array) -> None:
        """Begin an episode at positions [rad] and velocities [rad/s] (B,)."""
        batch = len(position)
        self.tick = 0
        self.information = np.tile(PRIOR * np.eye(COUNT), (batch, 1, 1))
        self._moment = np.full((batch, COUNT), ESTIMATE_PRIOR)  # m0 1 + sum phi y
        self._position, self._velocity = position, velocity
        self._stuck = np.ones(batch, dtype=bool)
        self._left = np.full(batch, self._budget)

    def allow(self, share: Array) -> Array:
        """Torque (B,) that constraint and limits let act for a tick, of shares of the peak (B,) [N m]."""
        torque = self.constraint.peak * np.clip(share, -1.0, 1.0)
        too_fast = (np.abs(self._velocity) >= self._max_speed) & (torque * self._velocity > 0)
        torque = np.where(too_fast | (self._outwards() * np.sign(torque) >= 1.0), 0.0, torque)
        affordable = np.sqrt(np.maximum(self._left, 0.0))
        torque = np.clip(torque, -affordable, affordable)
        self._left = self._left - torque**2
        return torque

    def take(self, positions: Array, torques: Array) -> None:
        """Take in a tick: positions [rad] and torques [N m] as measured after each sample (held, B).

        The tick gives one balance, the mean of the torque balance under a window w that rises and falls linearly:

            int w tau dt = -I int w' q' dt + mgl int w sin q dt + b int w q' dt + fc sgn q' int w dt

        Positions at the samples give the first integral exactly, without a velocity at an instant.
        """
        way, ramp = np.concatenate([self._position[None], positions]), self._ramp
        velocity = self.rate * np.diff(way, axis=0)  # mean over each sample
        fast = (np.abs(velocity) >= SLOW).all(axis=0) & (np.ptp(np.sign(velocity), axis=0) == 0)
        parts = [
            (velocity[-ramp:].mean(axis=0) - velocity[:ramp].mean(axis=0)) * self.rate / (self.held - ramp),
            self._at_samples @ np.sin(way),
            self._over_samples @ velocity,
            np.sign(velocity[-1]),
        ]
        rows = np.stack(parts, axis=1) * NOMINAL * fast[:, None]
        self.information = self.information + rows[:, :, None] * rows[:, None, :]
        self._moment = self._moment + rows * (self._over_samples @ torques)[:, None]
        self._position, self._velocity = positions[-1], velocity[-1]
        self._stuck = np.asarray((np.abs(velocity) < SLOW).all(axis=0))
        self.tick += 1

    @property
    def estimates(self) -> Array:
        """Parameters as shares of the nominal ones (B, P)."""
        learnt = self.information - (PRIOR - ESTIMATE_PRIOR) * np.eye(COUNT)
        return np.asarray(np.linalg.solve(learnt, self._moment[..., None])[..., 0], dtype=np.float64)

    def features(self) -> Array:
        """Log information of each parameter, correlations, deviation of the estimates from nominal (B, FEATURES)."""
        diagonal = np.einsum("bii->bi", self.information)
        scale = np.sqrt(diagonal)
        correlations = (self.information / scale[:, :, None] / scale[:, None, :])[:, PAIRS[0], PAIRS[1]]
        return np.concatenate([np.log(diagonal / PRIOR) / DECADES, correlations, self.estimates - 1.0], axis=1)

    def observe(self) -> Batch:
        """Observations (B, inputs)."""
        q, batch = self._position, len(self._position)
        time_left = np.full(batch, max(0.0, 1.0 - self.tick / self.ticks))
        budget_left = np.ones(batch) if np.isinf(self._budget) else self._left / self._budget
        parts = np.stack([np.sin(q), np.cos(q), self._velocity / FAST]), self.features().T
        rest = np.stack([time_left, budget_left, self._stuck])
        if self._max_angle is not None:
            rest = np.concatenate([rest, self._outwards()[None]])
        return np.clip(np.concatenate([*parts, rest]).T, -BOUND, BOUND).astype(np.float32)

    def _outwards(self) -> Array:
        """Share of the way to the limit on turns (B,), signed; 0 where there is none."""
        return np.zeros_like(self._position) if self._max_angle is None else self._position / self._max_angle


class Pilot:
    """Drives any pendulum, simulated or real, by a policy of `ExcitationDesign`; a `pendulum_env.policy.Controller`.

    It is given `info` of each step, whatever the backend, and answers with the torque of the next. It holds a torque
    for 20 ms, keeps to its constraint, and begins anew at time 0.
    """

    def __init__(
        self, policy: Policy, constraint: str = "peak", seconds: float = EPISODE, rate: float = 1000.0
    ) -> None:
        """Take a policy, the constraint it is to keep to, the length of a run [s], and the samples per second [Hz].

        Raises:
            ValueError: if the constraint is unknown, or the rate is no multiple of 50 Hz.
        """
        self.policy, self.rate = policy, rate
        self.constraint = find("constraint", constraint, CONSTRAINTS)
        self.observer = Observer(self.constraint, seconds, rate)
        self._samples: list[tuple[float, float]] | None = None

    @property
    def amplitude(self) -> float:
        """Bound of |torque| [N m]."""
        return self.constraint.peak

    def torque(self, info: Mapping[str, Any]) -> float:
        """Torque for the period that begins now [N m].

        Args:
            info: `time` [s], `position` [rad] unwrapped, `velocity` [rad/s], and `torque` [N m] over the period that
                has just ended, as measured.
        """
        if self._samples is None or info["time"] == 0:
            self.observer.start(*(np.array([info[name]], dtype=float) for name in ("position", "velocity")))
            self._state: State = None
            self._decide(first=True)
            return self._torque
        self._samples.append((info["position"], info["torque"]))
        if len(self._samples) == self.observer.held:
            positions, torques = np.array(self._samples).T[..., None]
            self.observer.take(positions, torques)
            self._decide()
        return self._torque

    def _decide(self, first: bool = False) -> None:
        share, self._state = self.policy.predict(
            self.observer.observe(), self._state, np.array([first]), deterministic=True
        )
        self._torque = float(self.observer.allow(np.asarray(share, dtype=float)[:, 0])[0])
        self._samples = []
