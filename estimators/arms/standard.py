"""Standard parameters of an arm's links: of all bodies with the base parameters that were found, the likeliest.

Base parameters do not tell the mass of a link, but a simulator wants one. Each link's pseudo-inertia is written as
L L', which no choice of L makes impossible: mass is positive, and the moments of inertia are those of a body. Among
these, the one is taken that fits the base parameters by their standard errors and, where they leave it open, is near
the file.
Source: Rucker and Wensing, IEEE Robotics and Automation Letters 7(2), 2022 (log-Cholesky).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from pendulum_env._typing import JSON, Array
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import find_links
from pendulum_env.physics import Estimate, Model


@dataclass(frozen=True)
class NearestSettings:
    """Numbers of the search for the nearest body."""

    open: float = 1.0  # factors of e, and shares of a link's size, by which a body usually differs from the file
    smallest: float = 1e-9  # of a pseudo-inertia's trace, added so that a file's thin rod has a Cholesky factor too
    turns: int = 150  # evaluations at most: the search is slow where no body has the base parameters
    near: float = 3.0  # standard errors, to which noise, or the file, takes one of the parameters of a body
    least: float = 1e-6  # share of a base parameter that its standard error is at least: no file is more exact


NEAREST = NearestSettings()
DIAGONAL, BELOW = np.arange(4), np.tril_indices(4, -1)
ENTRIES = np.concatenate([DIAGONAL, BELOW[0]]), np.concatenate([DIAGONAL, BELOW[1]])  # ten, in the order of `_factors`


@dataclass(frozen=True)
class Nearest:
    """Links that exist, the nearest to base parameters that were found.

    Attributes:
        parameters: standard ones by name, `m@elbow`; without standard errors, as they hang on the file.
        distance: largest difference of a base parameter, in its standard errors.
        farthest: name of that parameter.
    """

    parameters: Mapping[str, Estimate]
    distance: float
    farthest: str

    @property
    def exists(self) -> bool:
        """Return whether some body has these parameters."""
        return self.distance <= NEAREST.near

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        theta = {name: own.value for name, own in self.parameters.items()}
        return {"distance": self.distance, "farthest": self.farthest, "theta": theta}


def nearest_body(model: Model) -> Nearest:
    """Find the links with the base parameters of a model, or the nearest ones if no body has them."""
    body = find_links(model.terms)
    count = len(body.base)
    theta, std = model.theta[:count], np.array([model.estimates[name].std for name in body.names])
    std = np.maximum(std, NEAREST.least * np.maximum(np.abs(theta), 1e-3 * np.abs(theta).max()))
    first, scale = _factors(body)
    links = len(body.links)

    def misfit(x: Array) -> Array:
        base = body.combine @ _standard(first + scale * x, links)
        return np.concatenate([(base - theta) / std, x / NEAREST.open])

    def slope(x: Array) -> Array:
        base = body.combine @ (_slope(first + scale * x, links) * scale)
        return np.vstack([base / std[:, None], np.eye(len(x)) / NEAREST.open])

    found = scipy.optimize.least_squares(misfit, np.zeros(len(first)), slope, x_scale="jac", max_nfev=NEAREST.turns)
    values = _standard(first + scale * found.x, links)
    parameters = {
        name: Estimate(own, 0.0, body.get_unit(name)) for name, own in zip(body.standard, values.tolist(), strict=True)
    }
    off = np.abs(body.combine @ values - theta) / std
    return Nearest(parameters, float(off.max()), body.names[int(off.argmax())])


def standard_parameters(model: Model) -> dict[str, Estimate]:
    """Return the standard parameters of the nearest body by name, `m@elbow`."""
    return dict(nearest_body(model).parameters)


def nearest_link(standard: Array, columns: Array) -> Array:
    """Return the parameters (10,) of a body that fit best, from those of a free fit; the same if these are a body's.

    Args:
        standard: of the free fit (10,).
        columns: of a regression (R, 10); the best fit has the least |columns (parameters - standard)|.
    """
    eigenvalues, axes = np.linalg.eigh(pseudo_inertia(standard))
    size = float(np.abs(eigenvalues).sum())
    if eigenvalues[0] > 0 or size == 0:
        return standard
    factor = np.linalg.cholesky((axes * np.maximum(eigenvalues, NEAREST.least * size)) @ axes.T)
    start = np.concatenate([np.log(np.diag(factor)), factor[BELOW]])
    triangle = np.linalg.qr(columns, mode="r")
    with np.errstate(over="ignore", invalid="ignore"):  # a step to infinite masses is refused, and shortened
        found = scipy.optimize.least_squares(
            lambda x: triangle @ (_standard(x, 1) - standard),
            start,
            lambda x: triangle @ _slope(x, 1),
            x_scale="jac",
            max_nfev=NEAREST.turns,
        )
    return _standard(found.x, 1)


def pseudo_inertia(standard: Array) -> Array:
    """Make the pseudo-inertia (4, 4) of a link from (m, m c, xx, xy, yy, xz, yz, zz) about the joint's origin.

    Its blocks are the second moments, the first moments and the mass.
    """
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = standard
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    h = np.array([[hx], [hy], [hz]])
    return np.block([[moments, h], [h.T, np.array([[m]])]])


def _factors(body: Body) -> tuple[Array, Array]:
    """Logarithms of the diagonals and rows below of each link's L, and of rotors; and how far each may usually move."""
    links = len(body.links)
    values, scales = [], []
    matrices = [pseudo_inertia(own) for own in body.standard_values[: 10 * links].reshape(links, 10)]
    largest = max([1e-3, *(float(np.trace(matrix)) for matrix in matrices)])
    for joint, matrix in zip(body.links, matrices, strict=True):
        if joint in body.impossible_links:  # the nearest that a body has, of a thousandth of the largest link at least
            own, axes = np.linalg.eigh(matrix)
            matrix = (axes * np.maximum(own, 1e-3 * largest)) @ axes.T
        factor = np.linalg.cholesky(matrix + NEAREST.smallest * np.trace(matrix) * np.eye(4))
        size = np.sqrt(np.diag(matrix))[BELOW[0]]
        values += [np.log(np.diag(factor)), factor[BELOW]]
        scales += [np.ones(4), np.maximum(size, 1e-3 * size.max())]
    rotors = body.standard_values[10 * links :]
    values.append(np.log(np.maximum(rotors, 1e-3)))
    scales.append(np.full(len(rotors), 10.0))  # rarely in a file
    return np.concatenate(values), np.concatenate(scales)


