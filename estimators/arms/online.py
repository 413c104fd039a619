"""An arm while it runs: the rows that `identify` uses, as soon as they are known, and what takes them in."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from estimators.online.binning import BIN, MARGIN, Bin, BinSource
from estimators.online.clock import Clock
from estimators.regression.recursive import PRIOR, State, start, step
from estimators.schemes.balance import ARM_SCHEMES, Joints, rows, through
from estimators.schemes.six import GUARD, Regression, Scheme, scheme
from estimators.signals.measurements import Smoothing, measure
from pendulum_env._typing import Array, Mask
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links, friction
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Term

CHUNK = 0.05  # [s] of samples that are taken in together
MEMORY = 0.1  # [s] before a chunk, in which filters forget how they began: exp(-20) of it is left at 200 rad/s


class Known(NamedTuple):
    """Equations that have become known: those of samples `first` to `end` of some measurements, of each joint."""

    joints: Joints
    regressions: Sequence[Regression]
    first: int
    end: int


class ArmStream:
    """Samples of an arm in, the equations of a scheme out: they lag by what the filter and the guard around stick need.

    Attributes:
        every: samples that are taken in together.
        joints: names of the joints.
    """

    def __init__(self, terms: Sequence[Term], scheme: Scheme, smoothing: Smoothing, rate: float, every: int) -> None:
        """Take the terms, the links first, the scheme, the smoothing, and the samples per second [Hz]."""
        self._terms, self._scheme, self._smoothing, self.every = tuple(terms), scheme, smoothing, every
        assert isinstance(terms[0], Links)
        self.joints = terms[0].body.joints
        self._clock = Clock(rate)
        # after a sample, what decides whether it is clear; before it, what its row depends on
        self._after = smoothing.reach + max(smoothing.reach + 1, round(GUARD * rate)) + 2
        self._memory = round(MEMORY * rate)
        self._kept = every + 2 * self._after + self._memory
        self.reset()

    def reset(self) -> None:
        """What follows does not continue what came."""
        self._clock.restart()
        self._samples: deque[tuple[float, Array, Array]] = deque(maxlen=self._kept)
        self._waiting = 0  # samples whose rows are not known
        self._begun = False

    def take(self, time: float, position: Array, torque: Array) -> Known | None:
        """Take in a sample: time [s], positions (n,) [rad] and the torques (n,) [N m] held from it on.

        One that is not all numbers is left out. After it, and after a gap in time, nothing continues.

        Raises:
            ValueError: if there is not one position and one torque a joint, if time does not go on, or if samples do
                not come at the rate.
        """
        position, torque = np.array(position, dtype=float), np.array(torque, dtype=float)
        if position.shape != (count := len(self.joints),) or torque.shape != (count,):
            raise ValueError(
                f"a sample of {count} joints has as many positions and torques, not those of shapes {position.shape} "
                f"and {torque.shape}"
            )
        if not np.isfinite([time, *position, *torque]).all():
            self.reset()
            return None
        if self._clock.tick(time):
            self.reset()
            self._clock.tick(time)
        self._samples.append((time, position, torque))
        self._waiting += 1
        if len(self._samples) < self._kept or self._waiting < self.every:
            return None
        times, positions, torques = (np.array(values) for values in zip(*self._samples, strict=True))
        recording = ArmRecording.of("online", self.joints, times, positions, torques)
        m = tuple(measure(joint, self._smoothing) for joint in recording.joints)
        # of N measurements, the last `after - reach` still wait for what decides whether they are clear
        end = len(m[0]) - (self._after - self._smoothing.reach)
        first = max(0, end - self._waiting if self._begun else self._memory)
        self._waiting, self._begun = 0, True
        return Known(m, through(self._scheme, rows(m, self._terms, self._scheme.view), m), first, end)


class ArmBinner(BinSource):
    """Gathers the rows of an arm's joints in bins, each joint's own: one may stick while the others move."""

    def __init__(self, terms: Sequence[Term], smoothing: Smoothing, rate: float) -> None:
        """Take the terms, the links first, the smoothing, and the samples per second [Hz]."""
        self.every, self._slowest, self._rate = max(1, round(BIN * rate)), smoothing.slowest, rate
        chunk = self.every * max(1, round(CHUNK / BIN))
        self._stream = ArmStream(terms, scheme("hamiltonian"), smoothing, rate, chunk)
        self.joints = self._stream.joints
        self.reset(np.ones(1, dtype=bool))

    def reset(self, which: Mask) -> None:
        """What follows does not continue what came, if `which` (1,)."""
        if which.all():
            self._stream.reset()
            self._before: tuple[float, Array] | None = None  # time and positions of the sample before
            self._moved = 0

    def take(self, time: Array, position: Array, torque: Array) -> list[Bin]:
        """Take in a sample: time (1,), positions and torques (1, n), those over the period that ends with it."""
        before, self._before = self._before, (float(time[0]), position[0])
        known = None if before is None else self._stream.take(*before, torque[0])
        if known is None:
            return []
        m, n = known.joints, self.every
        found = []
        for end in range(known.first + (known.end - known.first) % n + n, known.end + 1, n):
            own = slice(end - n, end)
            self._moved += int(np.any([np.abs(one.velocity[own]) > self._slowest for one in m], axis=0).sum())
            for j, (equations, usable) in enumerate(known.regressions):
                if usable[own].all() and end - n >= MARGIN - 1:
                    x = m[j].samples
                    series = np.array([x.time, x.position, x.velocity, x.torque])[:, end - n - 2 : end + 1]
                    y = float(equations.y[own].mean())
                    found.append(Bin(0, j, series, equations.phi[own].mean(axis=0), y, self._moved / self._rate))
        return found


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
    ) -> None:
        """Make the estimator.

        Args:
            body: its links.
            rate: samples per second [Hz].
            terms: at joints; viscous and Coulomb friction by default.
            scheme: that makes the rows, one that borrows nothing and does not sum from the start.
            counts: of the encoders per turn, 0 if they are exact.

        Raises:
            ValueError: if the scheme cannot work so.
        """
        if scheme.borrows is not None or scheme.drifts:
            raise ValueError(
                f"{scheme.id} cannot run on an arm as it is set: let it borrow nothing, and give it a window"
            )
        self.body, self.scheme = body, scheme
        self.terms = (Links(body), *(friction(body) if terms is None else terms))
        self._stream = ArmStream(self.terms, scheme, Smoothing.of_encoder(counts, rate), rate, round(CHUNK * rate))
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.state: State = start(sum(len(term.columns) for term in self.terms), PRIOR)
        self._stream.reset()

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
        known = self._stream.take(time, position, torque)
        if known is not None:
            for k in range(known.first, known.end):
                for equations, usable in known.regressions:
                    if usable[k]:
                        self.state = step(self.state, equations.phi[k], float(equations.y[k]))
        return self.state


class ArmEstimators:
    """One `ArmEstimator` for each of several schemes, as wrappers feed them.

    Attributes:
        rate: samples per second [Hz].
        schemes: that run.
        names: of the parameters.
        each: by scheme.
    """

    def __init__(self, body: Body, rate: float, terms: Sequence[Term], schemes: Sequence[Scheme], counts: int) -> None:
        """Take the arm and its encoders as `ArmEstimator` does; raises as it does."""
        self.rate, self.schemes = rate, tuple(schemes)
        self.each = {one.id: ArmEstimator(body, rate, terms, one, counts=counts) for one in schemes}
        self.names = tuple(column.name for column in next(iter(self.each.values())).model.columns)
        self._last: tuple[float, Array] | None = None  # time and positions of the sample before

    def reset(self, which: Mask | None = None) -> None:
        """Forget what was estimated."""
        self._last = None
        for estimator in self.each.values():
            estimator.reset()

    def take(self, time: Array, position: Array, torque: Array) -> None:
        """Take in a sample: time (1,), positions and torques (1, n), those over the period that ends with it."""
        if self._last is not None:
            for estimator in self.each.values():
                estimator.update(*self._last, torque[0])
        self._last = float(time[0]), position[0]

    def tell(self, info: dict[str, Any]) -> None:
        """Put what is known into an info."""
        info["parameters"] = self.names
        info["estimates"] = {
            id: {"theta": own.state.theta, "P": own.state.P, "prediction_error": own.state.error}
            for id, own in self.each.items()
        }

    def lines(self) -> tuple[str, ...]:
        """What a picture says: estimates of the first scheme, three in a row."""
        id, first = next(iter(self.each.items()))
        told = [f"{name:<16}{v:7.3f}" for name, v in zip(self.names, first.state.theta.tolist(), strict=True)]
        return (id, *(" ".join(told[k : k + 3]) for k in range(0, len(told), 3)))
