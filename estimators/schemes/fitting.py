"""Batch and recursive least squares of the equations of a scheme over all recordings and joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from estimators.data.standard_errors import widen_by_constant
from estimators.decisions.errors import encode_estimates
from estimators.free_swings import remove_unit_inertia
from estimators.regression.balance import Balance
from estimators.regression.least_squares import (
    Equations,
    IdentificationError,
    compute_joint_rms,
    subtract_known_columns,
)
from estimators.regression.recursive import choose_indices, compute_history
from estimators.schemes.balance import Segments, Stack, find_momentum_columns, make_regressions, stack_equations
from estimators.schemes.encoder_noise import copy_with_noise, correct_fit, measure_excess
from estimators.schemes.six import Regressor, Scheme
from estimators.weak_form.columns import list_law_bounds
from pendulum_env._typing import JSON, Array
from pendulum_env.notebook import Shown
from pendulum_env.physics import Model, Term
from pendulum_env.physics.model import complete_model
from pendulum_env.recording import Recording, TorqueConstant
from pendulum_env.units import JointUnits

HISTORY_POINTS = 200  # number of instants of the history
MIN_CLUSTERS = 10  # least number with motion; standard errors from fewer are inaccurate


@dataclass(frozen=True, eq=False)
class Convergence:
    """Convergence of the estimates: the recursion of the paper at K instants, without the correction for encoder noise.

    Attributes:
        time: total duration of the recordings up to the instant (K,) [s].
        theta: estimates (K, P), in the order of the model's columns; known and borrowed parameters are constant.
        std: standard errors of the recursion (K, P), scaled to end at those of the model.
    """

    time: Array
    theta: Array
    std: Array

    def json(self, names: Sequence[str]) -> JSON:
        """Return a dictionary for JSON, with the courses of the parameters by name."""
        courses = {
            quantity: dict(zip(names, values.T.tolist(), strict=True))
            for quantity, values in (("theta", self.theta), ("std", self.std))
        }
        return {"time": self.time.tolist(), **courses}


@dataclass(frozen=True, eq=False, repr=False)
class Identified(Shown):
    """Estimates of one scheme.

    Attributes:
        scheme: id of the scheme.
        model: terms with estimates, and standard errors under correlated residuals.
        convergence: history of the recursive estimates; it ends at the least-squares fit but for the effect of P(0).
        residual_rms: norm (10) of the paper, of the scheme's residual, in `unit`.
        unit: unit of y and the residual.
        condition: condition number of the regressor, columns scaled to equal length.
        used: numbers of used and of all equations.
        residuals: RMS residual of each joint, or of the summed balance, in `units`.
        units: units of `residuals`.
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
        """Return the names of parameters without an estimate; findings of the identification have the reasons."""
        return frozenset(name for name, estimate in self.model.estimates.items() if estimate.is_unknown)

    def __repr__(self) -> str:
        texts = (f"{name} {estimate.text}" for name, estimate in self.model.estimates.items())
        return f"<Identified by {self.scheme}: {', '.join(texts)}>"

    def convert_units(self, units: JointUnits) -> Identified:
        """Convert the estimates to another joint, or another unit of torque."""
        model, unit = remove_unit_inertia(self.model.convert_units(units)), units.unit
        return replace(self, model=model, unit=unit(self.unit), units=tuple(map(unit, self.units)))

    def with_constant_error(self, constant: TorqueConstant, changed: Model) -> Identified:
        """Add the standard error of the torque constant to those of the parameters.

        `changed` is the model fitted with the constant plus one standard error.
        """
        model = widen_by_constant(self.model, constant, changed.theta - self.model.theta)
        old, new = (np.array([e.std for e in m.estimates.values()])[: len(m.theta)] for m in (self.model, model))
        convergence = replace(self.convergence, std=self.convergence.std * (new / np.maximum(old, 1e-300)))
        return replace(self, model=model, convergence=convergence)

    def json(self) -> JSON:
        """Return a dictionary for JSON; withheld estimates are null."""
        names = self.model.mechanism.joints if len(self.units) > 1 else ("",)  # energies of joints add up
        rows = zip(names, self.residuals, self.units, strict=True)
        joints = {name: {"rms": rms, "unit": unit} for name, rms, unit in rows}
        total = joints[""] if "" in joints else {"rms": None, "unit": None}
        return {
            "theta": encode_estimates(self.model),
            "residual": {**total, "joints": joints},
            "condition": self.condition,
            "used": list(self.used),
            "convergence": self.convergence.json([column.name for column in self.model.columns]),
        }


