"""Online correction of estimates for encoder noise in the regressor, which biases least squares.

Each equation is also computed with noise of the same variance added to the position, and with its negative added. The
sums of phi phi' and phi y of these copies exceed those of the measured motion, on average by D and d. To second order,
noise of the encoder makes the same difference between the measured and the true motion. So with J = 1 / P,

    (J - D) (theta + correction) = J theta - d .

This holds for any scheme and any term. Without motion, the correction does not change.

Source: Cook and Stefanski, Journal of the American Statistical Association 89, 1994 (extrapolation of added noise).
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from estimators.online.recursion import RecursionState, expand_triangle
from estimators.regression.noise import UNCERTAINTY, limit_noise
from pendulum_env._typing import Array, Mask
from pendulum_env.physics.compiled import Machine, SymbolicStep
from pendulum_env.physics.symbols import make_symbols

COPIES = np.array([[0.0], [1.0], [-1.0]])  # of an equation: as measured, with added noise, and with its negative


class Correction(NamedTuple):
    """Correction of theta (B, S, P), and the square of the bias that it may leave (B, S, P, P)."""

    step: Array
    bias: Array

    @classmethod
    def none(cls) -> "Correction":
        """Return a correction by zero."""
        return cls(np.zeros(1), np.zeros(1))


class NoiseBias:
    """Sums of the excess by noise for (B, S) regressions with P parameters each."""

    def __init__(self, batch: tuple[int, int], parameters: int, forgetting: float) -> None:
        """Create the sums with the forgetting factor of the recursion."""
        self._machine = Machine(_add_excess, (parameters + 1, forgetting), *batch[::-1])

    def reset(self, which: Mask) -> None:
        """Restart plants (B,)."""
        self._machine.reset(which)

    def take(self, copies: Array, usable: Mask) -> None:
        """Add one equation of each regression, phi and y (C, B, S, P + 1), where usable (B, S).

        Without noise, `copies` has one entry, and the excess is zero.
        """
        if len(copies) < len(COPIES):
            return
        inputs = self._machine.inputs
        inputs["copies"][:], inputs["used"].T[:] = copies.transpose(0, 3, 2, 1), usable
        self._machine.step()

    def make_correction(self, state: RecursionState) -> Callable[[], Correction]:
        """Make a function that computes the correction of estimates at any time."""
        return functools.partial(_compute_correction, self._machine.states["excess"].copy().T, state)


@functools.cache
def _add_excess(size: int, forgetting: float) -> SymbolicStep:
    """Build the sum of the excess of products of phi and y by noise, in symbols: its upper triangle."""
    inputs = {"copies": make_symbols("copies", len(COPIES), size), "used": make_symbols("used")}
    (rows, columns), used = np.triu_indices(size), inputs["used"]
    excess = make_symbols("excess", len(rows))
    measured, *noisy = inputs["copies"] * used
    fade = 1.0 if forgetting == 1 else np.where(used > 0, forgetting, 1.0)
    # E = lambda E + (r+ r+' + r- r-') / 2 - r r'
    added = 0.5 * sum(row[rows] * row[columns] for row in noisy) - measured[rows] * measured[columns]
    return SymbolicStep(inputs, {"excess": excess}, {"excess": fade * excess + added})


def _compute_correction(excess: Array, state: RecursionState) -> Correction:
    """Compute the correction of a state from the triangle of the excess by noise (B, S, N).

    The noise is limited by `limit_noise`, and the remaining bias is part of the result.
    """
    if not excess.any():
        return Correction.none()
    P, theta, excess = state.P, state.theta, expand_triangle(excess)
    factor, share = limit_noise(P, theta, state.squares, excess)
    noise = factor * excess
    D, d = noise[..., :-1, :-1], noise[..., :-1, -1:]
    step = np.linalg.solve(np.eye(P.shape[-1]) - P @ D, P @ (D @ theta[..., None] - d))
    bias = (1.0 / share - 1.0 + UNCERTAINTY) * step
    return Correction(step[..., 0].astype(float), bias @ bias.swapaxes(-1, -2))
