"""The three views of the torque balance, sample by sample, and which samples are clear of stick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimators.online.stream import Instant
from estimators.signals.measurements import Smoothing
from estimators.weak_form.windows import LEAD_IN
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.simulation import Balance
from pendulum_env.physics.term import one, zero

VIEWS = ("torque", "impulse", "energy")
MASS, TORQUE, POWER, STORED = range(4)  # parts of a column
MEAN = np.array([-1.0, 13.0, 13.0, -1.0]) / 24  # over the sample before instant k, from k - 2 to k + 1
MEANS = np.array([np.roll(MEAN, shift) for shift in (1, 2, 3, 4)])  # by the slot of the newest in a ring of four
NEVER = -(10**9)


@dataclass(frozen=True, eq=False)
class Rows:
    """One equation of each view for B pendulums, and which guards are clear of stick there.

    Attributes:
        index: of the sample in each pendulum's run (B,).
        time: of the sample (B,) [s].
        views: phi and, in the last place, y; (3, P + 1, B) in the order of `VIEWS`.
        clear: for each guard, whether the sample is clear of stick (G, B).
    """

    index: Index
    time: Array
    views: Array
    clear: Mask


class RowMaker:
    """Turns instants into rows, as `schemes` does with whole recordings; behind by the longest guard."""

    def __init__(
        self,
        terms: Sequence[Term],
        smoothing: Smoothing,
        guards: Sequence[float | None],
        period: float,
        batch: int,
    ) -> None:
        """Take the model's terms, the guards [s], the time between samples [s] and the number of pendulums B."""
        self._period, self._slowest, self._batch = period, smoothing.slowest, batch
        self._terms = tuple(terms)
        self._gather()
        self._balance = Balance(terms, np.ones(len(self._columns)))
        self._lead_in = round(LEAD_IN / period) if self._balance.remembers else 0  # [samples] that are left out
        reach = smoothing.reach + 1
        self._distances = [None if guard is None else max(reach, round(guard / period)) for guard in guards]
        self.behind = max([1, *(distance for distance in self._distances if distance is not None)])  # [samples]
        late = sum(term.delay for term in terms) / period
        self._late = int(late), late % 1.0
        if late > 0:  # nor is it known what was commanded before the start
            self._lead_in = max(self._lead_in, int(late) + 2)
        count = len(self._columns) + len(self._fixed)
        self._parts = np.zeros((4, 4, count, batch))  # at the last four instants
        for j, column in enumerate([*self._columns, *self._fixed]):
            self._parts[:, MASS, j] = column.mass is one
        self._supply = np.zeros((self._late[0] + 4, 2, batch))  # torque at and before the last instants
        self._rows = np.zeros((self.behind, len(VIEWS), len(self._columns) + 1, batch))
        self._halts = np.full((self.behind + 1, batch), NEVER)  # index of the last halt, as of the last instants
        self._last: list[Samples] = []  # the two instants before
        self._acceleration = np.zeros(batch)
        self._step = 0

    def _gather(self) -> None:
        self._columns = [column for term in self._terms for column in term.columns]
        self._fixed = [column for term in self._terms for column in term.fixed]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_columns", "_fixed")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._gather()  # columns hold functions, which cannot be pickled

    def reset(self, which: Mask) -> None:
        """Those pendulums (B,) start anew."""
        self._halts[:, which] = NEVER

    def make(self, now: Instant) -> Rows:
        """Rows of the sample that lies `behind` before this instant."""
        step, behind = self._step, self.behind  # of instants so far
        x = self._remember(now)
        self._last = self._last or [x, x]
        self._fill(x)
        self._supply[step % len(self._supply)] = now.torque, now.held
        self._halts[step % (behind + 1)] = self._halt(now.index, x)
        self._rows[step % behind] = self._views(now.index)
        self._last = [self._last[1], x]
        self._acceleration = now.acceleration
        self._step += 1
        index = now.index - behind
        clear = np.array([self._clear(distance, index, step) for distance in self._distances])
        return Rows(index, now.time - behind * self._period, self._rows[(step + 1) % behind], clear)

    def _remember(self, now: Instant) -> Samples:
        """What the terms depend on at this instant, their state variables brought up to it."""
        x = Samples(now.time, now.position, now.velocity, now.torque)
        if not self._balance.remembers:
            return x
        if not self._last:
            return replace(x, memory=self._balance.start(x))
        before = self._last[1]
        way, velocity = replace(before, torque=now.held), 0.5 * (before.velocity + now.velocity)
        new, moved = self._balance.start(x), self._balance.advance(way, velocity, self._period)
        first = now.index <= 0
        memory = {id: tuple(np.where(first, a, b) for a, b in zip(new[id], moved[id], strict=True)) for id in new}
        return replace(x, memory=memory)

    def _fill(self, x: Samples) -> None:
        """Parts of all columns at the newest instant; those that are zero or one stay so."""
        parts = self._parts[self._step % 4]
        sign, speed = np.sign(x.velocity), np.abs(x.velocity)
        for j, column in enumerate([*self._columns, *self._fixed]):
            if column.mass is not zero and column.mass is not one:
                parts[MASS, j] = column.mass(x)
            torque = power = None
            if column.force is not zero:
                torque = column.force(x)
            if column.lossy is not zero:
                power = column.lossy(x) * x.velocity
            if column.potential is not None:
                parts[STORED, j] = column.potential(x)
            if column.dry is not zero:
                dry = column.dry(x)
                torque = dry * sign if torque is None else torque + dry * sign
                power = dry * speed if power is None else power + dry * speed
            if torque is not None:
                parts[TORQUE, j] = torque
            if power is not None:
                parts[POWER, j] = power

    def _views(self, index: Index) -> Array:
        """Phi and, in the last place, y of the three views at the instant before the newest (3, P + 1, B)."""
        step, period = self._step, self._period
        older, x = self._last
        at, before = self._parts[(step - 1) % 4], self._parts[(step - 2) % 4]
        mean = (MEANS[step % 4] @ self._parts.reshape(4, -1)).reshape(at.shape)  # (parts, columns, B)
        if (index == 2).any():  # the first mean that is taken: no sample lies two before it
            mean = np.where(index == 2, 0.5 * (at + before), mean)
        v, w = x.velocity, older.velocity
        count = len(self._columns)
        views = np.empty((len(VIEWS), at.shape[1] + 1, self._batch))
        views[0, :-1] = at[MASS] * self._acceleration + at[TORQUE]
        views[1, :-1] = mean[MASS] * ((v - w) / period) + mean[TORQUE]
        views[2, :-1] = (
            mean[MASS] * ((v * v - w * w) / (2 * period)) + mean[POWER] + (at[STORED] - before[STORED]) / period
        )
        views[0, -1], held = self._supplied()
        views[1, -1], views[2, -1] = held, held * ((x.position - older.position) / period)
        if self._fixed:
            views[:, -1] -= views[:, count:-1].sum(axis=1)
            views = np.delete(views, np.s_[count:-1], axis=1)
        return views

    def _supplied(self) -> Array:
        """Torque at the instant before the newest and over the sample before it, as late as the terms say (2, B)."""
        whole, share = self._late
        length, step = len(self._supply), self._step - 1 - whole
        if share == 0:
            return self._supply[step % length]
        return (1 - share) * self._supply[step % length] + share * self._supply[(step - 1) % length]

    def _halt(self, index: Index, x: Samples) -> Array:
        """Index of the last sample at which each pendulum had no direction or turned (B,)."""
        turned = (np.sign(x.velocity) != np.sign(self._last[1].velocity)) & (index > 0)
        halted = (np.abs(x.velocity) <= self._slowest) | turned
        return np.where(halted & (index >= 0), index, self._halts[(self._step - 1) % len(self._halts)])

    def _clear(self, distance: int | None, index: Index, step: int) -> Mask:
        """Whether the sample is at least that far from a halt (B,)."""
        if distance is None:
            return index >= self._lead_in
        halt = self._halts[(step - self.behind + distance) % len(self._halts)]
        return (halt < index - distance) & (index >= self._lead_in)
