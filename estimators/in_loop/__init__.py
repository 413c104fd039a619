"""Servos with their controller in the loop: fitted and diagnosed by simulating whole recordings from the goal."""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from estimators.in_loop.conventions import decide_conventions
else:  # a recording without goals needs none of it
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = ["decide_conventions"]
