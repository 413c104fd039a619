"""Servos: drives between a goal and a joint, and their simulation."""

from robots.servos.drive import KEYS, LONGEST_DELAY, OUTPUT_UNITS, TEXT_KEYS, ServoDrive
from robots.servos.torque import compute_commanded_torque

__all__ = ["KEYS", "LONGEST_DELAY", "OUTPUT_UNITS", "TEXT_KEYS", "ServoDrive", "compute_commanded_torque"]
