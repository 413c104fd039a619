"""Recursive least squares of an arm while it runs: the rows that `identify_arm` uses, as soon as they are known."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from estimators.arms.balance import VIEWS, rows
from estimators.arms.identification import ARM_SCHEMES, through
from estimators.online.clock import Clock
from estimators.regression.recursive import PRIOR, State, start, step
from estimators.schemes.six import GUARD, Scheme
from estimators.signals.measurements import Smoothing, measure
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links, friction
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Term

CHUNK = 0.05  # [s] of samples that are taken in together
MEMORY = 0.1  # [s] before a chunk, in which filters forget how they began: exp(-20) of it is left at 200 rad/s


class ArmEstimator:
    """The paper's recursion (6) over the rows of all joints; feed it with `update`, sample by sample.

    Estimates lag behind by the filter's reach and the guard around stick, and up to `CHUNK`.

    Attributes:
        state: theta (P,), P (P, P) for unit noise and the last a-priori error.
    """

    def __init__(
        self,
        body: Body,
        rate: float,
        terms: Sequence[Term] | None = None,
        scheme: Scheme = ARM_SCHEMES[1],
        *,
        counts: int = 0,
        prior: float = PRIOR,
    ) -> None:
        """Make the estimator.

        Args:
            body: its links.
            rate: samples per second [Hz].
            terms: at joints; viscous and Coulomb friction by default.
            scheme: that makes the rows, one that borrows nothing and does not sum from the start.
            counts: of the encoders per turn, 0 if they are exact.
            prior: P(0) on the diagonal.

        Raises:
            ValueError: if the scheme cannot work so.
        """
        if scheme.borrows is not None or scheme.drifts:
            raise ValueError(
                f"{scheme.id} cannot run on an arm as it is set: let it borrow nothing, and give it a window"
            )
        self.body, self.scheme = body, scheme
        self.terms = (Links(body), *(friction(body) if terms is None else terms))
        self._smoothing = Smoothing.of_encoder(counts, rate)
        self._rate, self._prior = rate, prior
        self._chunk = round(CHUNK * rate)
        # after a sample, what decides whether it is clear; before it, what its row depends on
        self._after = self._smoothing.reach + max(self._smoothing.reach + 1, round(GUARD * rate)) + 2
        self._kept = self._chunk + 2 * self._after + round(MEMORY * rate)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.state: State = start(sum(len(term.columns) for term in self.terms), self._prior)
        self._clock = Clock(self._rate)
        self.forget_motion()

    def forget_motion(self) -> None:
        """Begin another recording, with what was estimated so far."""
        self._clock.restart()
        self._samples: deque[tuple[float, Array, Array]] = deque(maxlen=self._kept)
        self._waiting = 0  # samples whose rows have not been used
        self._begun = False

    @property
    def model(self) -> ArmModel:
        """Body and terms with the present estimates, their standard errors for unit noise."""
        return ArmModel.build(self.terms, self.state.theta, np.sqrt(np.diag(self.state.P)))

    def update(self, time: float, position: Array, torque: Array) -> State:
        """Take in a sample: time [s], positions (n,) [rad] and the torques (n,) [N m] held from it on.

        One that is not all numbers is left out. After it, and after a gap in time, another recording begins.

        Raises:
            ValueError: if there is not one position and one torque a joint, if time does not go on, or if samples do
                not come at the rate.
        """
        position, torque = np.array(position, dtype=float), np.array(torque, dtype=float)
        if position.shape != (count := len(self.body.joints),) or torque.shape != (count,):
            raise ValueError(
                f"a sample of {count} joints has as many positions and torques, not those of shapes {position.shape} "
                f"and {torque.shape}"
            )
        if not np.isfinite([time, *position, *torque]).all():
            self.forget_motion()
            return self.state
        if self._clock.tick(time):
            self.forget_motion()
            self._clock.tick(time)
        self._samples.append((time, position, torque))
        self._waiting += 1
        if len(self._samples) >= self._kept and self._waiting >= self._chunk:
            self._take()
        return self.state

    def _take(self) -> None:
        times, positions, torques = (np.array(values) for values in zip(*self._samples, strict=True))
        recording = ArmRecording.of("online", self.body.joints, times, positions, torques)
        m = tuple(measure(joint, self._smoothing) for joint in recording.joints)
        # of N measurements, the last `after - reach` still wait for what decides whether they are clear
        end = len(m[0]) - (self._after - self._smoothing.reach)
        first = end - self._waiting if self._begun else round(MEMORY * self._rate)
        balances = rows(m, self.terms, VIEWS[self.scheme.view])
        regressions = [through(self.scheme, own, m, k) for k, own in enumerate(balances)]
        for k in range(max(first, 0), end):
            for equations, usable in regressions:
                if usable[k]:
                    self.state = step(self.state, equations.phi[k], float(equations.y[k]))
        self._waiting, self._begun = 0, True
