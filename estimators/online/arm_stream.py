"""Conversion of samples of a linked mechanism into the equations of all its joints, chunk by chunk."""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from estimators.online.settings import ONLINE
from estimators.online.stream import Clock, Stream, StreamEquations
from estimators.schemes.balance import adapt_to_arms, apply_scheme, compute_balances
from estimators.schemes.six import Scheme
from estimators.signals.measurements import Smoothing, measure
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Term
from pendulum_env.physics.joints import Links, find_linked_mechanism
from pendulum_env.recording import Recording


class ArmStream:
    """Conversion of samples of a linked mechanism into the equations of schemes, equal to those of `identify`.

    A sample gives one equation per joint. An energy scheme gives one equation per sample, with the last joint.

    Attributes:
        joints: names of the joints.
        delay: largest delay of the equations [samples].
    """

    def __init__(self, terms: Sequence[Term], schemes: Sequence[Scheme], smoothing: Smoothing, period: float) -> None:
        """Create a stream of samples with a period between them [s]; the links are the first term."""
        for scheme in schemes:
            if scheme.borrows is not None or scheme.drifts:
                raise ValueError(
                    f"{scheme.id} needs the whole recording of an arm: set borrows=None, and give a window"
                )
        self._terms, self._schemes, self._smoothing = tuple(terms), adapt_to_arms(schemes), smoothing
        self.joints = find_linked_mechanism(terms).joints
        self._clock = Clock(1.0 / period)
        # samples after the current one that decide whether it is clear of stick
        self._lookahead = 2 * smoothing.reach + 3
        self._chunk = max(1, round(ONLINE.stream.arm_chunk / period))
        self._transient = round(ONLINE.stream.arm_transient / period)
        self._capacity = self._chunk + 2 * self._lookahead + self._transient
        self.delay = self._lookahead + self._chunk
        self._restart()

    def reset(self, which: Mask) -> None:
        """Restart with the next sample, if `which` (1,)."""
        if which.all():
            self._restart()

    def _restart(self) -> None:
        self._clock.restart()
        self._previous: tuple[float, Array] | None = None  # time and positions of the last sample
        self._samples: deque[tuple[float, Array, Array]] = deque(maxlen=self._capacity)
        self._count = self._n_done = 0  # samples so far, and those with equations

    def take(self, time: Array, position: Array, torque: Array) -> Sequence[StreamEquations]:
        """Add a sample, and return the equations of a chunk when it is complete.

        A sample that is not finite is left out. After it, and after a gap in time, the stream restarts.

        Args:
            time: (1,) [s].
            position: (1, n) [rad].
            torque: over the period that ends with the sample (1, n) [N m].

        Raises:
            ValueError: if the number of positions or torques is wrong, time does not increase, or the rate is wrong.
        """
        now, angles, torques = float(time[0]), np.array(position[0], dtype=float), np.array(torque[0], dtype=float)
        if angles.shape != (count := len(self.joints),) or torques.shape != (count,):
            raise ValueError(
                f"positions and torques have shapes {angles.shape} and {torques.shape}: give one number for each of "
                f"{count} joints"
            )
        if not np.isfinite([now, *angles]).all():
            self._restart()
            return ()
        if self._clock.tick(now) or not np.isfinite(torques).all():
            self._restart()
            self._clock.tick(now)
        if self._previous is not None:
            self._samples.append((*self._previous, torques))
            self._count += 1
        self._previous = now, angles
        ready = self._count >= self._capacity and self._count - self._n_done >= self._chunk
        return tuple(self._convert_samples()) if ready else ()

    def _convert_samples(self) -> Iterator[StreamEquations]:
        """Yield the equations of new samples, by sample and joint; the first `_transient` samples are not usable."""
        times, positions, torques = (np.array(values) for values in zip(*self._samples, strict=True))
        series = zip(positions.T, torques.T, strict=True)
        joints_of_chunk = (Recording(times, *each, name="online", is_checked=True) for each in series)
        m = tuple(measure(joint, self._smoothing) for joint in joints_of_chunk)
        reach = self._smoothing.reach
        # the last `_lookahead - reach` measurements wait for samples that decide on stick
        end = len(m[0]) - (self._lookahead - reach)
        place = self._count - self._capacity + reach  # index of the first measurement
        first = end - (self._count - self._n_done) if self._n_done else 0
        balances = {view: compute_balances(m, self._terms, view) for view in {scheme.view for scheme in self._schemes}}
        joints, width = len(m), balances[self._schemes[0].view][0].phi.shape[1] + 1
        equations = np.zeros((len(m[0]), joints, len(self._schemes), width))
        usable = np.zeros(equations.shape[:3], dtype=bool)
        for s, scheme in enumerate(self._schemes):
            of_joints = apply_scheme(scheme, balances[scheme.view], m)
            for j, (rows, is_usable) in enumerate(of_joints, joints - len(of_joints)):
                equations[:, j, s, :-1], equations[:, j, s, -1], usable[:, j, s] = rows.phi, rows.y, is_usable
        if not self._n_done:
            usable[: self._transient] = False
        instants = np.array([[x.time, x.position, x.velocity, x.acceleration, x.torque, x.held] for x in m])
        self._n_done = self._count
        restarted = np.zeros(1, dtype=bool)
        for k in range(first, end):
            for j in range(joints):
                yield StreamEquations(
                    np.array([place + k]),
                    times[reach + k : reach + k + 1],
                    equations[k, j][None, None],
                    usable[k, j][None],
                    None,
                    restarted,
                    instants[j, :, k + 1 : k + 2],
                    j,
                )


def make_stream(
    terms: Sequence[Term],
    schemes: Sequence[Scheme],
    smoothing: Smoothing,
    period: float,
    batch: int,
    noise: float = 0.0,
) -> Stream | ArmStream:
    """Create the stream of B pendulums, or of a linked mechanism if a term is its links, which ignores `noise`.

    Raises:
        ValueError: if `batch` is not 1 with links.
    """
    if any(isinstance(term, Links) for term in terms):
        if batch != 1:
            raise ValueError(f"batch is {batch}, but an arm has a stream of its own: use one estimator per arm")
        return ArmStream(terms, schemes, smoothing, period)
    return Stream(terms, schemes, smoothing, period, batch, noise)
