"""Servos: the drive between a goal and a joint, and both simulated together."""
