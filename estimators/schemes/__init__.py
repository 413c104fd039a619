"""The six schemes of the paper, and the identification of parameters by them."""

from estimators.schemes.six import PAPER, SCHEMES, Integral, LowPass, Scheme, scheme

__all__ = ["PAPER", "SCHEMES", "Integral", "LowPass", "Scheme", "scheme"]
