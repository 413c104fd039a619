"""Prediction error over segments of simulated motion with free initial states."""
