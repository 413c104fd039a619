"""The six schemes of the paper, and the identification of parameters by them."""

from estimators.schemes.six import (
    SCHEMES,
    Dynamic,
    Energy,
    FilteredDynamic,
    FilteredHamiltonian,
    FilteredPower,
    Hamiltonian,
    scheme,
)

__all__ = [
    "SCHEMES",
    "Dynamic",
    "Energy",
    "FilteredDynamic",
    "FilteredHamiltonian",
    "FilteredPower",
    "Hamiltonian",
    "scheme",
]
