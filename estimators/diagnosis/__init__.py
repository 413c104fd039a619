"""Verdict and next experiment."""
