"""Fits of models with standard errors: of linear parameters, of nonlinear ones, and of those without slopes."""

from dataclasses import replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.rows import Terms
from estimators.regression.balance import Balance, place_columns
from estimators.regression.least_squares import Fit, project_out
from estimators.weak_form.columns import bounds_of_laws, mark_bounds
from estimators.weak_form.nonlinear import find_edges, get_step_unit, set_values
from pendulum_env._typing import Array
from pendulum_env.physics import Model, NonlinearParameter, Term

INSTANTS, EDGES = (1e-3, 10.0), (1e-5, 0.7)  # displacements of an instant [s], and relative ones, for an error
DISPLACEMENTS, ONE_SIGMA = 40, 0.6827  # number of these, and probability of one standard error


def fit_terms(data: RegressionData, terms: Terms) -> tuple[Model, Fit]:
    """Fit the linear parameters of the terms; standard errors include the nonlinear parameters."""
    terms, theta = data.fit(terms, exactly=True)
    balance = _open_to_noise(data, terms, theta)
    jacobian, names = data.maker.nonlinear_jacobian(terms, theta)
    is_torque = data.layout.predicts_torque  # positions have slopes also by a parameter at which a law jumps
    edges = {term: find_edges(term, data.data.part(term.at).samples) if is_torque else [] for term in terms}
    scanned = {term.get_full_name(parameter.name) for term in terms for parameter in edges[term]}
    is_smooth = np.array([name not in scanned for name in names], dtype=bool)
    payload = data.data.payload  # its parameters are identified from the same rows, so their columns are fitted as well
    more = [jacobian[:, is_smooth], *([] if payload is None or not payload.columns.any() else [payload.columns])]
    fit = balance.fit(data.layout.clusters, np.column_stack(more) if sum(own.size for own in more) else None, theta)
    count = len(theta)
    kept = np.flatnonzero(np.append(np.ones(count, dtype=bool), is_smooth))
    covariance = np.zeros((count + len(names),) * 2)  # an edge converges so fast that the others have theirs beside it
    covariance[np.ix_(kept, kept)] = fit.covariance[: len(kept), : len(kept)]
    fit = replace(fit, covariance=covariance)
    nonlinear_std = dict(zip(names, fit.std[count:].tolist(), strict=True))
    first_column = 0
    for term in terms:
        own = slice(first_column, first_column := first_column + len(term.columns))
        for parameter in edges[term]:
            std = _std_of_edge(data, balance, fit, term, parameter, own)
            nonlinear_std[term.get_full_name(parameter.name)] = std
    columns = [column.name for term in terms for column in term.columns]
    model = Model.build(terms, theta, fit.std[:count], **nonlinear_std)
    return mark_bounds(model).with_covariance([*columns, *names], fit.covariance), fit


def _open_to_noise(data: RegressionData, terms: Terms, theta: Array) -> Balance:
    """Return the rows of the terms, without bounds of a body at which noise alone has put parameters (P,).

    Such a parameter has a standard error as any other: one that is zero by its bound is no less uncertain.
    """
    balance, (least, _) = data.equations(terms), bounds_of_laws(terms)
    held = (theta == balance.least) & (least < balance.least)
    if not held.any():
        return balance
    free = fit_within_laws(data, terms)
    is_noise = np.array([not free.estimates[column.name].is_significant for column in free.columns])
    return balance.with_bounds(np.where(held & is_noise, least, balance.least), balance.most)


def fit_within_laws(data: RegressionData, terms: Terms) -> Model:
    """Fit the linear parameters of the terms without the bounds of a body, to find symptoms of wrong data.

    Torque that is logged turned round needs negative inertia, and a law that is missing may need friction that drives.
    """
    fit = data.equations(terms).with_bounds(*bounds_of_laws(terms)).fit(data.layout.clusters)
    return Model.build(terms, fit.theta, fit.std)


def _std_of_edge(
    data: RegressionData, balance: Balance, fit: Fit, term: Term, parameter: NonlinearParameter, own: slice
) -> float:
    """Return the standard error of a parameter without slopes, by its profile likelihood: the largest displacement on
    either side under which the residual is no significantly larger one.

    Twice the logarithm of the likelihood ratio of an edge at its true value is the larger of two independent
    exponential variables of mean 2, which is below -2 ln(1 - sqrt(P)) with probability P. As under all standard errors,
    residuals may be correlated: the ratio is divided by the factor by which that raises the variance of the term. `own`
    is the place of the linear parameters of the term.
    Source: Hansen, Sample splitting and threshold estimation, Econometrica 68(3), 2000.
    """
    value, here = term.nonlinear_values[parameter.name], data.locate_rows(term.at)
    unit = 1.0 if parameter.instant else get_step_unit(parameter, value)
    steps = unit * np.geomspace(*(INSTANTS if parameter.instant else EDGES), DISPLACEMENTS)
    variants = [set_values(term, [parameter], [value + sign * step]) for sign in (0, 1, -1) for step in steps]
    parts = [
        place_columns(len(fit.residual), [(here, np.column_stack([part.fixed, part.linear]))])
        for part in data.columns(variants)
    ]
    slopes, w = balance.slopes(fit.theta), balance.weights[:, None]
    others = np.linalg.qr(np.delete(slopes, np.arange(len(fit.theta))[own], axis=1) * w)[0]
    net = fit.residual + parts[0] @ np.append(1.0, fit.theta[own])
    squares = np.empty(len(parts))
    for k, part in enumerate(parts):
        left, columns = np.split(project_out(others, w * np.column_stack([net - part[:, 0], part[:, 1:]])), [1], axis=1)
        squares[k] = np.sum((left - columns @ np.linalg.lstsq(columns, left)[0]) ** 2)
    variance = squares[0] / max(len(slopes) - slopes.shape[1], 1)
    alone = balance.fit(np.arange(len(slopes)), theta=fit.theta).std[own]
    ratio = np.divide(fit.std[own], alone, out=np.ones(len(alone)), where=alone > 0)
    correlated = np.max(ratio**2, initial=1.0)
    is_likely = squares - squares[0] < -2 * np.log(1 - np.sqrt(ONE_SIGMA)) * variance * correlated
    sides = is_likely[len(steps) :].reshape(2, -1)
    last = [int(np.max(np.flatnonzero(side), initial=-1)) for side in sides]
    return float(max(steps[min(k + 1, len(steps) - 1)] for k in last))
