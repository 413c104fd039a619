"""Servos: drives between a goal and a joint, and their simulation."""

from pendulum_env.servo.drive import KEYS, LONGEST_DELAY, MOTOR, OUTPUT_UNITS, TEXT_KEYS, ServoDrive

__all__ = ["KEYS", "LONGEST_DELAY", "MOTOR", "OUTPUT_UNITS", "TEXT_KEYS", "ServoDrive"]