def join_names(recordings: Sequence[Recording]) -> str:
    """Join the names of recordings."""
    return ", ".join(recording.name for recording in recordings)


def fit_schemes(
    schemes: Sequence[Regressor], segments: Segments, terms: Sequence[Term], recordings: Sequence[Recording]
) -> dict[str, Identified]:
    """Fit each scheme to the segments of recordings; return the results by id of the scheme.

    Estimates are corrected for encoder noise, if smoothing leaves too much of it; see `encoder_noise`.

    Raises:
        IdentificationError: if fewer than `MIN_CLUSTERS` clusters, or no sample of a joint, are clear of stick.
        ValueError: if a scheme borrows from a scheme that does not come before it.
    """
    joints, names, compute_regressions = terms[0].mechanism.joints, join_names(recordings), make_regressions(terms)
    results: dict[str, Identified] = {}
    copies = copy_with_noise(segments, recordings, terms)
    for scheme in schemes:
        data = stack_equations(segments, partial(compute_regressions, scheme), terms)
        if len(np.unique(data.clusters[data.usable])) < MIN_CLUSTERS:
            reach = max(m.reach * m.period for group in segments for joints in group for m in joints)
            raise IdentificationError(
                f"{names}: too little of the motion is clear of stick and reversals: the filter for this noise and "
                f"rate needs {reach:.2g} s on either side, and {data.usable.mean():.1%} of the samples have it. "
                "Record with less noise, at a higher rate, or longer, wider or slower motion; `diagnose` needs less"
            )
        idle_joints = np.setdiff1d(data.joint, data.joint[data.usable])
        if len(idle_joints):
            raise IdentificationError(
                f"{names}: joint '{joints[idle_joints[0]]}' is never clear of stick and reversals: record longer, "
                "faster or wider motion of it"
            )
        if scheme.borrows is not None and scheme.borrows not in results:
            raise ValueError(f"{scheme.id} borrows from {scheme.borrows}: put {scheme.borrows} before it")
        lender = results[scheme.borrows].model if scheme.borrows is not None else None
        noisy = [stack_equations(copy, partial(compute_regressions, scheme), terms).equations for copy in copies]
        excess = measure_excess(data.equations, noisy, data.weights, data.usable)
        results[scheme.id] = fit_equations(scheme, data, terms, lender, excess)
    return results


def fit_equations(
    scheme: Regressor, data: Stack, terms: Sequence[Term], lender: Model | None = None, excess: Array | None = None
) -> Identified:
    """Fit the equations: batch estimate with standard errors under correlated residuals, and the recursion.

    With a `lender`, the parameters of the momentum are taken from this model. The batch estimate is corrected for the
    `excess` of `measure_excess`; a remaining bias is marked.
    """
    names, usable = [column.name for term in terms for column in term.columns], data.usable
    (least, most), phi = list_law_bounds(terms), data.equations.phi[usable]
    borrowed = [] if lender is None else [j for j in find_momentum_columns(terms) if least[j] < most[j]]
    loans = [] if lender is None else [lender.estimates[names[j]] for j in borrowed]
    least[borrowed] = most[borrowed] = [loan.value for loan in loans]
    balance = Balance(phi, data.equations.y[usable], np.zeros_like(phi), least, most, data.weights[usable])
    # borrowed values come from the same data: their uncertainty widens that of the others
    clusters, lent = np.unique(data.clusters[usable], return_inverse=True)[1], phi[:, borrowed] if borrowed else None
    fit, correction = balance.fit(clusters, lent), None
    theta = fit.theta
    if excess is not None and len(excess):
        correction = correct_fit(balance, theta, excess)
        fit = balance.fit(clusters, lent, correction.theta)
        theta = fit.theta
    is_free = (theta > least) & (theta < most)
    free, held = np.flatnonzero(is_free).tolist(), np.flatnonzero(~is_free).tolist()
    equations = subtract_known_columns(data.equations, held, theta[held])
    covariance = fit.covariance[np.ix_(free, free)]
    if scheme.drifts:
        covariance = _compute_random_walk_covariance(equations, data, theta[free])
    if correction is not None:
        covariance = correction.widen(covariance)
    std = np.zeros(len(theta))
    std[free], std[borrowed] = np.sqrt(np.maximum(np.diag(covariance), 0.0)), [loan.std for loan in loans]
    model = Model.build(terms, theta, std).with_covariance([names[j] for j in free], covariance)
    model = model.mark_biased() if correction is not None and correction.has_bias else model
    return Identified(
        scheme=scheme.id,
        model=complete_model(model.mechanism, model),
        convergence=_compute_convergence(equations, data, free, theta, std),
        residual_rms=fit.rms,
        unit=scheme.unit,
        condition=fit.condition,
        used=(int(usable.sum()), len(usable)),
        residuals=tuple(compute_joint_rms(fit.residual, data.joint[usable]).tolist()),
        units=_list_units(scheme, terms),
    )


