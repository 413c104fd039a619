"""Linear algebra that knows no pendulum: least squares, cross-validation, recursion."""
