"""Columns of terms over windows with their derivatives by the torque, and the rows that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from estimators.memoize import memoized
from estimators.regression.balance import Balance, Columns, place_columns
from estimators.weak_form.columns import is_torque_dependent, list_bounds
from estimators.weak_form.floors import compute_precision
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.rows import Terms
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import Array
from pendulum_env.physics import SIGNIFICANT, Term

VARIANTS = RESOLUTION.variants


@dataclass(eq=False)
class TorqueColumns:
    """Columns of terms on the rows of the windows `data`; results are memoised."""

    data: TorqueWindows
    _columns: dict[Term, Columns] = field(default_factory=dict, init=False)
    _recent: dict[tuple[Term, ...], Balance] = field(default_factory=dict, init=False)

    @memoized
    def _make_joint_columns(self, joint: str) -> TorqueColumns:
        """Return the columns of one of several joints."""
        return TorqueColumns(self.data.part(joint))

    def select_joint(self, joint: str) -> TorqueColumns:
        """Return the columns of a joint; those of all rows for a term at several joints."""
        return self if self.data.part(joint) is self.data else self._make_joint_columns(joint)

    def columns(self, variants: Terms) -> list[Columns]:
        """Return the windowed columns of each variant of one effect, on the rows of its joint."""
        if (of_joint := self.select_joint(variants[0].at)) is not self:
            return of_joint.columns(variants)
        missing = [variant for variant in variants if variant not in self._columns]
        if missing:
            self._columns.update(zip(missing, self.make_columns(missing), strict=True))
        return [self._columns[variant] for variant in variants]

    def make_columns(self, variants: Terms) -> list[Columns]:
        """Return the windowed columns of each variant of one effect, on the rows of its joint; not memoised."""
        if (of_joint := self.select_joint(variants[0].at)) is not self:
            return of_joint.make_columns(variants)
        columns, effect, torque = self.data.columns(variants), variants[0], self.data.torque.recorded
        if not is_torque_dependent(effect):
            return [Columns(linear, fixed, np.zeros_like(linear)) for linear, fixed in columns]
        step = VARIANTS.perturbation * self._largest_torque * self.data.scale
        pairs = zip(columns, self._perturbed_windows.columns(variants), strict=True)
        parts = [
            Columns(linear, fixed, (moved_linear - linear) / step[:, None], (moved_fixed - fixed) / step)
            for (linear, fixed), (moved_linear, moved_fixed) in pairs
        ]
        if not (effect.fixed and effect.has_state()):
            return parts
        torque_norm = float(np.linalg.norm(torque))
        norms = [float(np.linalg.norm(torque - part.fixed)) for part in parts]
        return [
            part if variant.delay or norm >= torque_norm else part._replace(torque_share=max(norm / torque_norm, 1e-12))
            for variant, part, norm in zip(variants, parts, norms, strict=True)
        ]

    def add_fixed_change(self, term: Term, part: Columns) -> Columns:
        """Return the columns of a term with `fixed_change`, if its fixed columns depend on the present torque."""
        if (of_joint := self.select_joint(term.at)) is not self:
            return of_joint.add_fixed_change(term, part)
        if not term.fixed or term.has_state():
            return part
        fixed = self.data.window_columns.averages.perturb_fixed_columns(term, self._perturbations)
        fixed = np.nan_to_num(fixed, nan=0.0, posinf=0.0, neginf=0.0)
        slopes = 1.0 - np.diff(fixed, axis=1) / np.diff(self.perturbations, axis=1)
        torque = self.data.torque.recorded
        torque_share = float(np.linalg.norm(torque - part.fixed)) / max(float(np.linalg.norm(torque)), 1e-300)
        return part._replace(fixed_change=self.perturbations - self._compute_response(slopes, min(torque_share, 1.0)))

    def _compute_response(self, slopes: Array, torque_share: float) -> Array:
        """Return the responses (R, J) [N m] of equations to perturbations, from the slopes s between these (R, J - 1).

        A residual r is an error of the recorded torque u or of the motion. The motion has a share c of the variance of
        noise. Its torque is smaller by `torque_share` k, the ratio of the norms of remaining and recorded torque. The
        likeliest errors equal an error r / sqrt((1 - c) s^2 + c k^2) of u, which is finite beyond a saturation. A law
        that scales all torques down does not reduce this error.
        """
        share = self._motion_share[:, None]
        steps = np.sqrt((1.0 - share) * slopes**2 + share * torque_share**2) * np.diff(self.perturbations, axis=1)
        response = np.cumsum(np.column_stack([np.zeros(len(steps)), steps]), axis=1)
        return response - response[:, [len(VARIANTS.perturbations)]]

    @cached_property
    def _motion_share(self) -> Array:
        """Share of the motion in the variance of each equation's noise (R,); 0 with links or insignificant inertia."""
        data = self.data
        if any(w.at or w.recording.known_inertia for w in data.windows):
            return np.zeros(len(data.weights))
        inertia = max(float(data.base_fit.theta[0] - SIGNIFICANT * data.base_fit.std[0]), 0.0)
        if inertia == 0.0:
            return np.zeros(len(data.weights))
        of_torque = np.array([w.noise.torque for w in data.windows])
        precision = compute_precision(data.windows)
        of_both = np.array([np.hypot(w.noise.compute_std(inertia), precision) for w in data.windows])
        return np.maximum(0.0, 1.0 - (of_torque / np.maximum(of_both, 1e-300)) ** 2)[data.recording_of_window]

    @property
    def _largest_torque(self) -> float:
        """Largest absolute windowed torque [N m], above zero."""
        return max(float(np.abs(self.data.torque.recorded).max()), 1e-12)

    @cached_property
    def _perturbed_windows(self) -> TorqueWindows:
        """Windows with a small offset of the torque, for derivatives."""
        return self.data.with_torque(offset=VARIANTS.perturbation * self._largest_torque)

    @property
    def _perturbations(self) -> Array:
        """Increasing perturbations of the torque (J,) [N m], zero in the middle, for nonlinear laws."""
        steps = np.array(VARIANTS.perturbations)
        return self._largest_torque * np.concatenate([-steps[::-1], [0.0], steps])

    @cached_property
    def perturbations(self) -> Array:
        """Perturbations of the torque in each row of all joints (R, J) [N m], times the scale of the row."""
        joints = [self.select_joint(at) for at in self.data.joints]
        return np.concatenate([np.outer(rows.data.scale, rows._perturbations) for rows in joints])

    @memoized
    def _rates(self, term: Term) -> Array:
        """Return time derivatives of the linear columns of a term (R, P), on the rows of its joint."""
        return self.data.rates(term)

    def list_term_columns(self, terms: Terms) -> list[Columns]:
        """Return the columns of each term, on the rows of its joint, with `fixed_change`."""
        return [self._make_whole_columns(term) for term in terms]

    @memoized
    def _make_whole_columns(self, term: Term) -> Columns:
        """Return the columns of a term with `fixed_change`."""
        return self.add_fixed_change(term, self.columns([term])[0])

    def equations(self, terms: Terms) -> Balance:
        """Return the rows of some terms, weighted by noise; those of the last `VARIANTS.cached` sets are memoised."""
        key = tuple(terms)
        if key not in self._recent:
            if len(self._recent) >= VARIANTS.cached:
                self._recent.pop(next(iter(self._recent)))
            self._recent[key] = self.assemble(terms, self.list_term_columns(terms), self.data.weights)
        return self._recent[key]

    def assemble(self, terms: Terms, parts: Sequence[Columns], weights: Array) -> Balance:
        """Return the rows of some terms from the columns of each, `parts`, and weights (R,).

        With a term that filters torque (`lead`), `unfiltered` holds the rows without its fixed columns.
        """
        rows = [self.data.locate_rows(term.at) for term in terms]
        balance = Balance.from_target(self.data.torque.net, weights).with_columns(
            list(zip(rows, parts, strict=True)), *list_bounds(terms), self.perturbations
        )
        if not any(term.lead for term in terms):
            return balance
        unfiltered, lead = self.data.torque.net.copy(), np.zeros(len(weights))
        for place, term, part in zip(rows, terms, parts, strict=True):
            unfiltered[place] -= 0.0 if term.lead else part.fixed
            lead[place] += term.lead
        rates = place_columns(len(weights), list(zip(rows, map(self._rates, terms), strict=True)))
        y = unfiltered - lead * self.data.torque.load_rates
        return replace(
            balance, unfiltered=replace(balance, phi=balance.phi + lead[:, None] * rates, y=y, torque_share=1.0)
        )
