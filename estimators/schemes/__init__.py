"""The six schemes of the paper, and identification of parameters with them."""

from estimators.schemes.six import PAPER, SCHEMES, Integral, LowPass, Scheme, scheme

__all__ = ["PAPER", "SCHEMES", "Integral", "LowPass", "Scheme", "scheme"]
