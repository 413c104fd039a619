"""Servos: drives between a goal and a joint, and their simulation."""

from pendulum_env.servo.drive import KEYS, LONGEST, MOTOR, UNIT, WORDS, ServoDrive

__all__ = ["KEYS", "LONGEST", "MOTOR", "UNIT", "WORDS", "ServoDrive"]
