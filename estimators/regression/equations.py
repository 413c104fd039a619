"""Linear regression, the result of schemes and the input of solvers."""

from __future__ import annotations

from dataclasses import dataclass

from pendulum_env._typing import Array
from pendulum_env.errors import UserError


class IdentificationError(UserError):
    """Data from which nothing can be identified; the message says why and what to record instead.

    Attributes:
        effect: id of the effect that the data do not show, if that is the reason.
    """

    def __init__(self, message: str, effect: str = "") -> None:
        super().__init__(message)
        self.effect = effect


@dataclass(frozen=True)
class Equations:
    """Linear regression y = phi theta + error in N m: phi (R, P), y (R,)."""

    phi: Array
    y: Array
