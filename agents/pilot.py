"""A policy at work: measurements of one pendulum in, sample by sample, torque in N m out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.observer import CONSTRAINTS, EPISODE, Constraint, Observer
from pendulum_env.lookup import find
from pendulum_env.policy import Policy, State


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
        self.constraint: Constraint = find("constraint", constraint, CONSTRAINTS)
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
