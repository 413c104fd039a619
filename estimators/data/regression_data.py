"""Data of a regression: rows for fits, segments for simulation, and variants of effects compared by the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.data.rows import FittedTerms, FoldFits, RowLayout, RowMaker, ScoredTerms, Terms
from estimators.regression.balance import Balance, Columns
from estimators.selection.errors import Errors
from estimators.simulation.free_running import (
    Segments,
    choose_segments,
    compute_deviation,
    compute_growth,
    compute_position_rms,
    refuse_long_horizon,
    select,
)
from estimators.simulation.multiple_shooting import estimate_link_state, simulate_link_motion
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows, join_windows, prepare
from pendulum_env._typing import Array
from pendulum_env.arms.joints import arm_base, find_body
from pendulum_env.physics import (
    BASE,
    Model,
    Samples,
    Term,
    find_link,
    has_link,
    list_loads,
)
from pendulum_env.recording import Recording
from pendulum_env.units import JointUnits

GROWS = 10.0  # times, that an error of the initial position grows in a window of free run where the motion is unstable


@dataclass(frozen=True, eq=False)
class RegressionData:
    """Rows y = phi(terms) theta of recordings of n >= 1 joints, and segments for simulation; results are memoised.

    Attributes:
        data: windows of the recorded motion and torque.
        segments: for simulation; none of an arm, and none where the rows are simulated.
        base: terms of the model whose inertia scales the noise, of an arm its links first.
        rollouts: maker of rows from rollouts; by default the rows are of torque.
    """

    data: TorqueWindows
    segments: tuple[Segments, ...] = ()
    base: tuple[Term, ...] = BASE
    rollouts: RowMaker | None = None

    @classmethod
    def from_recordings(
        cls,
        recordings: Sequence[Recording],
        half_widths: Sequence[float] | None = None,
        part: tuple[float, float] = (0.0, 1.0),
    ) -> RegressionData:
        """Prepare recordings, or a share of each; raises IdentificationError if they hold too little motion."""
        data = prepare(recordings, half_widths, part)
        return cls(data, tuple(choose_segments(w) for w in data.windows))

    def with_horizon(self, seconds: float, covers: bool = False) -> RegressionData:
        """Return the data with segments of another length [s]; see `choose_segments`.

        Raises:
            IdentificationError: if a recording has no stretch without a gap that is as long.
        """
        for w in self.data.windows:
            refuse_long_horizon(w, seconds)
        return replace(self, segments=tuple(choose_segments(w, seconds, covers) for w in self.data.windows))

    def with_steady_segments(self, model: Model) -> tuple[RegressionData, float]:
        """Return the data without segments in which a small error grows tenfold, unless all do, and their share."""
        simulated = self.segments if model.has_known_inertia else ()
        steady = [compute_growth(segments, model.terms, model.theta) < GROWS for segments in simulated]
        kept = tuple(select(*pair) for pair in zip(simulated, steady, strict=True) if pair[1].any())
        unstable = 1.0 - float(np.mean(np.concatenate(steady))) if steady else 0.0
        return replace(self, segments=kept) if kept else self, unstable

    @classmethod
    def from_arm(cls, recordings: Sequence[Recording], terms: Sequence[type[Term] | Term]) -> RegressionData:
        """Prepare recordings of an arm for terms, the links first; see `prepare_arm` for what it raises."""
        return cls(prepare_arm(recordings, terms), base=arm_base(find_body(terms)))

    @classmethod
    def join(cls, parts: Sequence[RegressionData]) -> RegressionData:
        """Join the data of several recordings, with the link states of each."""
        data = join_windows([window for part in parts for window in part.data.windows])
        link_states = {id: [x for part in parts for x in part.data.link_states[id]] for id in parts[0].data.link_states}
        segments = tuple(segment for part in parts for segment in part.segments)
        return cls(replace(data, link_states=link_states), segments)

    @cached_property
    def torque(self) -> TorqueRows:
        """Rows of the recorded torque."""
        return TorqueRows(self.data)

    @property
    def maker(self) -> RowMaker:
        """Maker of the rows."""
        return self.torque if self.rollouts is None else self.rollouts

    @property
    def layout(self) -> RowLayout:
        """Joints, blocks and noise of the rows."""
        return self.maker.layout

    def locate_rows(self, at: str) -> slice:
        """Return the rows of a joint; all rows for terms at no single joint."""
        return self.layout.joints.get(at, slice(None))

    def columns(self, variants: Terms) -> list[Columns]:
        """Return the columns of each variant of one effect, on the rows of its joint."""
        return self.maker.columns(variants)

    def equations(self, terms: Terms, by_noise: bool = False) -> Balance:
        """Return the rows of some terms, weighted as in a fit, or `by_noise` alone."""
        return self.maker.equations(terms, by_noise)

    def fit(self, terms: Terms, exactly: bool = False) -> FittedTerms:
        """Fit the linear parameters of some terms; `exactly` continues an iterative fit to convergence."""
        return self.maker.fit(terms, exactly)

    def fit_folds(self, terms: Terms) -> FoldFits:
        """Fit some terms without each fold, to first order around the fit without the last term if that suffices."""
        return self.maker.fit_folds(terms)

    def solve(self, terms: Terms) -> Array:
        """Fit the linear parameters (P,) of the terms."""
        return self.maker.fit(terms).theta

    def residual(self, terms: Terms, theta: Array | None = None) -> Array:
        """Return the residual (R,) of some terms at parameters (P,), by default those of their fit."""
        if theta is not None:
            return self.maker.residual(terms, np.asarray(theta))
        return self.equations(terms).error(self.solve(terms))

    def absorbed_noise(self, terms: Terms) -> list[tuple[slice, float]]:
        """Return the variance of torque noise that terms filter out of rows of torque, with these rows [(N m)^2]."""
        return self.torque.absorbed_noise(terms) if self.layout.predicts_torque else []

    def trial(self, terms: Terms) -> ScoredTerms:
        """Fit one set of terms."""
        return self.maker.trial(terms)

    def refine(self, trial: ScoredTerms, id: str) -> ScoredTerms:
        """Fit the continuous nonlinear parameters of one term of a trial from their values."""
        return self.maker.refine(trial, id)

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """Recordings; the data may be parts of them."""
        return tuple(w.recording for w in self.data.windows)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recordings, each once."""
        return tuple(dict.fromkeys(recording.name for recording in self.recordings))

    @property
    def samples(self) -> Samples:
        """Samples at the windows' centres, (R,) each."""
        return self.data.samples

    @property
    def motions(self) -> dict[str, Samples]:
        """Samples at the windows' centres of each joint, by its name."""
        return {at: self.data.part(at).samples for at in self.data.joints}

    def get_range(self, joint: str = "") -> tuple[float, float]:
        """Return the least and the largest recorded position of a joint, or of the joints that a term loads [rad]."""
        positions = [w.recording.position for w in self.data.windows if w.at in list_loads(joint)]
        return float(min(q.min() for q in positions)), float(max(q.max() for q in positions))

    def inertias(self, base: Sequence[Term]) -> dict[str, float]:
        """Return the inertia at each joint under a base model, by the joint's name [kg m^2]."""
        first, data = base[0], self.data
        if first.id not in data.shared_columns:
            return {at: self.torque.select_joint(at).base_inertia for at in data.joints}
        theta = self.torque.solve(base)[: len(first.columns)]
        return dict(zip(data.joints, np.abs(data.shared_columns[first.id].inertia @ theta).tolist(), strict=True))

    @cached_property
    def floors(self) -> dict[str, float]:
        """Error of the rows due to sensor noise at each joint, by the scatter of the log [N m], or [rad]."""
        return {at: self.layout.noise(at, inertia) for at, inertia in self.inertias(self.base).items()}

    def units(self, at: str = "") -> JointUnits:
        """Return the units of quantities at a joint."""
        return find_body(self.base).units(at, self.recordings[0].units)

    def with_link_states(self, model: Model) -> RegressionData:
        """Return the data with the states of a model's link estimated from the motion around each instant."""
        if not (has_link(model.terms) and self.layout.predicts_torque):
            return self
        term = find_link(model.terms)
        link_states = [simulate_link_motion(windows, model) for windows in self.data.windows]
        segments = [
            replace(segment, hidden={term.id: estimate_link_state(segment, x, term)})
            for segment, x in zip(self.segments, link_states, strict=True)
        ]
        return replace(self, data=replace(self.data, link_states={term.id: link_states}), segments=tuple(segments))

    def with_contacts(self, model: Model) -> RegressionData:
        """Return the data with contacts that the friction of a model does not explain; with a link, its states."""
        if has_link(model.terms):
            return self.with_link_states(model)
        count, inertia = len(model.theta), abs(model.estimates["inertia"].value)
        covariance = model.assumed_covariance[:count, :count]
        known = model.terms, model.theta, covariance, inertia
        return replace(self, data=self.data.with_contacts(*known, self.data.free_range(*known)))

    def joint_errors(self, residual: Array) -> dict[str, float]:
        """Return the root mean square of a residual (R,) at each joint."""
        return {at: float(np.sqrt(np.mean(residual[here] ** 2))) for at, here in self.layout.joints.items()}

    def errors(self, model: Model) -> Errors:
        """Return the errors of a model in torque, of each joint and of all, and in free-running position."""
        residual, body = self.residual(model.terms, model.theta), find_body(self.base)
        if not self.layout.predicts_torque:
            return Errors(np.nan, np.nan).with_loop(residual)
        torque, position, fit = float(np.sqrt(np.mean(residual**2))), np.nan, np.nan
        torque = torque if len({*body.slides}) == 1 else np.nan  # no N m and N in one number
        joints, sizes = self.joint_errors(residual), self.joint_errors(self.data.torque())
        shares = {at: error / sizes[at] if sizes[at] else None for at, error in joints.items()}
        if self.segments and model.has_known_inertia:
            position = compute_position_rms(self.segments, model.terms, model.theta)
            fit = _fit(position, compute_deviation(self.segments))
        torque_fit = _fit(torque, float(np.std(self.data.applied_torque())))
        return Errors(torque, position, torque_fit, fit, joints, shares)


def _fit(error: float, deviation: float) -> float:
    """Return the fit in percent (100 % less NRMSE) from error and deviation; 0 without any deviation."""
    return 100.0 * (1.0 - error / deviation) if deviation > 0 else 0.0
