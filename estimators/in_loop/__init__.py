"""Servos with their controller in the loop: fitted and diagnosed by simulating whole recordings from the goal."""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from estimators.in_loop.conventions import (
        apply_conventions,
        complete_conventions,
        decide_conventions,
        has_open_torque,
    )
else:  # a recording without goals needs none of it
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = ["apply_conventions", "complete_conventions", "decide_conventions", "has_open_torque"]
