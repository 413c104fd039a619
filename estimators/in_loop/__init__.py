"""Servos with their controller in the loop: fitted by simulating whole recordings from the goal."""

from estimators.in_loop.convention_fits import complete_drives
from estimators.in_loop.conventions import decide_conventions, has_open_torque

__all__ = ["complete_drives", "decide_conventions", "has_open_torque"]
