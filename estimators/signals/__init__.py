"""Signals of a recording: derivatives, noise, stick."""
