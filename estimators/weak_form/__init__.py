"""Weak form of the torque balance: windows that stay clear of stick, and the search over nonlinear parameters."""
