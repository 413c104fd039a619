"""Samples of an arm in, the equations of all its joints out, chunk by chunk."""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from estimators.online.clock import Clock
from estimators.online.stream import Stream, Taken
from estimators.schemes.balance import for_arms, rows, through
from estimators.schemes.six import GUARD, Scheme
from estimators.signals.measurements import Smoothing, measure
from pendulum_env._typing import Array, Mask
from pendulum_env.arms.joints import Links, links_of
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Term

CHUNK = 0.05  # [s] of samples that are taken in together: the links' equations of many cost little more than of one
MEMORY = 0.1  # [s] before a chunk, in which filters forget how they began: exp(-20) of it is left at 200 rad/s


class ArmStream:
    """Turns samples of an arm into the equations of schemes, as `Stream` does those of pendulums.

    They are those that `identify` uses. A sample has one equation a joint; a scheme of energy has one in all, which
    comes with the last joint.

    Attributes:
        joints: their names.
        delay: of the equations at most [samples].
    """

    def __init__(self, terms: Sequence[Term], schemes: Sequence[Scheme], smoothing: Smoothing, period: float) -> None:
        """Take the terms, the links first, schemes, smoothing of the measurement and time between samples [s].

        Raises:
            ValueError: if a scheme borrows its inertia or sums from the start, which only a whole recording knows.
        """
        for one in schemes:
            if one.borrows is not None or one.drifts:
                raise ValueError(
                    f"{one.id} cannot run on an arm as it is set: let it borrow nothing, and give a window"
                )
        self._terms, self._schemes, self._smoothing = tuple(terms), for_arms(schemes), smoothing
        self.joints = links_of(terms).joints
        self._clock = Clock(1.0 / period)
        # after a sample, what decides whether it is clear; before it, what its row depends on
        self._after = smoothing.reach + max(smoothing.reach + 1, round(GUARD / period)) + 2
        self._every, self._memory = max(1, round(CHUNK / period)), round(MEMORY / period)
        self._kept = self._every + 2 * self._after + self._memory
        self.delay = self._after + self._every
        self._begin()

    def reset(self, which: Mask) -> None:
        """What follows does not continue what came, if `which` (1,)."""
        if which.all():
            self._begin()

    def _begin(self) -> None:
        self._clock.restart()
        self._before: tuple[float, Array] | None = None  # time and positions of the sample before
        self._samples: deque[tuple[float, Array, Array]] = deque(maxlen=self._kept)
        self._count = self._told = 0  # samples so far, and those of them whose equations are known

    def take(self, time: Array, position: Array, torque: Array) -> Sequence[Taken]:
        """Take in a sample: time (1,) [s], positions and torques (1, n), those over the period that ends with it.

        One that is not all numbers is left out. After it, and after a gap in time, nothing continues.

        Raises:
            ValueError: if there is not one position and one torque a joint, if time does not go on, or if samples do
                not come at the rate.
        """
        now, motion, acted = float(time[0]), np.array(position[0], dtype=float), np.array(torque[0], dtype=float)
        if motion.shape != (count := len(self.joints),) or acted.shape != (count,):
            raise ValueError(
                f"a sample of {count} joints has as many positions and torques, not those of shapes {motion.shape} "
                f"and {acted.shape}"
            )
        if not np.isfinite([now, *motion]).all():
            self._begin()
            return ()
        if self._clock.tick(now) or not np.isfinite(acted).all():
            self._begin()
            self._clock.tick(now)
        if self._before is not None:
            self._samples.append((*self._before, acted))
            self._count += 1
        self._before = now, motion
        ready = self._count >= self._kept and self._count - self._told >= self._every
        return tuple(self._equations()) if ready else ()

    def _equations(self) -> Iterator[Taken]:
        """Equations that have become known, sample by sample and joint by joint."""
        times, positions, torques = (np.array(values) for values in zip(*self._samples, strict=True))
        recording = ArmRecording.of("online", self.joints, times, positions, torques)
        m = tuple(measure(joint, self._smoothing) for joint in recording.joints)
        reach = self._smoothing.reach
        # of N measurements, the last `after - reach` still wait for what decides whether they are clear
        end, place = len(m[0]) - (self._after - reach), self._count - self._kept + reach  # of the first measurement
        first = end - (self._count - self._told) if self._told else 0
        balances = {view: rows(m, self._terms, view) for view in {scheme.view for scheme in self._schemes}}
        joints, width = len(m), balances[self._schemes[0].view][0].phi.shape[1] + 1
        equations = np.zeros((len(m[0]), joints, len(self._schemes), width))
        usable = np.zeros(equations.shape[:3], dtype=bool)
        for s, scheme in enumerate(self._schemes):
            found = through(scheme, balances[scheme.view], m)
            for j, (own, used) in enumerate(found, joints - len(found)):
                equations[:, j, s, :-1], equations[:, j, s, -1], usable[:, j, s] = own.phi, own.y, used
        if not self._told:
            usable[: self._memory] = False
        instants = np.array([[x.time, x.position, x.velocity, x.acceleration, x.torque, x.held] for x in m])
        self._told = self._count
        anew = np.zeros(1, dtype=bool)
        for k in range(first, end):
            for j in range(joints):
                yield Taken(
                    np.array([place + k]),
                    times[reach + k : reach + k + 1],
                    equations[k, j][None],
                    usable[k, j][None],
                    None,
                    anew,
                    instants[j, :, k + 1 : k + 2],
                    j,
                )


def stream_of(
    terms: Sequence[Term], schemes: Sequence[Scheme], smoothing: Smoothing, period: float, batch: int
) -> Stream | ArmStream:
    """What turns samples of B pendulums, or of an arm where the first term is its links, into equations of schemes.

    Raises:
        ValueError: if there are several arms.
    """
    if any(isinstance(term, Links) for term in terms):
        if batch != 1:
            raise ValueError("arms are followed one by one: take one for each")
        return ArmStream(terms, schemes, smoothing, period)
    return Stream(terms, schemes, smoothing, period, batch)
