"""From rows to the equations of all schemes at once: gates, filters and running sums, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimators.online.rows import VIEWS, Rows
from estimators.schemes.six import OnlineScheme, forgets
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

    def __init__(self, schemes: Sequence[OnlineScheme], parameters: int, period: float, batch: int) -> None:
        """Take the schemes, the number of parameters P, the time between samples [s] and the number of pendulums B.

        Raises:
            ValueError: if a scheme borrows its inertia, which only a whole recording knows, or a filter is too fast.
        """
        for scheme in schemes:
            if scheme.borrows is not None:
                raise ValueError(f"{scheme.id} borrows its inertia: online, it has to estimate it (borrows=None)")
        count, width = len(schemes), parameters + 1
        self.guards = tuple(dict.fromkeys(scheme.guard for scheme in schemes))
        self._period = period
        self._view = np.array([VIEWS.index(scheme.view) for scheme in schemes])
        # a gate for each guard at the sample itself, then one for each guard over the step up to it
        over_step = [len(self.guards) * (scheme.view != "torque") for scheme in schemes]
        self._gate = np.array([self.guards.index(scheme.guard) for scheme in schemes]) + over_step
        self._before = np.zeros((len(self.guards), batch), dtype=bool)
        # filters F[k] = F[k-1] + (1 - a) (x[k] - F[k-1]): a = 0 where there is none, and those of second order twice
        keep = [forgets(scheme.cutoff, period) if hasattr(scheme, "cutoff") else 0.0 for scheme in schemes]
        self._gain = 1.0 - np.array(keep)[:, None, None]
        self._state = np.zeros((2, count, width, batch))
        self._twice = np.array([s for s, scheme in enumerate(schemes) if getattr(scheme, "order", 1) == 2], dtype=int)
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
        usable = np.concatenate((clear, clear & self._before))[self._gate]  # (S, B)
        self._before = clear
        equations = rows.views[self._view] * usable[:, None]  # (S, P + 1, B)
        first, second = self._state
        first += self._gain * (equations - first)
        equations = first.copy()
        if len(self._twice):
            second += self._gain * (first - second)
            equations[self._twice] = second[self._twice]
        for k, (s, window) in enumerate(self._summed):
            self._total[k] += equations[s] * self._period
            equations[s] = self._total[k]
            usable[s] = rows.index >= self._length[k]
            if window is not None:
                oldest = self._sums[k][self._step % self._length[k]]
                equations[s] -= oldest
                oldest[:] = self._total[k]
        self._step += 1
        moved = equations.transpose(2, 0, 1)  # (B, S, P + 1)
        return Taken(moved[..., :-1], moved[..., -1], usable.T)
