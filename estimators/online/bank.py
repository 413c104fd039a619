"""From rows to the equations of all schemes at once: gates, filters and running sums, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimators.online.rows import VIEWS, Rows
from estimators.schemes import Scheme, forgets
from pendulum_env._typing import Array, Mask


class Taken(NamedTuple):
    """One equation of each of S schemes for B pendulums.

    Attributes:
        phi: (B, S, P).
        y: (B, S).
        usable: (B, S).
    """

    phi: Array
    y: Array
    usable: Mask


class Bank:
    """Turns rows into the equations of the schemes, from rest, as their `regression` does with whole recordings."""

    def __init__(self, schemes: Sequence[Scheme], parameters: int, period: float, batch: int) -> None:
        """Take the schemes, the number of parameters P, the time between samples [s] and the number of pendulums B.

        Raises:
            ValueError: if a scheme borrows its inertia, which only a whole recording knows, or a filter is too fast.
        """
        for scheme in schemes:
            if scheme.borrows is not None:
                raise ValueError(f"{scheme.id} borrows its inertia: online, it has to estimate it (borrows=None)")
        width = parameters + 1
        self.guards = tuple(dict.fromkeys(scheme.guard for scheme in schemes))
        self._period = period
        self._view = np.array([VIEWS.index(scheme.view) for scheme in schemes])
        self._guard = np.array([self.guards.index(scheme.guard) for scheme in schemes])
        self._over_steps = np.array([scheme.view != "torque" for scheme in schemes])[:, None]
        self._before = np.zeros((len(self.guards), batch), dtype=bool)
        # filters F[k] = a F[k-1] + (1 - a) x[k], those of second order twice
        filtered = [(s, scheme) for s, scheme in enumerate(schemes) if getattr(scheme, "cutoff", None) is not None]
        self._filtered = np.array([s for s, _ in filtered], dtype=np.intp)
        self._twice = np.array([s for s, (_, scheme) in enumerate(filtered) if scheme.order == 2], dtype=np.intp)
        keep = [forgets(scheme.cutoff, period) for _, scheme in filtered]
        self._keep = np.array(keep)[:, None, None]
        self._state = np.zeros((2, len(filtered), width, batch))
        # running sums over a window, or from the start
        self._summed = [(s, scheme.window) for s, scheme in enumerate(schemes) if hasattr(scheme, "window")]
        self._length = [1 if window is None else max(1, round(window / period)) for _, window in self._summed]
        self._sums = [np.zeros((length, width, batch)) for length in self._length]
        self._total = np.zeros((len(self._summed), width, batch))
        self._step = 0

    def reset(self, which: Mask) -> None:
        """Those pendulums (B,) start anew, from rest."""
        self._state[..., which] = 0.0
        self._total[..., which] = 0.0
        for sums in self._sums:
            sums[..., which] = 0.0
        self._before[:, which] = False

    def take(self, rows: Rows) -> Taken:
        """Equations of the schemes after one more sample."""
        clear = rows.clear & (rows.index >= 0)
        both = clear & self._before  # the step up to this sample is clear if both its ends are
        self._before = clear
        usable = np.where(self._over_steps, both[self._guard], clear[self._guard])  # (S, B)
        equations = rows.views[self._view]  # (S, P + 1, B)
        if len(self._filtered):
            gated = equations[self._filtered] * usable[self._filtered][:, None]
            first, second = self._state
            first += (1 - self._keep) * (gated - first)
            equations[self._filtered] = first
            if len(self._twice):
                keep = self._keep[self._twice]
                second[self._twice] += (1 - keep) * (first[self._twice] - second[self._twice])
                equations[self._filtered[self._twice]] = second[self._twice]
        for k, (s, window) in enumerate(self._summed):
            self._total[k] += equations[s] * (usable[s] * self._period)
            equations[s] = self._total[k]
            usable[s] = rows.index >= self._length[k]
            if window is not None:
                oldest = self._sums[k][self._step % self._length[k]]
                equations[s] -= oldest
                oldest[:] = self._total[k]
        self._step += 1
        moved = np.moveaxis(equations, 2, 0)  # (B, S, P + 1)
        return Taken(moved[..., :-1], moved[..., -1], usable.T)
