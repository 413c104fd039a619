"""Servos: the drive between a goal and a joint, and both simulated together."""

from pendulum_env.servo.drive import KEYS, LONGEST, UNIT, WORDS, ServoDrive

__all__ = ["KEYS", "LONGEST", "UNIT", "WORDS", "ServoDrive"]
