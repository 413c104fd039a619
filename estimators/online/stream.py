"""Conversion of samples into the equations of schemes, equal to those of a whole recording.

Samples wait in a ring buffer for smoothing, and instants wait for the decision on stick. The rest is a compiled
recurrence, except for older values: halts, and sums one window ago.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from estimators.online.noise_bias import COPIES
from estimators.online.rows import (
    HELD,
    INSTANT,
    POSITION,
    TIME,
    TORQUE,
    VELOCITY,
    StickGuards,
    list_filtered_forces,
    list_guards,
    list_laws,
    list_windows,
    write_step,
)
from estimators.schemes.six import Scheme
from estimators.signals.measurements import Smoothing
from estimators.signals.motion import LEAD_IN
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.compiled import Machine, SymbolicStep
from pendulum_env.physics.simulation import TorqueBalance
from pendulum_env.physics.symbols import make_symbols
from pendulum_env.recording.cleaning import CLEANING

NEVER = -1e9
SAMPLE = 4  # time, position, its increment, and torque of a sample
SIGNS = np.random.default_rng(0).choice([-1.0, 1.0], 8191)  # of added noise, by index of the sample


class StreamEquations(NamedTuple):
    """Equations of S schemes for one joint of B plants at one sample.

    Attributes:
        place: index of the sample since the start of each plant; negative before enough samples (B,).
        time: time of the sample (B,) [s].
        copies: phi and, in the last column, y (C, B, S, P + 1); the next sample overwrites them. The first copy is as
            measured. If the noise is known, two more have noise added to the position, and its negative.
        usable: mask of the usable equations (B, S).
        regressor: phi of the torque balance at the sample, 0 in stick (B, P); None with links.
        restarted: mask of the plants that restarted with the newest sample (B,).
        next_instant: time, position, velocity, acceleration, torque and held of the next instant, as in `Measurements`,
            and filtered forces (6 + F, B); a view of a ring buffer.
        joint: index of the joint.
    """

    place: Index
    time: Array
    copies: Array
    usable: Mask
    regressor: Array | None
    restarted: Mask
    next_instant: Array
    joint: int = 0

    @property
    def equations(self) -> Array:
        """Return phi and, in the last column, y as measured (B, S, P + 1)."""
        return self.copies[0]


class Stream:
    """Conversion of samples of B pendulums into the equations of schemes.

    Attributes:
        joints: names of the joints; empty for that of a pendulum.
        delay: delay of the equations by smoothing and the longest guard [samples].
    """

    joints = ("",)

    def __init__(
        self,
        terms: Sequence[Term],
        schemes: Sequence[Scheme],
        smoothing: Smoothing,
        period: float,
        batch: int,
        noise: float = 0.0,
    ) -> None:
        """Create a stream of samples of B pendulums, with a period between them [s].

        With `noise` [rad], the equations are also computed with white noise of this standard deviation added to the
        position. Halts remain those of the measured motion.
        """
        for scheme in schemes:
            if scheme.borrows is not None:
                raise ValueError(f"{scheme.id} borrows its inertia, which needs a whole recording: set borrows=None")
        self._terms, self._period = tuple(terms), period
        lanes = len(COPIES) if noise else 1, batch  # copies of each pendulum
        self._balance = TorqueBalance(terms, np.ones(sum(len(term.columns) for term in terms)))
        length, dead_time = 2 * smoothing.reach + 1, sum(term.delay for term in terms) / period
        lead_in = round(LEAD_IN / period) if self._balance.has_states else 0
        self._dead_time = (int(dead_time), dead_time % 1.0) if dead_time else None  # whole samples, and the rest
        if self._dead_time is not None:  # commands before the start are unknown
            lead_in = max(lead_in, int(dead_time) + 2)
        guards = list_guards(schemes)
        distances = tuple(None if g is None else max(smoothing.reach + 1, round(g / period)) for g in guards)
        behind = max([1, *(distance for distance in distances if distance is not None)])
        stick_guards = StickGuards(distances, behind, lead_in, smoothing.slowest)
        self.delay, self._behind = smoothing.reach + behind, behind
        self._machine = Machine(write_step, (self._terms, tuple(schemes), stick_guards, period), *lanes)
        # weights of the last samples, the oldest first: time, position, its increment, and torque until this sample
        weights = np.zeros((INSTANT, length, SAMPLE))
        weights[TIME, smoothing.reach, 0] = 1.0
        weights[POSITION, :, 1] = smoothing.make_position_kernel()[::-1]
        weights[VELOCITY:TORQUE, 1:, 2] = smoothing.make_step_kernels(period)[:, ::-1]
        weights[TORQUE:, 1:, 3] = smoothing.make_torque_kernels()[:, :0:-1]
        self._weights, self._window = weights.reshape(INSTANT, SAMPLE * length), weights[POSITION, :, 1].copy()
        halt_weights = np.zeros((length, SAMPLE))
        halt_weights[1:, 2] = smoothing.make_halt_kernel(period)[::-1]
        self._halt_weights, self._halt_velocity = halt_weights.ravel(), np.zeros(batch)
        self._noise = noise * _smooth_signs(weights) if noise else None
        # each sample is written twice, so that the last ones are contiguous
        self._samples = np.zeros((2, length, SAMPLE, batch))
        n_forces = len(list_filtered_forces(self._terms))
        self._forces = np.zeros((2, length, n_forces, batch))
        self._instants = np.zeros((behind + int(dead_time) + 2, INSTANT + n_forces, batch))
        self._halts = np.full((behind + 1, batch), NEVER)  # index of the last halt, as of the last instants
        self._shorter_guards = [(k, behind - n) for k, n in enumerate(distances) if n is not None and n < behind]
        width = self._machine.states["total"].shape[1]
        self._sums = [(k, np.zeros((n, width, *lanes))) for k, n in enumerate(list_windows(schemes, period)) if n]
        self._arrival = Machine(_receive_sample, (CLEANING.long_step * period, self._terms), batch)
        self._index = np.full(batch, -length, dtype=np.intp)
        self._no_restart = np.zeros(batch, dtype=bool)
        self._last_instant: Samples | None = None
        self._count = 0
        self.reset(self._no_restart | True)

    @cached_property
    def _numeric_laws(self) -> dict[str, Any]:
        """Laws that are no formulas, by the symbol of their value."""
        inputs = self._machine.inputs
        return {label: law for label, law in list_laws(self._terms).items() if label in inputs}

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without laws: columns hold functions, which cannot be pickled."""
        return {name: value for name, value in self.__dict__.items() if name != "_numeric_laws"}

    def reset(self, which: Mask) -> None:
        """Restart pendulums (B,) with their next sample; smoothing and filters start from rest."""
        self._index[which] = -self._samples.shape[1]
        self._samples[..., which] = self._forces[..., which] = self._instants[..., which] = 0.0
        self._halts[:, which] = NEVER
        self._machine.reset(which)
        self._machine.states["halt"][:, which] = NEVER
        for _, sums in self._sums:
            sums[..., which] = 0.0

    def take(self, time: Array, position: Array, torque: Array) -> tuple[StreamEquations]:
        """Add a sample of each pendulum, and return the next equations.

        A pendulum restarts after a gap in time, and after a sample that is not finite, which is replaced by zero.

        Args:
            time: (B,) [s].
            position: (B,) [rad].
            torque: over the period that ends with the sample (B,) [N m].
        """
        arrival = self._arrival
        sample = arrival.inputs["sample"]
        sample[0], sample[1], sample[2] = time, position, torque
        arrival.step()
        restarted = self._no_restart
        if np.count_nonzero(arrival.states["restarted"]):
            restarted = arrival.states["restarted"] > 0
            self.reset(restarted)
        self._smooth_instant(arrival.states["taken"])
        return (self._advance_recurrence(restarted),)

    def _smooth_instant(self, sample: Array) -> None:
        """Add a sample to the ring and smooth the newest instant.

        `_receive_sample` returns the sample. The instant (6 + F, B) lies `reach` samples earlier.
        `_advance_recurrence` advances `_count`.
        """
        length = self._samples.shape[1]
        slot, instant = self._count % length, self._instants[self._count % len(self._instants)]
        self._samples[:, slot], self._forces[:, slot] = sample[:SAMPLE], sample[SAMPLE:]
        window = self._samples.reshape(2 * SAMPLE * length, -1)[SAMPLE * (slot + 1) : SAMPLE * (slot + 1 + length)]
        np.matmul(self._weights, window, out=instant[:INSTANT])
        self._halt_velocity = self._halt_weights @ window
        if self._forces.size:
            forces = self._forces.reshape(2 * length, -1)[slot + 1 : slot + 1 + length]
            np.matmul(self._window, forces, out=instant[INSTANT:].reshape(-1))
        self._index += 1

    def _advance_recurrence(self, restarted: Mask) -> StreamEquations:
        """Advance the recurrence by one instant; return the equations of the sample `behind` the newest instant."""
        inputs, states, count, ring = self._machine.inputs, self._machine.states, self._count, self._instants
        row = count - self._behind
        next_instant = ring[(row + 1) % len(ring)]
        inputs["index"][:], inputs["newest"][:] = self._index, self._halt_velocity
        inputs["instant"][:], inputs["measured"][:] = next_instant[:, None], next_instant[POSITION]
        index = self._index - self._behind
        if self._noise is not None:
            inputs["instant"][POSITION:TORQUE] += COPIES * self._noise[:, None, (index + 1) % len(SIGNS)]
        if self._dead_time is not None:
            whole, share = self._dead_time
            later, earlier = (ring[(row - whole - k) % len(ring), TORQUE:INSTANT] for k in (0, 1))
            inputs["supplied"][:] = ((1 - share) * later + share * earlier)[:, None]
        for k, past in self._shorter_guards:
            inputs["halts"][k] = self._halts[(count - past) % len(self._halts)]
        for k, sums in self._sums:
            inputs["oldest"][k] = sums[count % len(sums)]
        if self._numeric_laws or self._balance.has_states:
            instants = inputs["instant"][:INSTANT].reshape(INSTANT, -1).copy()
            self._evaluate_laws(np.tile(index + 1, len(inputs["index"])), instants)
        self._machine.step()
        if self._shorter_guards:
            self._halts[count % len(self._halts)] = states["halt"][0]
        for k, sums in self._sums:
            sums[count % len(sums)] = states["total"][k]
        self._count += 1
        return StreamEquations(
            index,
            self._arrival.states["taken"][TIME] - self.delay * self._period,
            states["equations"].transpose(2, 3, 0, 1),
            states["usable"][:, 0].T > 0,
            states["regressor"][:, 0].T.copy(),
            restarted,
            next_instant,
        )

    def _evaluate_laws(self, index: Index, instant: Array) -> None:
        """Evaluate states of terms, and laws that are no formulas; write them to the inputs of the recurrence.

        Args:
            index: index of the instant since the start of each pendulum (B,); states restart up to index 0.
            instant: values of the instant after that of the last call (6, B).
        """
        inputs, balance = self._machine.inputs, self._balance
        x = Samples(instant[TIME], instant[POSITION], instant[VELOCITY], instant[TORQUE])
        if balance.has_states:
            memory = balance.start(x)
            if self._last_instant is not None:
                last_with_held_torque = replace(self._last_instant, torque=instant[HELD])
                next_states = balance.advance(
                    last_with_held_torque, 0.5 * (last_with_held_torque.velocity + x.velocity), self._period
                )
                memory = {
                    id: tuple(np.where(index <= 0, a, b) for a, b in zip(states, next_states[id], strict=True))
                    for id, states in memory.items()
                }
            for id, states in memory.items():
                inputs[f"memory.{id}"].reshape(len(states), -1)[:] = states
            self._last_instant = x = replace(x, memory=memory)
        for label, law in self._numeric_laws.items():
            inputs[label].reshape(-1)[:] = law(x)


