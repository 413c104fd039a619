"""Servos with their controller in the loop: fitted by simulating whole recordings from the goal."""

from robots.servos.in_loop.convention_fits import complete_drives
from robots.servos.in_loop.conventions import decide_conventions, decide_open_torque, list_decisions

__all__ = ["complete_drives", "decide_conventions", "decide_open_torque", "list_decisions"]
