"""Checks of recordings: timing, agreement, feedback, column signs, torque constant."""
