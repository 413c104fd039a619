"""Fits of a torque balance without each fold of its equations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from estimators.regression.balance import Balance, condense_linear_rows
from estimators.regression.least_squares import SOLVER, solve_gram, sum_without_each
from estimators.regression.response import TorqueResponse
from pendulum_env._typing import Array, Index, Mask


def solve_without(balance: Balance, fold: Index, count: int, theta: Array | None = None) -> Array:
    """Fit parameters (K, P) without each of `count` folds, from the fold of each equation (R,).

    The fit without a fold is one step from the fit to all, by normal equations. It is iterated if the squared error
    differs from that of the tangent. `theta` (P,) is the fit to all equations, solved unless given.
    """
    equations, fold_of_condensed = _condense_folds(balance, fold, count)
    tangent = equations.linearise(theta)
    rows = np.column_stack([tangent.error, tangent.slopes]) * equations.weights[:, None]
    parts = [rows[fold_of_condensed == k] for k in range(count)]
    parameters = np.empty((count, len(tangent.theta)))
    for k, gram in enumerate(sum_without_each(np.array([part.T @ part for part in parts]))):
        step = solve_gram(gram, balance.least - tangent.theta, balance.most - tangent.theta)
        if step is not None:
            parameters[k] = np.clip(tangent.theta + step, balance.least, balance.most)
            combination = np.append(1.0, -step)
            square = float(combination @ gram @ combination)
            if balance.is_linear or is_near_tangent(balance, parameters[k], fold != k, square):
                continue
        parameters[k] = equations[fold_of_condensed != k].solve(tangent.theta)
    return parameters


def is_near_tangent(balance: Balance, theta: Array, rows: Mask, square: float) -> bool:
    """Return whether the squared weighted error of some rows (R,) at parameters (P,) is close to `square`.

    `square` is the squared error by the tangent; close is a log likelihood within `SOLVER.unlikelier` [nat].
    """
    squared_error = float(np.sum((balance.weights * balance.error(theta))[rows] ** 2))
    return bool(np.count_nonzero(rows) * abs(squared_error - square) < 2 * SOLVER.unlikelier * max(square, 1e-300))


def _condense_folds(balance: Balance, fold: Index, count: int) -> tuple[Balance, Index]:
    """Condense the linear equations of each fold, see `condense_linear_rows`.

    Returns:
        The equations, and the fold of each.
    """
    parts = [condense_linear_rows(balance[fold == k]) for k in range(count)]
    names = ["phi", "y", "by_torque", "weights"]
    condensed_arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    responses = [part.response for part in parts if part.response is not None]
    if responses:
        condensed_arrays["response"] = TorqueResponse.join(responses)
    shares = [np.broadcast_to(part.torque_share, part.y.shape) for part in parts]
    of_part = np.repeat(np.arange(count), [len(part.y) for part in parts])
    return replace(balance, **condensed_arrays, torque_share=np.concatenate(shares), unfiltered=None), of_part
