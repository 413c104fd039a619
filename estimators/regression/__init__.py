"""Linear algebra without pendulums: least squares, cross-validation, recursion."""
