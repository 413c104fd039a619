"""Batch and recursive least squares of the equations of a scheme over all recordings and joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from estimators.checks.torque_constant import widen_by_constant
from estimators.free_swings import remove_unit_inertia, restore_known
from estimators.regression.least_squares import (
    Equations,
    Fit,
    IdentificationError,
    compute_joint_rms,
    give,
    solve,
)
from estimators.regression.recursive import choose_indices, compute_history
from estimators.schemes.balance import Segments, Stack, find_momentum_columns, make_regressions, stack
from estimators.schemes.six import Regressor, Scheme
from pendulum_env._typing import JSON, Array, Index
from pendulum_env.arms.model import make_arm_model
from pendulum_env.notebook import render_html
from pendulum_env.physics import Estimate, Model, Term
from pendulum_env.recording import Recording, TorqueConstant
from pendulum_env.units import JointUnits

POINTS = 200  # of the history
FEWEST = 10  # clusters that hold motion, below which standard errors mean little


@dataclass(frozen=True, eq=False)
class Convergence:
    """Convergence of the estimates: the recursion of the paper at K instants.

    Attributes:
        time: seconds of recording taken in, one recording after the other (K,) [s].
        theta: (K, P), in the order of the model's columns; what was given stays as it is.
        std: standard errors (K, P), in the proportions of the recursion's P and ending at those of the model.
    """

    time: Array
    theta: Array
    std: Array

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {"time": self.time.tolist(), "theta": self.theta.tolist(), "std": self.std.tolist()}


@dataclass(frozen=True, eq=False, repr=False)
class Identified:
    """Estimates of one scheme.

    Attributes:
        scheme: its id.
        model: terms with estimates and standard errors that hold under correlated residuals.
        convergence: the recursive estimate on its way; it ends at the model up to P(0).
        residual_rms: the paper's norm (10) of the scheme's own residual, in `unit`.
        unit: of y and the residual.
        condition: condition number of the regressor, columns scaled to equal length.
        used: equations that were used, of all there are.
        residuals: the norm of each joint, or of all together, in `units`.
        units: of these.
    """

    scheme: str
    model: Model
    convergence: Convergence
    residual_rms: float
    unit: str
    condition: float
    used: tuple[int, int]
    residuals: tuple[float, ...] = ()
    units: tuple[str, ...] = ()

    @property
    def withheld(self) -> frozenset[str]:
        """Return the parameters without estimates, see the findings of the identification."""
        return frozenset(name for name, estimate in self.model.estimates.items() if estimate.is_unknown)

    def __repr__(self) -> str:
        told = (f"{name} {estimate.text}" for name, estimate in self.model.estimates.items())
        return f"<Identified by {self.scheme}: {', '.join(told)}>"

    def _repr_html_(self) -> str:
        return render_html(self)

    def convert_units(self, units: JointUnits) -> Identified:
        """Convert the estimates to another joint, or another unit of torque."""
        model, unit = remove_unit_inertia(self.model.convert_units(units)), units.unit
        return replace(self, model=model, unit=unit(self.unit), units=tuple(map(unit, self.units)))

    def with_known(self, terms: Sequence[Term], recordings: Sequence[Recording]) -> Identified:
        """Scale the results of free swings to a known parameter of the original terms, see `restore_known`."""
        model = restore_known(self.model, terms, recordings)
        return self if model is self.model else replace(self, model=model)

    def with_constant_error(self, constant: TorqueConstant, there: Model) -> Identified:
        """Add the standard error of the torque constant; one standard error more gives the parameters `there`."""
        model = widen_by_constant(self.model, constant, self.model, there)
        old, new = (np.array([e.std for e in m.estimates.values()])[: len(m.theta)] for m in (self.model, model))
        course = replace(self.convergence, std=self.convergence.std * (new / np.maximum(old, 1e-300)))
        return replace(self, model=model, convergence=course)

    def json(self) -> JSON:
        """Return a dictionary for JSON; withheld estimates are null."""
        theta = {
            name: {"value": None, "std": None, "unit": estimate.unit} if estimate.is_unknown else estimate.json()
            for name, estimate in self.model.estimates.items()
        }
        names = self.model.body.joints if len(self.units) > 1 else ("",)  # energies of joints add up
        own = zip(names, self.residuals, self.units, strict=True)
        joints = {name: {"rms": rms, "unit": unit} for name, rms, unit in own}
        together = joints[""] if "" in joints else {"rms": None, "unit": None}
        return {
            "theta": theta,
            "residual": {**together, "joints": joints},
            "condition": self.condition,
            "used": list(self.used),
            "convergence": self.convergence.json(),
        }


def join_names(recordings: Sequence[Recording]) -> str:
    """Join the names of recordings."""
    return ", ".join(recording.name for recording in recordings)


def fit_schemes(
    schemes: Sequence[Regressor],
    segments: Segments,
    terms: Sequence[Term],
    recordings: Sequence[Recording],
) -> dict[str, Identified]:
    """Fit each scheme to the segments of recordings."""
    joints, names, of = terms[0].mechanism.joints, join_names(recordings), make_regressions(terms)
    results: dict[str, Identified] = {}
    for scheme in schemes:
        data = stack(segments, partial(of, scheme), terms)
        if len(np.unique(data.clusters[data.usable])) < FEWEST:
            raise IdentificationError(
                f"{names}: too little of the motion is clear of stick and reversals: record longer, faster or wider "
                "motion"
            )
        hidden = np.setdiff1d(data.joint, data.joint[data.usable])
        if len(hidden):
            raise IdentificationError(
                f"{names}: joint '{joints[hidden[0]]}' is never clear of stick and reversals: record longer, "
                "faster or wider motion of it"
            )
        if scheme.borrows is not None and scheme.borrows not in results:
            raise ValueError(f"{scheme.id} borrows from {scheme.borrows}: put {scheme.borrows} before it")
        lender = results[scheme.borrows].model if scheme.borrows is not None else None
        results[scheme.id] = fit_equations(scheme, data, terms, lender)
    return results


def fit_equations(scheme: Regressor, data: Stack, terms: Sequence[Term], lender: Model | None = None) -> Identified:
    """Fit the equations: batch estimate with standard errors under correlated residuals, and the recursion.

    The inertia, or all that makes the momentum of an arm, is that of the lender; without one it is estimated.
    """
    columns = [column for term in terms for column in term.columns]
    loans = {j: lender.estimates[columns[j].name] for j in find_momentum_columns(terms)} if lender is not None else {}
    known = {j: Estimate(column.least, 0.0, column.unit) for j, column in enumerate(columns) if column.is_known}
    loans = {j: loan for j, loan in loans.items() if j not in known}
    use = data.usable
    clusters = np.unique(data.clusters[use], return_inverse=True)[1]
    while True:
        given: Mapping[int, Estimate] = loans | known
        free = [j for j in range(len(columns)) if j not in given]
        lent = np.array([estimate.value for estimate in given.values()])
        equations = give(data.equations, list(given), lent)
        # What was lent comes from the same data: its uncertainty widens that of the others
        jacobian = data.equations.phi[use][:, list(loans)] if loans else None
        fit = solve(Equations(equations.phi[use], equations.y[use]), data.weights[use], clusters, jacobian)
        values = dict(zip(free, fit.theta.tolist(), strict=True))
        left = [j for j, value in values.items() if not columns[j].is_allowed(value)]
        if not left:
            break
        known |= {j: Estimate(columns[j].clamp(values[j]), 0.0, columns[j].unit) for j in left}  # stays at its bound
    if scheme.drifts:
        fit = replace(fit, covariance=_compute_random_walk_covariance(equations, data, fit.theta))

    theta, std, count = np.empty(len(columns)), np.empty(len(columns)), len(free)
    theta[free], theta[list(given)] = fit.theta, lent
    std[free], std[list(given)] = fit.std[:count], [estimate.std for estimate in given.values()]
    model = Model.build(terms, theta, std).with_covariance(
        [columns[j].name for j in free], fit.covariance[:count, :count]
    )
    each = int(data.joint.max()) + 1  # equations of an instant, which the recursion takes one after the other
    last = (choose_indices(len(data.time) // each, POINTS) + 1) * each - 1
    return Identified(
        scheme=scheme.id,
        model=make_arm_model(model),
        convergence=_compute_convergence(equations, data, fit, free, theta, std, last),
        residual_rms=fit.rms,
        unit=scheme.unit,
        condition=fit.condition,
        used=(int(use.sum()), len(use)),
        residuals=tuple(compute_joint_rms(fit.residual, data.joint[use]).tolist()),
        units=_list_units(scheme, terms),
    )


def _list_units(scheme: Regressor, terms: Sequence[Term]) -> tuple[str, ...]:
    """Return the units of the residuals of the joints, or of their common balance."""
    body = terms[0].mechanism
    is_sum = isinstance(scheme, Scheme) and scheme.adds_up
    return (scheme.unit,) if is_sum else tuple(body.units(at).unit(scheme.unit) for at in body.joints)


def _compute_random_walk_covariance(equations: Equations, data: Stack, theta: Array) -> Array:
    """Compute the covariance (F, F) of a least-squares fit with errors that are sums of independent increments.

    theta - truth = (phi' phi)^-1 sum_k phi_k e_k with e_k = sum_{j <= k} d_j, and so = (phi' phi)^-1 sum_j d_j S_j with
    S_j the sum of phi from j to the end of the recording: one score for each cluster of increments.
    """
    weights = (data.weights * data.usable)[:, None]
    phi, error = equations.phi * weights, (equations.y - equations.phi @ theta) * data.usable
    ends, joints = [*data.starts[1:], len(error)], int(data.joint.max()) + 1
    rest, increment = np.empty_like(phi), np.empty_like(error)
    for begin, end in zip(data.starts, ends, strict=True):
        for own in (slice(first, end, joints) for first in range(begin, begin + joints)):  # each sums by itself
            rest[own] = np.cumsum((phi * weights)[own][::-1], axis=0)[::-1]
            increment[own] = np.diff(error[own], prepend=0.0)
    scores = np.zeros((int(data.clusters.max()) + 1, phi.shape[1]))
    np.add.at(scores, data.clusters, rest * increment[:, None])
    bread = np.linalg.pinv(phi.T @ phi, hermitian=True)
    covariance: Array = bread @ (scores.T @ scores) @ bread * (len(scores) / max(1, len(scores) - phi.shape[1]))
    return covariance


def _compute_convergence(
    equations: Equations, data: Stack, fit: Fit, free: Sequence[int], theta: Array, std: Array, points: Index
) -> Convergence:
    """Compute the history of the recursion, with P scaled to end at the standard errors of the batch estimate."""
    weighted = Equations(equations.phi * data.weights[:, None], equations.y * data.weights)
    course = compute_history(weighted, data.usable, points)
    spread = course.std  # (K, F)
    thetas, stds = np.tile(theta, (len(spread), 1)), np.tile(std, (len(spread), 1))
    thetas[:, free] = course.theta
    stds[:, free] = spread * fit.std[: len(free)] / spread[-1]
    return Convergence(data.time[course.points], thetas, stds)
