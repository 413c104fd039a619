"""Columns of terms and torque over the windows of one or several recordings, which share one set of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from estimators.weak_form.averages import WindowAverages, concatenate_memory, concatenate_samples
from estimators.weak_form.traces import select_driving_samples, trace_all
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array
from pendulum_env.physics import LOAD, Samples, Term


@dataclass(frozen=True, eq=False)
class WindowColumns:
    """Columns of terms that depend on the motion of their own joint, on R rows.

    Attributes:
        windows: one entry per recording.
        link_states: see `TorqueWindows`.
    """

    windows: Sequence[Windows]
    link_states: Mapping[str, Sequence[Samples]] = field(default_factory=dict)

    @cached_property
    def averages(self) -> WindowAverages:
        """Averages over the windows, all recordings concatenated."""
        return WindowAverages.join([w.averages for w in self.windows])

    @cached_property
    def _rates(self) -> WindowAverages:
        """Averages of time derivatives over the windows, all recordings concatenated."""
        return WindowAverages.join([w.rates for w in self.windows])

    @cached_property
    def _unsmoothed(self) -> Samples:
        """Concatenated samples of all recordings, the inputs of an effect with impacts."""
        return concatenate_samples([w.unsmoothed for w in self.windows])

    def trace(self, variants: Sequence[Term]) -> list[Samples]:
        """Return the concatenated driving samples of all recordings with the states of each variant of one effect.

        Estimated states of a link are the same for all variants. States of other effects are simulated.
        """
        known = self.link_states.get(variants[0].id)
        if known:
            return [concatenate_samples(known)] * len(variants)
        first, kind = self.windows[0], type(variants[0])
        driving = self.averages.samples if select_driving_samples(first, kind) is first.samples else self._unsmoothed
        if not kind.has_state():
            return [driving] * len(variants)
        traced = zip(*trace_all(self.windows, variants), strict=True)
        return [replace(driving, memory=concatenate_memory(states)) for states in traced]

    def columns(self, variants: Sequence[Term]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect."""
        return self.averages.columns(variants, self.trace(variants))

    def rates(self, term: Term) -> Array:
        """Return time derivatives of the linear columns of a term (R, P)."""
        (x,) = self.trace([term])
        columns = [self._rates.column(column, x) for column in term.columns]
        return np.column_stack(columns) if columns else np.empty((self._rates.narrow.shape[0], 0))


@dataclass(frozen=True, eq=False)
class WindowTorque:
    """Torque averaged over R windows [N m].

    Attributes:
        windows: one entry per recording, or per recording and joint.
        payload: torque of known payloads (R,), or zero.
    """

    windows: Sequence[Windows]
    payload: Array | float = 0.0

    @cached_property
    def recorded(self) -> Array:
        """Recorded torque (R,)."""
        return np.concatenate([w.averages.narrow @ w.samples.torque for w in self.windows])

    @cached_property
    def applied(self) -> Array:
        """Applied torque (R,): the recorded one, in free swings -I q'' with the known inertia I."""
        return np.concatenate([_average_applied_torque(w) for w in self.windows])

    @cached_property
    def net(self) -> Array:
        """Left-hand side (R,): the recorded torque minus that of known loads and payloads."""
        loads = [
            w.averages.column(LOAD, w.samples) if w.samples.load else np.zeros(len(w.centers)) for w in self.windows
        ]
        return self.recorded - np.concatenate(loads) - self.payload

    @cached_property
    def load_rates(self) -> Array:
        """Time derivative of the torque of known loads (R,) [N m/s]."""
        return np.concatenate([w.rates.column(LOAD, w.samples) for w in self.windows])


def _average_applied_torque(w: Windows) -> Array:
    """Return the averages (R,) of the recorded torque; in a free swing -I q'' with the known inertia I [N m]."""
    known = w.recording.known_inertia
    return -known * (w.averages.narrow @ w.acceleration) if known else w.averages.narrow @ w.samples.torque