def _cholesky(x: Array, links: int) -> Array:
    """Return factors L (links, 4, 4) of logarithms and rows as in `_factors`."""
    own, factor = x[: 10 * links].reshape(links, 10), np.zeros((links, 4, 4))
    factor[:, DIAGONAL, DIAGONAL] = np.exp(own[:, :4])
    factor[:, BELOW[0], BELOW[1]] = own[:, 4:]
    return factor


def _ten(matrix: Array) -> Array:
    """Return standard parameters (..., 10) of pseudo-inertias (..., 4, 4), in which they are linear."""
    moments, h, m = matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3:, 3]
    inertia = np.trace(moments, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - moments
    return np.concatenate([m, h, inertia[..., [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]], axis=-1)


def _standard(x: Array, links: int) -> Array:
    """Return standard parameters (S,) of logarithms and rows as in `_factors`."""
    factor = _cholesky(x, links)
    return np.concatenate([np.ravel(_ten(factor @ factor.swapaxes(-1, -2))), np.exp(x[10 * links :])])


def _slope(x: Array, links: int) -> Array:
    """Return the derivative of standard parameters by the logarithms and rows (S, S)."""
    factor = _cholesky(x, links)
    moved = np.zeros((links, 10, 4, 4))  # of L
    moved[:, np.arange(10), *ENTRIES] = 1.0
    moved[:, DIAGONAL, DIAGONAL, DIAGONAL] = factor[:, DIAGONAL, DIAGONAL]
    turned = moved @ factor[:, None].swapaxes(-1, -2)  # half of L L'; the transpose is the other half
    own = _ten(turned + turned.swapaxes(-1, -2))  # (links, 10 of L, 10)
    return scipy.linalg.block_diag(*own.swapaxes(-1, -2), np.diag(np.exp(x[10 * links :])))
