"""What is of arms alone: excitation, payload, transmissions, standard parameters, and estimates while an arm runs."""

from estimators.arms.excitation import design_excitation
from estimators.arms.following import Follow, follow
from estimators.arms.online import ArmEstimator
from estimators.arms.payload import Payload, find_payload
from estimators.arms.reference import Reference
from estimators.arms.standard import Nearest, nearest_body, standard_parameters
from estimators.arms.transmission import Transmission, find_transmissions

__all__ = [
    "ArmEstimator",
    "Follow",
    "Nearest",
    "Payload",
    "Reference",
    "Transmission",
    "design_excitation",
    "find_payload",
    "find_transmissions",
    "follow",
    "nearest_body",
    "standard_parameters",
]
