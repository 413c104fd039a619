"""Fits of models with standard errors of linear parameters, nonlinear parameters, and edges without derivatives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.settings import DATA
from estimators.decisions.criterion import Criterion
from estimators.regression.balance import Balance, place_columns
from estimators.regression.least_squares import Fit, compute_robust_covariance, project_out, solve_least_squares
from estimators.weak_form.columns import list_law_bounds, mark_bounds
from estimators.weak_form.floors import compute_noise_floor
from estimators.weak_form.nonlinear import find_edges, get_step_unit, set_values
from estimators.weak_form.rows import Terms
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import SIGNIFICANT, Estimate, Model, NonlinearParameter, Samples, Term, has_link


def fit_terms(data: RegressionData, terms: Terms) -> tuple[Model, Fit]:
    """Fit the linear parameters of the terms; return the model and the fit, with errors of all parameters.

    The covariance holds linear, then continuous nonlinear parameters; the latter keep their values. Parameters without
    derivatives (`find_edges`) have separate errors, outside the covariance.
    """
    terms, theta = data.maker.fit(terms, exactly=True)
    balance = _open_to_noise(data, terms, theta)
    jacobian, names = data.maker.nonlinear_jacobian(terms, theta)
    edges = find_term_edges(data, terms)
    is_smooth = _are_smooth(names, edges)
    payload = data.data.payload  # its parameters are estimated from the same rows
    extra = [jacobian[:, is_smooth], *([] if payload is None or not payload.columns.any() else [payload.columns])]
    fit = balance.fit(data.layout.clusters, np.column_stack(extra) if sum(part.size for part in extra) else None, theta)
    count = len(theta)
    with_error = np.flatnonzero(np.append(np.ones(count, dtype=bool), is_smooth))
    covariance = np.zeros((count + len(names),) * 2)
    covariance[np.ix_(with_error, with_error)] = fit.covariance[: len(with_error), : len(with_error)]
    fit = replace(fit, covariance=covariance)
    nonlinear_std = dict(zip(names, fit.std[count:].tolist(), strict=True))
    first_column = 0
    for term in terms:
        place = slice(first_column, first_column := first_column + len(term.columns))
        for parameter in edges[term]:
            std = _compute_edge_std(data, balance, fit, term, parameter, place)
            nonlinear_std[term.get_full_name(parameter.name)] = std
    columns = [column.name for term in terms for column in term.columns]
    model = Model.build(terms, theta, fit.std[:count], **nonlinear_std)
    return mark_bounds(model).with_covariance([*columns, *names], fit.covariance), fit


def find_inertia_of_noise(data: RegressionData, terms: Terms, criterion: Criterion) -> Estimate | None:
    """Fit the inertia of a pendulum with some terms, by which the noise floor differs from that of the data.

    The inertia scales encoder noise. A base model that lacks an effect may have another inertia, by which the windows
    were chosen. None is returned for a known or insignificant inertia, the same floor within
    `criterion.equal_error_share`, and a link, whose inertia is not that of the encoder's side.
    """
    if not data.layout.predicts_torque or has_link(terms) or all(w.inertia for w in data.data.windows):
        return None
    model = fit_terms(data, terms)[0]
    inertia = model.estimates.get("inertia")
    if inertia is None or not inertia.is_significant or inertia.value <= 0:
        return None
    inertia = replace(inertia, value=compute_inertia(model, data.samples))
    before = data.data.base_inertia
    floor, old_floor = (compute_noise_floor(data.data.windows, value) for value in (inertia.value, before))
    is_same = abs(inertia.value - before) <= SIGNIFICANT * inertia.std
    return None if is_same or abs(floor - old_floor) <= criterion.equal_error_share * old_floor else inertia


def compute_inertia(model: Model, x: Samples) -> float:
    """Return the root mean square over samples (N,) of the inertia of a model, which a payload may change [kg m^2]."""
    masses = [np.broadcast_to(column.mass(x), x.time.shape) for term in model.terms for column in term.columns]
    return float(np.sqrt(np.mean((model.theta @ masses) ** 2)))


def find_term_edges(data: RegressionData, terms: Terms) -> dict[Term, list[NonlinearParameter]]:
    """Return the parameters of each term by which its torque has no derivative."""
    is_torque = data.layout.predicts_torque
    return {term: find_edges(term, data.data.part(term.at).samples) if is_torque else [] for term in terms}


def _are_smooth(names: Sequence[str], edges: Mapping[Term, Sequence[NonlinearParameter]]) -> Mask:
    """Return the mask of the full names of parameters (S,) that are no edges."""
    scanned = {term.get_full_name(parameter.name) for term, parameters in edges.items() for parameter in parameters}
    return np.array([name not in scanned for name in names], dtype=bool)


@dataclass(frozen=True)
class LinearisedRows:
    """Weighted rows of a model, linear in its free parameters with derivatives.

    Attributes:
        names: full names of these parameters.
        slopes: weighted derivatives of the torque (R, S).
        weights: of the rows (R,).
        residual: weighted residual (R,).
    """

    names: list[str]
    slopes: Array
    weights: Array
    residual: Array


def linearise(data: RegressionData, model: Model) -> LinearisedRows:
    """Linearise the rows of a model in its parameters; known ones, those at their bounds and edges do not count."""
    terms, theta = model.terms, model.theta
    jacobian, names = data.maker.nonlinear_jacobian(terms, theta)
    names = [*(column.name for column in model.columns), *names]
    is_smooth = _are_smooth(names, find_term_edges(data, terms))
    is_free = np.array([model.estimates[name].std > 0 for name in names]) & is_smooth
    balance = data.equations(terms)
    slopes = balance.slopes(theta, jacobian)[:, is_free] * balance.weights[:, None]
    residual = balance.error(theta) * balance.weights
    return LinearisedRows(np.array(names)[is_free].tolist(), slopes, balance.weights, residual)


def compute_parameter_changes(data: RegressionData, model: Model, change: Array) -> dict[str, float]:
    """Return by how much the parameters of a model change, to first order, with the torque of the rows; by name.

    `change` (R,) is that of the torque [N m]. The residual has the same change, since the predicted torque follows from
    motion alone, also with load friction. A filter of torque among the terms is ignored. Known parameters, those at
    their bounds and edges do not change. A parameter that the motion determines more exactly than the rows changes by
    the rows' share of the information on it.
    """
    rows = linearise(data, model)
    steps = solve_least_squares(rows.slopes, change * rows.weights)
    of_rows = np.diag(compute_robust_covariance(rows.slopes, rows.residual, data.layout.clusters))
    stds = np.array([model.estimates[name].std for name in rows.names])
    shares = np.minimum(stds**2 / np.maximum(of_rows, 1e-300), 1.0)
    return dict(zip(rows.names, (shares * steps).tolist(), strict=True))


def _open_to_noise(data: RegressionData, terms: Terms, theta: Array) -> Balance:
    """Return the rows of the terms without the bounds at zero that parameters `theta` (P,) meet by noise alone.

    A parameter meets its bound by noise if its fit without the bound is not significant. Without it, it has an error.
    """
    balance, (least, _) = data.equations(terms), list_law_bounds(terms)
    is_at_bound = (theta == balance.least) & (least < balance.least)
    if not is_at_bound.any():
        return balance
    unbounded = fit_within_laws(data, terms)
    is_noise = np.array([not unbounded.estimates[column.name].is_significant for column in unbounded.columns])
    return balance.with_bounds(np.where(is_at_bound & is_noise, least, balance.least), balance.most)


def fit_within_laws(data: RegressionData, terms: Terms) -> Model:
    """Fit the linear parameters of the terms within bounds of the laws alone, so that inertia may be negative."""
    fit = data.equations(terms).with_bounds(*list_law_bounds(terms)).fit(data.layout.clusters)
    return Model.build(terms, fit.theta, fit.std)


def _compute_edge_std(
    data: RegressionData, balance: Balance, fit: Fit, term: Term, parameter: NonlinearParameter, of_term: slice
) -> float:
    """Return the standard error of an edge by profile likelihood: the larger of the likely displacements to both sides.

    A displacement is likely if the squared error of a fit with it exceeds the least by at most -2 ln(1 - sqrt(P)) times
    the variance. The limit is raised by the factor by which correlated residuals raise the variance of the term. The
    likelihood of an edge is not normal: one, two and three standard errors include the likely displacements of each P
    in `DATA.within`, and the next larger tried one. `of_term` are the columns of the term's parameters.

    Source: Hansen, Sample splitting and threshold estimation, Econometrica 68(3), 2000.
    """
    value, rows = term.nonlinear_values[parameter.name], data.locate_rows(term.at)
    unit = 1.0 if parameter.instant else get_step_unit(parameter, value)
    steps = unit * np.geomspace(*(DATA.instants if parameter.instant else DATA.edges), DATA.displacements)
    displacements = np.concatenate([[0.0], steps, -steps])
    variants = [set_values(term, [parameter], [value + displacement]) for displacement in displacements]
    parts = [
        place_columns(len(fit.residual), [(rows, np.column_stack([part.fixed, part.linear]))])
        for part in data.maker.columns(variants)
    ]
    slopes, w = balance.slopes(fit.theta), balance.weights[:, None]
    frame = np.linalg.qr(np.delete(slopes, np.arange(len(fit.theta))[of_term], axis=1) * w)[0]
    target_of_term = fit.residual + parts[0] @ np.append(1.0, fit.theta[of_term])
    squares = np.empty(len(parts))
    for k, part in enumerate(parts):
        outside = project_out(frame, w * np.column_stack([target_of_term - part[:, 0], part[:, 1:]]))
        target, columns = np.split(outside, [1], axis=1)
        squares[k] = np.sum((target - columns @ np.linalg.lstsq(columns, target)[0]) ** 2)
    variance = squares[0] / max(len(slopes) - slopes.shape[1], 1)
    uncorrelated = balance.fit(np.arange(len(slopes)), theta=fit.theta).std[of_term]
    ratio = np.divide(fit.std[of_term], uncorrelated, out=np.ones(len(uncorrelated)), where=uncorrelated > 0)
    variance_factor = np.max(ratio**2, initial=1.0)
    std = 0.0
    for multiple, probability in enumerate(DATA.within, 1):
        is_likely = squares - squares[0] < -2 * np.log(1 - np.sqrt(probability)) * variance * variance_factor
        next_larger = int(np.max(np.flatnonzero(is_likely[1:]) % len(steps), initial=-1)) + 1
        std = max(std, float(steps[min(next_larger, len(steps) - 1)]) / multiple)
    return std
