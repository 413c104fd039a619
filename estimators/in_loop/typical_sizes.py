"""Sizes of linear parameters at which they matter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.in_loop.settings import LOOP
from estimators.memoize import memoized
from estimators.weak_form.rows import Terms
from estimators.weak_form.torque_rows import TorqueRows
from pendulum_env._typing import Array
from pendulum_env.physics import Term


@dataclass(eq=False)
class TypicalSizes:
    """Sizes of linear parameters, whose torque is the share `LOOP.fit.typical` of the RMS recorded torque.

    Attributes:
        torque: rows of the recorded torque.
    """

    torque: TorqueRows

    def list_sizes(self, terms: Terms) -> Array:
        """Return the size of each linear parameter of some terms (P,)."""
        return np.concatenate([np.empty(0), *(self.compute_sizes(term) for term in terms)])

    @memoized
    def compute_sizes(self, term: Term) -> Array:
        """Return the size of each linear parameter of a term (P,)."""
        rms = np.sqrt(np.mean(self.torque.data.torque.recorded**2))
        column_rms = np.sqrt(np.mean(self.torque.data.columns([term])[0][0] ** 2, axis=0))
        (x,) = self.torque.data.window_columns.trace(
            [term]
        )  # windows omit slow motion, in which friction may be largest
        peaks = [np.max(np.abs(column.force(x) + column.dry(x) * np.sign(x.velocity))) for column in term.columns]
        return np.asarray(LOOP.fit.typical * rms / np.maximum(np.maximum(column_rms, peaks), 1e-9))