def _list_units(scheme: Regressor, terms: Sequence[Term]) -> tuple[str, ...]:
    """List the units of the residuals of the joints, or of their summed balance."""
    mechanism = terms[0].mechanism
    is_sum = isinstance(scheme, Scheme) and scheme.adds_up
    return (scheme.unit,) if is_sum else tuple(mechanism.units(at).unit(scheme.unit) for at in mechanism.joints)


def _compute_random_walk_covariance(equations: Equations, data: Stack, theta: Array) -> Array:
    """Compute the covariance (F, F) of a least-squares fit with errors that are sums of independent increments d.

    theta - truth = (phi' phi)^-1 sum_k phi_k e_k with e_k = sum_{j <= k} d_j, thus (phi' phi)^-1 sum_j d_j S_j, where
    S_j is the sum of phi from j to the end of the recording. Each cluster of increments gives one score.
    """
    weights = (data.weights * data.usable)[:, None]
    phi, error = equations.phi * weights, (equations.y - equations.phi @ theta) * data.usable
    ends, joints = [*data.starts[1:], len(error)], int(data.joint.max()) + 1
    later_phi, increment = np.empty_like(phi), np.empty_like(error)
    for begin, end in zip(data.starts, ends, strict=True):
        for first in range(begin, begin + joints):
            rows = slice(first, end, joints)  # of one joint
            later_phi[rows] = np.cumsum((phi * weights)[rows][::-1], axis=0)[::-1]
            increment[rows] = np.diff(error[rows], prepend=0.0)
    scores = np.zeros((int(data.clusters.max()) + 1, phi.shape[1]))
    np.add.at(scores, data.clusters, later_phi * increment[:, None])
    bread = np.linalg.pinv(phi.T @ phi, hermitian=True)
    covariance: Array = bread @ (scores.T @ scores) @ bread * (len(scores) / max(1, len(scores) - phi.shape[1]))
    return covariance


def _compute_convergence(
    equations: Equations, data: Stack, free: Sequence[int], theta: Array, std: Array
) -> Convergence:
    """Compute the history of the recursion at about `HISTORY_POINTS` instants.

    It ends at the estimates theta and std (P,); parameters that are not `free` stay at these.
    """
    n_joints = int(data.joint.max()) + 1  # equations of one instant
    points = (choose_indices(len(data.time) // n_joints, HISTORY_POINTS) + 1) * n_joints - 1
    weighted = Equations(equations.phi * data.weights[:, None], equations.y * data.weights)
    history = compute_history(weighted, data.usable, points)
    history_std = history.std  # (K, F)
    thetas, stds = np.tile(theta, (len(history_std), 1)), np.tile(std, (len(history_std), 1))
    thetas[:, free] = history.theta
    stds[:, free] = history_std * std[free] / history_std[-1]
    return Convergence(data.time[history.points], thetas, stds)
