"""Least squares, Gauss-Newton and recursion, without pendulum physics."""