def _smooth_signs(weights: Array) -> Array:
    """Smooth `SIGNS` as positions with weights of samples (INSTANT, L, 4).

    Returns:
        Position, velocity and acceleration of the instant with a window that ends before each sign (3, signs).
    """
    signs = np.array([SIGNS, SIGNS - np.roll(SIGNS, 1)])
    of_window = np.arange(-weights.shape[1], 0)[:, None] + np.arange(len(SIGNS))
    return np.asarray(np.einsum("ils,slk->ik", weights[POSITION:TORQUE, :, 1:3], signs[:, of_window % len(SIGNS)]))


def _receive_sample(longest: float, terms: Sequence[Term]) -> SymbolicStep:
    """Build the check of a sample in symbols.

    `taken` has time, position, increment of position and torque, each 0 if the sample is not finite, and the forces of
    `list_filtered_forces` (4 + F,). `restarted` is 1 for a sample that is not finite, or later than `longest` [s] after
    the last. A decreasing time is not detected.
    """
    sample, (time, position) = make_symbols("sample", 3), make_symbols("last", 2)
    is_number = np.abs(sample[0] + sample[1] + sample[2]) < np.inf
    values = [np.where(is_number, value, 0.0) for value in sample]
    x: Any = Samples(values[0], values[1], 0.0 * values[1], values[2])
    forces = [force(x) for force in list_filtered_forces(terms).values()]
    after = {
        "last": np.array(values[:2]),
        "taken": np.array([values[0], values[1], values[1] - position, values[2], *forces]),
        "restarted": 1.0 - is_number * (values[0] - time <= longest),
    }
    return SymbolicStep({"sample": sample}, {"last": np.array([time, position])}, after)


