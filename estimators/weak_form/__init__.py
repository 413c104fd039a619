"""Weak form of the torque balance: windows that stay clear of stick, and the search for shape parameters on them."""
