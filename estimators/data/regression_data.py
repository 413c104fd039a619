"""Data of a regression: rows for fits, segments for simulation, and variants of effects compared by the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.decisions.score import BLOCK
from estimators.memoize import memoized
from estimators.regression.balance import Balance
from estimators.simulation.free_running import (
    Segments,
    choose_segments,
    compute_growth,
    refuse_long_horizon,
    select_segments,
)
from estimators.simulation.multiple_shooting import estimate_link_state, simulate_link_motion
from estimators.weak_form.contacts import ContactTest
from estimators.weak_form.floors import compute_noise_floor
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.preparation import prepare_windows
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.rows import RowLayout, RowMaker, Terms
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows, join_windows
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Model, Samples, Term, find_link, has_link, list_loads
from pendulum_env.physics.joints import find_mechanism, list_base_terms
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.recording import Recording
from pendulum_env.units import JointUnits


@dataclass(frozen=True, eq=False)
class RegressionData:
    """Rows y = phi(terms) theta of recordings of n >= 1 joints, and segments for simulation; results are memoised.

    Attributes:
        data: windows of the recorded motion and torque.
        segments: of each recording, for simulation; empty with links and with `rollouts`.
        base: terms of the model that gives the inertia in the noise; links come first.
        rollouts: maker of rows of simulated positions; None for rows of torque.
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
        inertia: float | None = None,
        block: float = BLOCK,
    ) -> RegressionData:
        """Cut recordings of a pendulum into windows and segments.

        The half width of the windows of each recording [s] is chosen by noise if not given. `part` are begin and end of
        the range with windows, as shares of each recording. A known `inertia` [kg m^2] scales encoder noise. A
        `block` of folds and score lasts so long [s].
        """
        data = prepare_windows(recordings, half_widths, part, inertia=inertia, block=block)
        return cls(data, tuple(choose_segments(w) for w in data.windows))

    def with_horizon(self, seconds: float, covers: bool = False) -> RegressionData:
        """Return the data with segments of `seconds` length; see `choose_segments` for `covers`.

        Raises:
            IdentificationError: if a recording has no segment without a gap of this length.
        """
        for w in self.data.windows:
            refuse_long_horizon(w, seconds)
        return replace(self, segments=tuple(choose_segments(w, seconds, covers) for w in self.data.windows))

    @classmethod
    def from_arm(
        cls,
        recordings: Sequence[Recording],
        terms: Sequence[type[Term] | Term],
        block: float = BLOCK,
        half_widths: Sequence[float] | None = None,
        fitted: TorqueWindows | None = None,
    ) -> RegressionData:
        """Cut recordings of joints into windows for some terms, the links first; see `prepare_arm`."""
        data = prepare_arm(recordings, terms, block=block, half_widths=half_widths, fitted=fitted)
        return cls(data, base=list_base_terms(find_mechanism(terms)))

    @classmethod
    def join(cls, parts: Sequence[RegressionData]) -> RegressionData:
        """Join the data of several recordings of a pendulum, with the states of the same links."""
        windows = [window for part in parts for window in part.data.windows]
        data = join_windows(windows, block=parts[0].data.block)
        link_states = {id: [x for part in parts for x in part.data.link_states[id]] for id in parts[0].data.link_states}
        segments = tuple(segment for part in parts for segment in part.segments)
        return cls(replace(data, link_states=link_states), segments)

    @cached_property
    def torque(self) -> TorqueRows:
        """Rows of the recorded torque."""
        return TorqueRows(self.data)

    @property
    def maker(self) -> RowMaker:
        """Maker of the rows: `rollouts`, else `torque`."""
        return self.torque if self.rollouts is None else self.rollouts

    @property
    def layout(self) -> RowLayout:
        """Joints, blocks and noise of the rows."""
        return self.maker.layout

    def locate_rows(self, at: str) -> slice:
        """Return the rows of a joint; all rows for terms at no single joint."""
        return self.layout.joints.get(at, slice(None))

    def equations(self, terms: Terms, by_noise: bool = False) -> Balance:
        """Return the rows of some terms, weighted as in a fit, or `by_noise` alone."""
        return self.maker.equations(terms, by_noise)

    def solve(self, terms: Terms) -> Array:
        """Fit the linear parameters (P,) of the terms."""
        return self.maker.fit(terms).theta

    def residual(self, terms: Terms, theta: Array | None = None) -> Array:
        """Return measured minus predicted values (R,) of some terms at parameters (P,), by default of their fit."""
        if theta is not None:
            return self.maker.residual(terms, np.asarray(theta))
        return self.equations(terms).error(self.solve(terms))

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """Whole recording of each entry of windows, which may cover a part of it."""
        return tuple(w.recording for w in self.data.windows)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recordings, each once."""
        return tuple(dict.fromkeys(recording.name for recording in self.recordings))

    @property
    def samples(self) -> Samples:
        """Samples at the middle of each window, (R,) each."""
        return self.data.samples

    @property
    def motions(self) -> dict[str, Samples]:
        """Samples at the middle of each window of each joint, by its name."""
        return {at: self.data.part(at).samples for at in self.data.joints}

    @property
    def recorded_motions(self) -> dict[str, Samples]:
        """All samples of each joint, with the torque as recorded, by its name."""
        return {at: self.data.part(at).recorded_samples for at in self.data.joints}

    def get_range(self, joint: str = "") -> tuple[float, float]:
        """Return the least and the largest recorded position [rad] of a joint, or of several joined in one name."""
        positions = [w.recording.position for w in self.data.windows if w.at in list_loads(joint)]
        return float(min(q.min() for q in positions)), float(max(q.max() for q in positions))

    @memoized
    def inertias(self, base: Sequence[Term]) -> dict[str, float]:
        """Return the inertia at each joint under a base model, by the joint's name [kg m^2], mean over the motion.

        That of a pendulum is the root of its mean square, which includes the variance of the estimate by noise: in
        motion that does not determine the inertia, encoder noise may be as large.
        """
        links, data = base[0], self.data
        if links.id not in data.shared_columns:
            return {at: self._measure_inertia(data.part(at), tuple(base)) for at in data.joints}
        theta = self.torque.fits.solve(base)[: len(links.columns)]
        return dict(zip(data.joints, np.abs(data.shared_columns[links.id].inertia @ theta).tolist(), strict=True))

    def _measure_inertia(self, data: TorqueWindows, base: Terms) -> float:
        """Return the root mean square of the inertia of a pendulum by a fit of a base model, or a known inertia."""
        if self.rollouts is not None or all(w.recording.known_inertia or w.inertia for w in data.windows):
            return data.base_inertia
        terms = (*base, GravityTilt()) if self.has_wrong_zero(base) else base
        windows = data.free_windows
        rows = self.torque if windows is self.data else TorqueRows(windows)
        fit = rows.equations(terms).fit(windows.clusters)
        floor = compute_noise_floor(data.windows, abs(float(fit.theta[0])))
        return float(np.hypot(fit.theta[0], fit.compute_std_by_noise(floor)[0]))

    @cached_property
    def floors(self) -> dict[str, float]:
        """Noise floor of the rows of each joint, by its name [N m], or [rad] of rollouts."""
        return {at: self.layout.noise(at, inertia) for at, inertia in self.inertias(self.base).items()}

    def has_wrong_zero(self, base: Terms) -> bool:
        """Return whether the torque shows a wrong zero of the position; False for a base without free gravity."""
        has_gravity = any(term.id == "gravity" and not term.columns[0].is_known for term in base)
        return has_gravity and self.layout.predicts_torque and self.data.has_wrong_zero

    def units(self, at: str = "") -> JointUnits:
        """Return the units of quantities at a joint."""
        return find_mechanism(self.base).units(at, self.recordings[0].units)

    def with_link_states(self, model: Model) -> RegressionData:
        """Return the data with estimated states of the model's link; unchanged without a link, or with rollouts."""
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
        """Return the data with contacts, see `ContactTest`; of a model with a link, with its states."""
        if has_link(model.terms):
            return self.with_link_states(model)
        count, inertia = len(model.theta), abs(model.estimates["inertia"].value)
        covariance = model.assumed_covariance[:count, :count]
        test = ContactTest(model.terms, model.theta, covariance, inertia)
        return replace(self, data=test.add_contacts(self.data, test.find_free_range(self.data)))


def drop_unstable_segments(data: RegressionData, model: Model) -> tuple[RegressionData, float]:
    """Drop segments in which a small error grows tenfold; return the data and the share of these segments.

    If no others exist, or a model without known inertia cannot simulate, the segments stay.
    """
    candidates = data.segments if model.has_known_inertia else ()
    steady = [compute_growth(segments, model.terms, model.theta) < RESOLUTION.growth for segments in candidates]
    pairs = zip(candidates, steady, strict=True)
    steady_segments = tuple(select_segments(*pair) for pair in pairs if pair[1].any())
    unstable = 1.0 - float(np.mean(np.concatenate(steady))) if steady else 0.0
    return replace(data, segments=steady_segments) if steady_segments else data, unstable
