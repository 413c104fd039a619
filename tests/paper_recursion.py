"""The paper's recursion as it is printed, with which the recursions are compared."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.regression.recursive import PRIOR
from pendulum_env._typing import Array


class State(NamedTuple):
    """What the recursion remembers: theta (P,), covariance for unit noise P (P, P), last a-priori error."""

    theta: Array
    P: Array
    error: float = 0.0


def start(parameters: int, prior: float = PRIOR) -> State:
    """State before the first equation: theta(0) = 0, P(0) = prior I."""
    return State(np.zeros(parameters), prior * np.eye(parameters))


def step(state: State, phi: Array, y: float) -> State:
    """Take in one equation y = phi' theta, phi (P,). Source: the paper's (6), where P is p x p."""
    theta, P, _ = state
    # e = y - phi' theta, the a-priori error
    error = y - phi @ theta
    # K = P phi / (1 + phi' P phi)
    K = P @ phi / (1.0 + phi @ P @ phi)
    # P = (I - K phi') P, in Joseph's form (I - K phi') P (I - K phi')' + K K', which stays symmetric and positive
    shrink = np.eye(len(theta)) - np.outer(K, phi)
    return State(theta + K * error, shrink @ P @ shrink.T + np.outer(K, K), float(error))
