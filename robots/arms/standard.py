"""Standard parameters of an arm's links: the likeliest body with the estimated base parameters.

Base parameters do not determine the mass of a link, which a simulator needs. Each link's pseudo-inertia is L L': for
any L, mass is positive and the moments of inertia are those of a body. L fits the base parameters by their standard
errors, and otherwise stays near the file.
Source: Rucker and Wensing, IEEE Robotics and Automation Letters 7(2), 2022 (log-Cholesky).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from pendulum_env._typing import JSON, Array
from pendulum_env.physics import Estimate, Model
from robots.arms.body import Body, find_body


@dataclass(frozen=True)
class NearestSettings:
    """Numbers of the search for the nearest body."""

    prior_std: float = 1.0  # standard deviation of the scaled factors about the file: factors of e, shares of the size
    added_trace: float = 1e-9  # added to the diagonal of a pseudo-inertia for a Cholesky factor, relative to its trace
    max_steps: int = 150  # largest number of evaluations, reached if no body has the base parameters
    max_distance: float = 3.0  # largest difference from the base parameters of an existing body [standard errors]
    min_std: float = 1e-6  # least standard error relative to a base parameter, by the precision of files


@dataclass(frozen=True)
class BarrierSettings:
    """Numbers of the barrier method for a possible link."""

    thinnest: float = 1e-3  # least eigenvalue of the start, relative to the sum of all
    ridge: float = 1e-6  # cost of a change of the start by its own size, relative to the start's cost
    thick: float = 0.1  # least eigenvalue of this size, relative to the sum of all
    shrinking: float = 0.1  # factor on the weight of the barrier from one minimum to the next
    excess: float = 1e-3  # cost of the result above the least one, relative to it
    stages: int = 40  # largest number of weights
    steps: int = 30  # largest number of Newton steps to each minimum
    lengths: tuple[float, ...] = tuple(0.5**k for k in range(30))  # tried lengths of a step


NEAREST, BARRIER = NearestSettings(), BarrierSettings()
DIAGONAL, BELOW = np.arange(4), np.tril_indices(4, -1)  # entries of a factor L (4, 4)
# the ten entries in the order of `_factorise_links`
ENTRIES = np.concatenate([DIAGONAL, BELOW[0]]), np.concatenate([DIAGONAL, BELOW[1]])


@dataclass(frozen=True)
class Nearest:
    """Possible links that are nearest to estimated base parameters.

    Attributes:
        parameters: standard parameters by name, `m@elbow`; without standard errors, since they depend on the file.
        distance: largest difference of a base parameter, in its standard errors.
        farthest: name of this parameter.
    """

    parameters: Mapping[str, Estimate]
    distance: float
    farthest: str

    @property
    def exists(self) -> bool:
        """Return whether a body has the estimated base parameters within `NEAREST.max_distance`."""
        return self.distance <= NEAREST.max_distance

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        theta = {name: estimate.value for name, estimate in self.parameters.items()}
        return {"distance": self.distance, "farthest": self.farthest, "theta": theta}


def nearest_body(model: Model) -> Nearest:
    """Find the links with the base parameters of a model, or the nearest links if no body has them."""
    body = find_body(model.terms)
    count = len(body.base)
    theta, std = model.theta[:count], np.array([model.estimates[name].std for name in body.names])
    std = np.maximum(std, NEAREST.min_std * np.maximum(np.abs(theta), 1e-3 * np.abs(theta).max()))
    values = fit_possible_links(body, body.combine / std[:, None], theta / std)
    parameters = {
        name: Estimate(value, 0.0, body.get_unit(name))
        for name, value in zip(body.standard, values.tolist(), strict=True)
    }
    distance = np.abs(body.combine @ values - theta) / std
    return Nearest(parameters, float(distance.max()), body.names[int(distance.argmax())])


def fit_possible_links(body: Body, columns: Array, target: Array) -> Array:
    """Return the standard parameters (S,) of possible links with the least |columns standard - target|, near the file.

    `columns` (R, S) and `target` (R,) are in standard errors.
    """
    start, scale = _factorise_links(body)
    n_links = len(body.links)

    def compute_misfit(x: Array) -> Array:
        misfit = columns @ _compute_standard(start + scale * x, n_links) - target
        return np.concatenate([misfit, x / NEAREST.prior_std])

    def compute_slope(x: Array) -> Array:
        slopes = columns @ (_differentiate_standard(start + scale * x, n_links) * scale)
        return np.vstack([slopes, np.eye(len(x)) / NEAREST.prior_std])

    solution = scipy.optimize.least_squares(
        compute_misfit, np.zeros(len(start)), compute_slope, x_scale="jac", max_nfev=NEAREST.max_steps
    )
    return _compute_standard(start + scale * solution.x, n_links)


def standard_parameters(model: Model) -> dict[str, Estimate]:
    """Return the standard parameters of the nearest body by name, `m@elbow`."""
    return dict(nearest_body(model).parameters)


def find_nearest_link(standard: Array, columns: Array) -> Array:
    """Find the parameters (10,) of a possible body with the least |columns (parameters - standard)|.

    A possible free fit is returned unchanged. Else the problem is convex, since the pseudo-inertia J is linear in the
    parameters. A barrier -w log det J keeps it positive. A small cost of the distance from the start keeps the
    directions that the columns do not determine.
    Source: Boyd and Vandenberghe, Convex Optimization, 2004, chapter 11.

    Args:
        standard: parameters of the free fit (10,).
        columns: columns of a regression (R, 10).
    """
    eigenvalues, axes = np.linalg.eigh(make_pseudo_inertia(standard))
    size = float(np.abs(eigenvalues).sum())
    if eigenvalues[0] > 0 or size == 0:
        return standard
    units = np.array([make_pseudo_inertia(unit) for unit in np.eye(len(standard))])  # (10, 4, 4)
    hessian = columns.T @ columns
    best = start = _extract_parameters((axes * np.maximum(eigenvalues, BARRIER.thinnest * size)) @ axes.T)
    weight = 0.5 * float((start - standard) @ hessian @ (start - standard))
    if weight == 0:
        return start
    thick = (axes * np.maximum(eigenvalues, BARRIER.thick * size)) @ axes.T
    relative = np.linalg.solve(thick, units)
    ridge = BARRIER.ridge * weight * np.einsum("iab,jba->ij", relative, relative)

    def compute_cost(values: Array, weight: float) -> float:
        least = np.linalg.eigvalsh(make_pseudo_inertia(values))
        if least[0] <= 0:
            return np.inf
        distance, moved = values - standard, values - start
        return float(0.5 * (distance @ hessian @ distance + moved @ ridge @ moved) - weight * np.log(least).sum())

    for _ in range(BARRIER.stages):
        for _ in range(BARRIER.steps):
            shares = np.linalg.solve(make_pseudo_inertia(best), units)
            slope = hessian @ (best - standard) + ridge @ (best - start) - weight * np.trace(shares, axis1=1, axis2=2)
            curvature = hessian + ridge + weight * np.einsum("iab,jba->ij", shares, shares)
            scale = 1.0 / np.sqrt(np.diag(curvature))
            step = -scale * np.linalg.solve(curvature * np.outer(scale, scale), scale * slope)
            candidates = [best, *(best + step * length for length in BARRIER.lengths)]
            best = min(candidates, key=lambda values: compute_cost(values, weight))
            if best is candidates[0] or -(slope @ step) < weight:
                break
        if len(axes) * weight <= BARRIER.excess * compute_cost(best, 0.0):
            break
        weight *= BARRIER.shrinking
    return np.asarray(best)


def make_pseudo_inertia(standard: Array) -> Array:
    """Build the pseudo-inertia (4, 4) of a link from (m, m c, xx, xy, yy, xz, yz, zz) about the joint's origin.

    Its blocks are the second moments, the first moments and the mass.
    """
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = standard
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    h = np.array([[hx], [hy], [hz]])
    return np.block([[moments, h], [h.T, np.array([[m]])]])


def _factorise_links(body: Body) -> tuple[Array, Array]:
    """Factorise the links of the file; return the entries of their factors and the scales of these entries (S,).

    Entries of a link are the logarithms of the diagonal of L, then the rows below. The logarithms of the rotors'
    inertias are last. A scale is a typical difference from the file.
    """
    links = len(body.links)
    values, scales = [], []
    matrices = [make_pseudo_inertia(standard) for standard in body.standard_values[: 10 * links].reshape(links, 10)]
    largest = max([1e-3, *(float(np.trace(matrix)) for matrix in matrices)])
    for joint, matrix in zip(body.links, matrices, strict=True):
        if joint in body.impossible_links:  # use the nearest possible matrix
            eigenvalues, axes = np.linalg.eigh(matrix)
            matrix = (axes * np.maximum(eigenvalues, 1e-3 * largest)) @ axes.T
        factor = np.linalg.cholesky(matrix + NEAREST.added_trace * np.trace(matrix) * np.eye(4))
        size = np.sqrt(np.diag(matrix))[BELOW[0]]
        values += [np.log(np.diag(factor)), factor[BELOW]]
        scales += [np.ones(4), np.maximum(size, 1e-3 * size.max())]
    rotors = body.standard_values[10 * links :]
    values.append(np.log(np.maximum(rotors, 1e-3)))
    scales.append(np.full(len(rotors), 10.0))  # wide, since files rarely have them
    return np.concatenate(values), np.concatenate(scales)


def _build_factors(x: Array, links: int) -> Array:
    """Return the factors L (links, 4, 4) of entries x (S,) as in `_factorise_links`."""
    entries, factor = x[: 10 * links].reshape(links, 10), np.zeros((links, 4, 4))
    factor[:, DIAGONAL, DIAGONAL] = np.exp(entries[:, :4])
    factor[:, BELOW[0], BELOW[1]] = entries[:, 4:]
    return factor


def _extract_parameters(matrix: Array) -> Array:
    """Return standard parameters (..., 10) of pseudo-inertias (..., 4, 4), in which they are linear."""
    moments, h, m = matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3:, 3]
    inertia = np.trace(moments, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - moments
    return np.concatenate([m, h, inertia[..., [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]], axis=-1)


def _compute_standard(x: Array, links: int) -> Array:
    """Return the standard parameters (S,) of entries x (S,) as in `_factorise_links`."""
    factor = _build_factors(x, links)
    return np.concatenate([np.ravel(_extract_parameters(factor @ factor.swapaxes(-1, -2))), np.exp(x[10 * links :])])


def _differentiate_standard(x: Array, links: int) -> Array:
    """Return the derivatives of the standard parameters by the entries x as in `_factorise_links` (S, S)."""
    factor = _build_factors(x, links)
    d_factor = np.zeros((links, 10, 4, 4))  # of L
    d_factor[:, np.arange(10), *ENTRIES] = 1.0
    d_factor[:, DIAGONAL, DIAGONAL, DIAGONAL] = factor[:, DIAGONAL, DIAGONAL]
    half = d_factor @ factor[:, None].swapaxes(-1, -2)  # half of L L'; the transpose is the other half
    d_standard = _extract_parameters(half + half.swapaxes(-1, -2))  # (links, 10 of L, 10)
    return scipy.linalg.block_diag(*d_standard.swapaxes(-1, -2), np.diag(np.exp(x[10 * links :])))
