"""Robots, which extend the pendulum: servos in their loop. Cases and actuators register themselves by entry points."""