class Clock:
    """Check of sample times against a rate; after the first samples at the rate, a longer time is a gap.

    Attributes:
        time: time of the last sample [s]; minus infinity before the first.
    """

    def __init__(self, rate: float) -> None:
        """Create a clock with a rate [Hz]."""
        self._rate, self.time, self._was_on_time = rate, -math.inf, False

    def restart(self) -> None:
        """Accept any time next."""
        self.time = -math.inf

    def tick(self, time: float) -> bool:
        """Check the time of a sample [s], and return whether a gap lies before it."""
        elapsed = time - self.time
        if elapsed <= 0:
            raise ValueError(
                f"a sample at {time:.6g} s follows one at {self.time:.6g} s: call reset where time restarts"
            )
        is_on_time, has_previous = 0.9 < elapsed * self._rate < 1.1, math.isfinite(elapsed)
        is_gap = has_previous and not is_on_time
        if is_gap and not (self._was_on_time and elapsed * self._rate > CLEANING.long_step):
            raise ValueError(f"samples come every {elapsed:.4g} s, not at {self._rate:g} Hz: pass rate=")
        self.time, self._was_on_time = time, self._was_on_time or is_on_time
        return is_gap


def check_rate(rate: float) -> float:
    """Return a rate [Hz] if it is positive and finite."""
    if not 0 < rate < math.inf:
        raise ValueError(f"the rate cannot be {rate:g} Hz: give a positive number")
    return rate
