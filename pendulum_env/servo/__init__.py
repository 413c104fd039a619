"""Servos: the drive between a goal and a joint, and both simulated together."""

from pendulum_env.servo.drive import KEYS, LONGEST, MOTOR, UNIT, WORDS, ServoDrive

__all__ = ["KEYS", "LONGEST", "MOTOR", "UNIT", "WORDS", "ServoDrive"]
