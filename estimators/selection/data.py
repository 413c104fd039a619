"""Prepared data: recordings as windowed equations for fitting and as segments for simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from estimators.regression.least_squares import Fit
from estimators.selection.errors import Errors
from estimators.selection.prepared import Comparable, Fits
from estimators.selection.regression import Regression
from estimators.selection.screening import Screen
from estimators.signals.residual import SYMBOLS, Region, stand_out
from estimators.simulation.free_running import Segments, choose_segments, deviation, position_rms
from estimators.simulation.multiple_shooting import hidden_state, watch
from estimators.weak_form.dataset import Dataset, prepare
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env._typing import Array
from pendulum_env.arms.joints import Coupling, Links, arm_base, body_of
from pendulum_env.physics import BASE, Model, Samples, Term
from pendulum_env.physics.term import loads
from pendulum_env.physics.terms import has_link, link_of
from pendulum_env.recording import Recording

REPEATED = 2  # impacts, least number: a single one may be an accident
PLACES = (1e-3, 10.0)  # [s], trial displacements of an instant, for its standard error


@dataclass(frozen=True)
class PreparedData:
    """Recordings as windowed equations and as segments for simulation.

    Attributes:
        data: as windowed equations.
        segments: for simulation; none of an arm.
        base: terms of the model whose inertia scales the noise, of an arm its links first.
    """

    data: Dataset
    segments: tuple[Segments, ...] = ()
    base: tuple[Term, ...] = BASE

    in_loop: ClassVar[bool] = False  # whether the controller is simulated along, and a link with it

    @classmethod
    def of(
        cls, recordings: Sequence[Recording], half_widths: Sequence[float] | None = None, part: Part = WHOLE
    ) -> PreparedData:
        """Prepare recordings, or a part of each; raises IdentificationError if they hold too little motion."""
        data = prepare(recordings, half_widths, part)
        return cls(data, tuple(choose_segments(w) for w in data.windows))

    @classmethod
    def of_arm(cls, recordings: Sequence[Recording], terms: Sequence[type[Term] | Term]) -> PreparedData:
        """Prepare recordings of an arm, with the columns of terms that joints share.

        Args:
            recordings: of the arm.
            terms: that may be fitted to it, the links first.

        Raises:
            IdentificationError: if a joint hardly moves clear of stick.
        """
        links, *others = terms
        assert isinstance(links, Links)
        kinds = dict.fromkeys(term if isinstance(term, type) else type(term) for term in others)
        shared = [kind for kind in kinds if issubclass(kind, Coupling)]
        return cls(prepare_arm(recordings, links, shared), base=arm_base(links.body))

    @cached_property
    def regression(self) -> Regression:
        """Fits of sets of terms to the data."""
        return Regression(self.data)

    @cached_property
    def screen(self) -> Screen:
        """Variants of effects, by how well they fit the data."""
        return Screen(self.regression)

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """Recordings; the data may be parts of them."""
        return tuple(w.recording for w in self.data.windows)

    @property
    def samples(self) -> Samples:
        """Samples at the windows' centres, (R,) each."""
        return self.data.samples

    @property
    def motions(self) -> dict[str, Samples]:
        """Samples at the windows' centres of each joint, by its name."""
        return {at: self.data.part(at).samples for at in self.data.joints}

    def reach(self, joint: str = "") -> tuple[float, float]:
        """Return the least and the largest recorded position of a joint, or of the joints that a term loads [rad]."""
        positions = [w.recording.position for w in self.data.windows if w.at in loads(joint)]
        return float(min(q.min() for q in positions)), float(max(q.max() for q in positions))

    def inertias(self, base: Sequence[Term]) -> dict[str, float]:
        """Return the inertia at each joint under a base model, by the joint's name [kg m^2]."""
        first, data = base[0], self.data
        if first.id not in data.given:
            of_one = {at: self.regression if len(data.joints) == 1 else Regression(data.part(at)) for at in data.joints}
            return {at: base_inertia(own) for at, own in of_one.items()}
        theta = self.regression.solve(base)[: len(first.columns)]
        return dict(zip(data.joints, np.abs(data.given[first.id].inertia @ theta).tolist(), strict=True))

    @cached_property
    def floors(self) -> dict[str, float]:
        """Torque error due to sensor noise at each joint, by the scatter of the log [N m]."""
        felt = self.inertias(self.base)
        return {at: self.data.part(at).noise(felt[at]) for at in self.data.joints}

    def stand_out(self, residual: Array, at: str, axes: Sequence[str] = tuple(SYMBOLS), most: int = 6) -> list[Region]:
        """Return the regions where a residual (R,) [N m] exceeds the noise at a joint, the most significant first."""
        own, least, body = residual[self.data.where(at)], self.data.negligible(at), body_of(self.base)
        found = stand_out(self.data.part(at).samples, own, self.floors[at], axes, most)
        return [replace(region, at=at, slides=at in body.sliding) for region in found if abs(region.residual) > least]

    def with_link_states(self, model: Model) -> PreparedData:
        """Return the data with the states of a model's link estimated from the motion around each instant."""
        if not has_link(model.terms):
            return self
        term = link_of(model.terms)
        link_states = [watch(windows, model) for windows in self.data.windows]
        segments = [
            replace(segment, hidden={term.id: hidden_state(segment, x, term)})
            for segment, x in zip(self.segments, link_states, strict=True)
        ]
        return replace(self, data=replace(self.data, link_states={term.id: link_states}), segments=tuple(segments))

    def residual(self, terms: Sequence[Term], theta: Array) -> Array:
        """Return measured minus predicted torque in every window (R,) [N m]."""
        return self.regression.balance(terms).error(theta)

    def errors(self, model: Model) -> Errors:
        """Return the errors of a model in torque, of each joint and of all, and in free-running position."""
        residual, body = self.residual(model.terms, model.theta), body_of(self.base)
        torque, position, fit = float(np.sqrt(np.mean(residual**2))), np.nan, np.nan
        torque = torque if len({*body.slides}) == 1 else np.nan  # no N m and N in one number
        joints, sizes = self.data.errors(residual), self.data.errors(self.data.torque())
        shares = {at: error / sizes[at] if sizes[at] else None for at, error in joints.items()}
        if self.segments and model.has_known_inertia:
            position = position_rms(self.segments, model.terms, model.theta)
            fit = _fit(position, deviation(self.segments))
        torque_fit = _fit(torque, float(np.std(self.data.applied_torque())))
        return Errors(torque, position, torque_fit, fit, joints, shares)


