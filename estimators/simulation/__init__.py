"""Prediction error over segments of simulated motion whose initial states are free."""
