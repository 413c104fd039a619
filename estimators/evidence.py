"""One body of evidence: recordings as windowed equations for fitting and as flights for simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.dataset import Dataset, prepare
from estimators.free_running import Flights, position_rms, take_off
from estimators.least_squares import Fit, solve
from estimators.shapes import continuous
from estimators.shots import has_link, hidden_state, link_of, watch
from estimators.windows import WHOLE, Part
from pendulum_env._typing import JSON, Array
from pendulum_env.physics import Model, Samples, Term
from pendulum_env.recording import Recording

PLACES = (1e-3, 10.0)  # [s], distances that an instant is moved by to see who notices


@dataclass(frozen=True)
class Errors:
    """How far a model is from a recording.

    Attributes:
        torque_rms: the paper's norm (10) of measured minus modelled torque over the windows used [N m].
        position_rms: free-running simulation against measured position over one-second windows [rad].
    """

    torque_rms: float
    position_rms: float

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {"torque_rms": self.torque_rms, "position_rms": self.position_rms}


@dataclass(frozen=True)
class Evidence:
    """Recordings, ready to be compared with models."""

    data: Dataset
    flights: tuple[Flights, ...]

    @classmethod
    def of(
        cls, recordings: Sequence[Recording], half_widths: Sequence[float] | None = None, part: Part = WHOLE
    ) -> Evidence:
        """Prepare recordings, or a part of each; raises IdentificationError if they hold too little motion."""
        data = prepare(recordings, half_widths, part)
        return cls(data, tuple(take_off(w) for w in data.windows))

    @property
    def samples(self) -> Samples:
        """Samples at the windows' centres, (R,) each."""
        return self.data.samples

    def watching(self, model: Model) -> Evidence:
        """The same with the link of the model's transmission, if it has one, as the motion around each instant tells.

        Carried along the measured motion from the start, its state is lost after a few bounces. Takes a second or two.
        """
        if not has_link(model.terms):
            return self
        term = link_of(model.terms)
        watched = [watch(windows, model) for windows in self.data.windows]
        flights = [
            replace(flight, hidden={term.id: hidden_state(flight, x, term)})
            for flight, x in zip(self.flights, watched, strict=True)
        ]
        return replace(self, data=replace(self.data, watched={term.id: watched}), flights=tuple(flights))

    def residual(self, terms: Sequence[Term], theta: Array) -> Array:
        """Measured minus modelled torque in every window (R,) [N m]."""
        equations = self.data.equations(terms)
        return equations.y - equations.phi @ theta

    def errors(self, model: Model) -> Errors:
        """Errors of a model, in torque and in free-running position."""
        residual = self.residual(model.terms, model.theta)
        return Errors(float(np.sqrt(np.mean(residual**2))), position_rms(self.flights, model.terms, model.theta))


def fit_terms(evidence: Evidence, terms: Sequence[Term]) -> tuple[Model, Fit]:
    """Fit the linear parameters of the terms; standard errors count the search over shape parameters too."""
    equations = evidence.data.equations(terms)
    weights, clusters = evidence.data.weights, evidence.data.clusters
    first = solve(equations, weights, clusters)
    jacobian, names = _shape_jacobian(evidence.data, terms, first.theta)
    fit = solve(equations, weights, clusters, jacobian) if names else first
    count = len(fit.theta)
    shape_std = dict(zip(names, fit.std[count:].tolist(), strict=True))
    first_column = 0
    for term in terms:
        own = fit.theta[first_column : first_column + len(term.columns)]
        first_column += len(term.columns)
        for shape in term.shapes:
            if shape.instant:
                noise = fit.residual * weights
                shape_std[f"{term.id}.{shape.name}"] = _placement(evidence.data, term, shape.name, own, noise)
    return Model.build(terms, fit.theta, fit.std[:count], **shape_std), fit


def _placement(data: Dataset, term: Term, name: str, own: Array, noise: Array) -> float:
    """Standard error of an instant [s]: how far it may be moved before the windows that notice speak against it.

    Few windows tell when something happened, none if the joint is at rest then, so that the fit has no slope there to
    judge by. One standard error away, the likelihood has fallen by half: the torque changes by one standard deviation.
    """
    instant = term.shape[name]
    steps = np.geomspace(*PLACES, 30)
    variants = [replace(term, **{name: instant + sign * step}) for sign in (0, 1, -1) for step in steps]
    torque = np.array([(linear @ own + fixed) * data.weights for linear, fixed in data.columns(variants)])
    noticed = np.linalg.norm(torque[len(steps) :] - torque[0], axis=1) > np.std(noise)  # (2 x 30,)
    sides = [steps[np.argmax(side)] if side.any() else steps[-1] for side in noticed.reshape(2, -1)]
    return float(max(sides))


def _shape_jacobian(data: Dataset, terms: Sequence[Term], theta: Array) -> tuple[Array, list[str]]:
    """Derivatives (R, S) of the modelled torque with respect to continuous shape parameters, and their names."""
    derivatives, names, first = [np.empty((len(data.weights), 0))], [], 0
    for term in terms:
        own = theta[first : first + len(term.columns)]
        first += len(term.columns)
        for shape in continuous(term):
            value = term.shape[shape.name]
            # symmetric difference over a step that is small against the value and safe against rounding
            step = 1e-3 * max(abs(value), 1e-6)
            ends = [
                linear @ own + fixed
                for linear, fixed in data.columns([replace(term, **{shape.name: value + d}) for d in (step, -step)])
            ]
            derivatives.append(((ends[0] - ends[1]) / (2 * step))[:, None])
            names.append(f"{term.id}.{shape.name}")
    return np.column_stack(derivatives), names
