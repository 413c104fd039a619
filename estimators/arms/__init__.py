"""What is of arms alone: excitation, payload and standard parameters."""

from estimators.arms.excitation import design_excitation
from estimators.arms.following import Follow, follow
from estimators.arms.payload import Payload, find_payload
from estimators.arms.reference import Reference
from estimators.arms.standard import Nearest, nearest_body, standard_parameters

__all__ = [
    "Follow",
    "Nearest",
    "Payload",
    "Reference",
    "design_excitation",
    "find_payload",
    "follow",
    "nearest_body",
    "standard_parameters",
]
