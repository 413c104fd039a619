"""Servos: drives between a goal and a joint, and their simulation."""

from pendulum_env.servo.drive import KEYS, LONGEST_DELAY, OUTPUT_UNITS, TEXT_KEYS, ServoDrive
from pendulum_env.servo.torque import compute_commanded_torque

__all__ = ["KEYS", "LONGEST_DELAY", "OUTPUT_UNITS", "TEXT_KEYS", "ServoDrive", "compute_commanded_torque"]
