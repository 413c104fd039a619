"""Samples in, equations out: what `measure` and the schemes make of a whole recording, as soon as it can be known.

Samples wait in a ring until they can be smoothed, instants until it is known whether they are clear of stick. All else
is a compiled recurrence, but for what lies further back: halts, and sums a window ago.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from estimators.online.bank import equations, gated, guards_of, windows_of
from estimators.online.rows import HELD, POSITION, TIME, TORQUE, VELOCITY, Course, Guarded, clear_of_stick, laws, rows
from estimators.schemes.six import Scheme
from estimators.signals.measurements import Smoothing
from estimators.signals.motion import LEAD_IN
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.compiled import Machine, Step
from pendulum_env.physics.simulation import Balance
from pendulum_env.physics.symbols import names
from pendulum_env.recording.sampling import SAMPLING

NEVER = -1e9
INSTANT = 6  # values


class Taken(NamedTuple):
    """One equation of each of S schemes for B plants, of one of their joints.

    Attributes:
        place: of the sample that it is of, in each plant's run; negative while too few have come in (B,).
        time: of the sample (B,) [s].
        equations: phi and, in the last place, y (B, S, P + 1); those of the next sample take their place.
        usable: which of them may be used (B, S).
        regressor: phi of the torque balance at the sample, 0 in stick (B, P); None of an arm.
        anew: which plants began anew with the newest sample (B,).
        following: the instant after that of the equations: time, position, velocity, acceleration, torque and held,
            those of `Measurements` (6, B); a part of a ring, to be copied.
        joint: whose they are, counted from 0.
    """

    place: Index
    time: Array
    equations: Array
    usable: Mask
    regressor: Array | None
    anew: Mask
    following: Array
    joint: int = 0

    @property
    def phi(self) -> Array:
        """(B, S, P)."""
        return self.equations[..., :-1]

    @property
    def y(self) -> Array:
        """(B, S)."""
        return self.equations[..., -1]


class Stream:
    """Turns samples of B pendulums into the equations of schemes, behind by smoothing and the longest guard.

    Attributes:
        joints: of a pendulum, the one without a name.
        delay: of the equations [samples].
    """

    joints = ("",)

    def __init__(
        self, terms: Sequence[Term], schemes: Sequence[Scheme], smoothing: Smoothing, period: float, batch: int
    ) -> None:
        """Take model, schemes, smoothing of the measurement, time between samples [s] and number of pendulums B.

        Raises:
            ValueError: if a scheme borrows its inertia, which only a whole recording knows, or a filter is too fast.
        """
        for scheme in schemes:
            if scheme.borrows is not None:
                raise ValueError(f"{scheme.id} borrows its inertia: online, it has to estimate it (borrows=None)")
        self._terms, self._period = tuple(terms), period
        self._balance = Balance(terms, np.ones(sum(len(term.columns) for term in terms)))
        length, late = 2 * smoothing.reach + 1, sum(term.delay for term in terms) / period
        lead_in = round(LEAD_IN / period) if self._balance.remembers else 0
        self._late = (int(late), late % 1.0) if late else None  # in samples
        if self._late is not None:  # nor is it known what was commanded before the start
            lead_in = max(lead_in, int(late) + 2)
        guards = guards_of(schemes)
        distances = tuple(None if g is None else max(smoothing.reach + 1, round(g / period)) for g in guards)
        behind = max([1, *(distance for distance in distances if distance is not None)])
        guarded = Guarded(distances, behind, lead_in, smoothing.slowest)
        self.delay, self._behind = smoothing.reach + behind, behind
        self._machine = Machine(_step, (self._terms, tuple(schemes), guarded, period), batch)
        self._own = self._laws()
        # weights of the last samples, each of which is time, position, its increment and torque, the oldest first; the
        # newest torque that is known is the one that acted until the newest position
        weights = np.zeros((INSTANT, length, 4))
        weights[TIME, smoothing.reach, 0] = 1.0
        weights[POSITION, :, 1] = smoothing.of_position()[::-1]
        weights[VELOCITY:TORQUE, 1:, 2] = smoothing.of_steps(period)[:, ::-1]
        weights[TORQUE:, 1:, 3] = smoothing.of_torque()[:, :0:-1]
        self._weights = weights.reshape(INSTANT, 4 * length)
        # every sample is written twice, so that the last ones always lie in a row
        self._samples = np.zeros((2, length, 4, batch))
        self._instants = np.zeros((behind + int(late) + 2, INSTANT, batch))
        self._halts = np.full((behind + 1, batch), NEVER)  # index of the last halt, as of the last instants
        self._looked = [(k, behind - n) for k, n in enumerate(distances) if n is not None and n < behind]
        width = self._machine.now["total"].shape[1]
        self._sums = [(k, np.zeros((n, width, batch))) for k, n in enumerate(windows_of(schemes, period)) if n]
        self._arrival = Machine(_arrival, (SAMPLING.long * period,), batch)
        self._index = np.full(batch, -length, dtype=np.intp)
        self._none = np.zeros(batch, dtype=bool)
        self._last: Samples | None = None
        self._count = 0
        self.reset(np.ones(batch, dtype=bool))

    def _laws(self) -> dict[str, Any]:
        """Laws that are no formulas, by what is given in their place."""
        given = self._machine.given
        return {label: law for label, law in laws(self._terms).items() if label in given}

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_own"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._own = self._laws()  # columns hold functions, which cannot be pickled

    def reset(self, which: Mask) -> None:
        """Those pendulums (B,) start anew with the next sample: smoothing and filters from rest."""
        self._index[which] = -self._samples.shape[1]
        self._machine.reset(which)
        self._samples[..., which] = self._instants[..., which] = 0.0
        self._halts[:, which] = self._machine.now["halt"][which] = NEVER
        for _, sums in self._sums:
            sums[..., which] = 0.0

    def take(self, time: Array, position: Array, torque: Array) -> tuple[Taken]:
        """Take in a sample: time [s], position [rad], and torque [N m] over the period that ends with it, (B,) each.

        Those begin anew whose sample is not a number, which then is zero, and after a gap: as in a recording, nothing
        is told across it, and a segment begins.
        """
        arrival = self._arrival
        sample = arrival.given["sample"]
        sample[0], sample[1], sample[2] = time, position, torque
        arrival.step()
        anew = self._none
        if np.count_nonzero(arrival.now["anew"]):
            anew = arrival.now["anew"] > 0
            self.reset(anew)
        self._smooth(arrival.now["taken"])
        return (self._equations(anew),)

    def _smooth(self, taken: Array) -> None:
        """The newest instant that can be known."""
        length = self._samples.shape[1]
        slot, instant = self._count % length, self._instants[self._count % len(self._instants)]
        self._samples[:, slot] = taken
        window = self._samples.reshape(8 * length, -1)[4 * (slot + 1) : 4 * (slot + 1 + length)]
        np.matmul(self._weights, window, out=instant)
        self._index += 1

    def _equations(self, anew: Mask) -> Taken:
        """Equations of the sample that lies `behind` the newest instant."""
        given, told, count, ring = self._machine.given, self._machine.now, self._count, self._instants
        row = count - self._behind
        following = ring[(row + 1) % len(ring)]
        given["index"][:], given["newest"][:] = self._index, ring[count % len(ring), VELOCITY]
        given["instant"][:] = following
        index = self._index - self._behind
        if self._late is not None:
            given["supplied"][:] = self._supplied(row, *self._late)
        for k, past in self._looked:
            given["halts"][k] = self._halts[(count - past) % len(self._halts)]
        for k, sums in self._sums:
            given["oldest"][k] = sums[count % len(sums)]
        if self._own or self._balance.remembers:
            self._evaluate(index + 1, following.copy())
        self._machine.step()
        if self._looked:
            self._halts[count % len(self._halts)] = told["halt"]
        for k, sums in self._sums:
            sums[count % len(sums)] = told["total"][k]
        self._count += 1
        return Taken(
            index,
            self._arrival.now["taken"][TIME] - self.delay * self._period,
            told["equations"].transpose(2, 0, 1),
            told["usable"].T > 0,
            told["regressor"].T.copy(),
            anew,
            following,
        )

    def _supplied(self, row: int, whole: int, share: float) -> Array:
        """Torque at that instant and over the sample before it, so late (2, B)."""
        ring = self._instants
        return (1 - share) * ring[(row - whole) % len(ring), TORQUE:] + share * ring[
            (row - whole - 1) % len(ring), TORQUE:
        ]

    def _evaluate(self, index: Index, values: Array) -> None:
        """State variables of the terms and laws that are no formulas, at the following instant."""
        given, balance = self._machine.given, self._balance
        x = Samples(values[TIME], values[POSITION], values[VELOCITY], values[TORQUE])
        if balance.remembers:
            memory = balance.start(x)
            if self._last is not None:
                way = replace(self._last, torque=values[HELD])
                moved = balance.advance(way, 0.5 * (way.velocity + x.velocity), self._period)
                memory = {
                    id: tuple(np.where(index <= 0, a, b) for a, b in zip(own, moved[id], strict=True))
                    for id, own in memory.items()
                }
            for id, own in memory.items():
                given[f"memory.{id}"][:] = own
            self._last = x = replace(x, memory=memory)
        for label, law in self._own.items():
            given[label][:] = law(x)


def _arrival(longest: float) -> Step:
    """A sample that has come, in symbols: what is taken of it, and whether it follows the one before."""
    sample, (time, position) = names("sample", 3), names("last", 2)
    is_number = np.abs(sample[0] + sample[1] + sample[2]) < np.inf
    now = [np.where(is_number, value, 0.0) for value in sample]
    told = np.array([now[0], now[1], now[1] - position, now[2]])
    after = {"last": told[:2], "taken": told, "anew": 1.0 - is_number * (now[0] - time <= longest)}
    return Step({"sample": sample}, {"last": np.array([time, position])}, after)


def _step(terms: Sequence[Term], schemes: Sequence[Scheme], guarded: Guarded, period: float) -> Step:
    """One more instant in symbols, up to the equations of the sample that lies `behind` the newest."""
    index, instant, newest, course = names("index"), names("instant", INSTANT), names("newest"), Course()
    given = {"index": index, "instant": instant, "newest": newest}
    if any(term.delay for term in terms):
        supplied = given["supplied"] = names("supplied", 2)
    else:
        supplied = [course.of(f"supplied.{k}", instant[k], 1)[1] for k in (TORQUE, HELD)]
    at_rest = Balance(terms, np.ones(sum(len(term.columns) for term in terms))).start(Samples(*np.zeros((4, 1))))
    memory = {id: names(f"memory.{id}", len(own)) for id, own in at_rest.items()}
    given |= {f"memory.{id}": own for id, own in memory.items()}
    views, velocity, own = rows(terms, index - (guarded.behind - 1), instant, supplied, memory, period, course)
    given["halts"] = names("halts", len(guarded.distances))
    clear = clear_of_stick(guarded, index, newest, given["halts"], course)
    given["oldest"] = names("oldest", len(windows_of(schemes, period)), views.shape[1] + 1)
    moving, place = np.abs(velocity) > guarded.slowest, index - guarded.behind
    found, usable = equations(schemes, views, clear, moving, given["oldest"], place, period, course)
    told = {"regressor": gated(views[0, :-1], clear[0]), "equations": found, "usable": usable}
    return Step(given | own, course.before, course.after | told)