def _fit(error: float, deviation: float) -> float:
    """Return the fit in percent (100 % less NRMSE) from error and deviation; 0 without any deviation."""
    return 100.0 * (1.0 - error / deviation) if deviation > 0 else 0.0


def fit_terms(prepared: Comparable, terms: Sequence[Term]) -> tuple[Model, Fit]:
    """Fit the linear parameters of the terms; standard errors include the nonlinear parameters."""
    data, regression = prepared.data, prepared.regression
    terms = regression.converge(terms)
    balance = regression.balance(terms)
    theta = regression.solve(terms)
    jacobian, names = regression.nonlinear_jacobian(terms, theta)
    fit = balance.fit(data.clusters, jacobian if names else None, theta)
    count = len(theta)
    nonlinear_std = dict(zip(names, fit.std[count:].tolist(), strict=True))
    first_column = 0
    for term in terms:
        own = theta[first_column : first_column + len(term.columns)]
        first_column += len(term.columns)
        for parameter in term.nonlinear_parameters:
            if parameter.instant:
                here = data.where(term.at)
                weights, noise = data.weights[here], (fit.residual * balance.weights)[here]
                nonlinear_std[term.full(parameter.name)] = _placement(
                    regression, weights, term, parameter.name, own, noise
                )
    columns = [column.name for term in terms for column in term.columns]
    model = Model.build(terms, theta, fit.std[:count], **nonlinear_std)
    return model.correlated([*columns, *names], fit.covariance), fit


def base_inertia(regression: Regression) -> float:
    """Return the inertia of the joint by the base model, clear of impacts [kg m^2], which scales the noise."""
    data = regression.data
    if all(known := [w.recording.known_inertia for w in data.windows]):
        return max(known)
    theta = (Regression(data.clear) if data.impacts else regression).solve(BASE)
    return abs(float(theta[[term.id for term in BASE].index("inertia")]))


def with_impacts(
    prepared: tuple[PreparedData, PreparedData], terms: Sequence[Term], repeated: int = REPEATED
) -> tuple[PreparedData, PreparedData]:
    """Return training and held-out data with impacts at reversals, see `Dataset.with_impacts`.

    Data with fewer impacts than `repeated` stay as they are, since a single one may be an accident, and so do data for
    a model with a link, which has impacts of its own.
    """
    if has_link(terms):
        return prepared
    fit = fit_terms(prepared[0], terms)[1]
    count = len(fit.theta)
    known = terms, fit.theta, fit.covariance[:count, :count], base_inertia(prepared[0].regression)
    first, second = (replace(part, data=part.data.with_impacts(*known)) for part in prepared)
    return (first, second) if first.data.impacts >= repeated else prepared


def _placement(regression: Fits, weights: Array, term: Term, name: str, own: Array, noise: Array) -> float:
    """Return the standard error of an instant [s]: the displacement that changes the torque significantly.

    Few windows depend on the instant, none if the joint is at rest then, so that the fit may have no slope there. At
    one standard error the torque changes by one standard deviation.
    """
    instant = term.nonlinear_values[name]
    steps = np.geomspace(*PLACES, 30)
    variants = [replace(term, **{name: instant + sign * step}) for sign in (0, 1, -1) for step in steps]
    torque = np.array([(part.linear @ own + part.fixed) * weights for part in regression.columns(variants)])
    noticed = np.linalg.norm(torque[len(steps) :] - torque[0], axis=1) > np.std(noise)  # (2 x 30,)
    sides = [steps[np.argmax(side)] if side.any() else steps[-1] for side in noticed.reshape(2, -1)]
    return float(max(sides))
