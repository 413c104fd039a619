"""Arms of n joints: identification by the six schemes, and effects at joints that a model lacks."""

from estimators.arms.addition import ArmAddition, add_arm
from estimators.arms.diagnosis import ArmDiagnosis, diagnose_arm
from estimators.arms.excitation import Excited, design_excitation
from estimators.arms.following import Follow, follow
from estimators.arms.identification import (
    ARM_SCHEMES,
    ArmIdentification,
    ArmIdentified,
    JointError,
    compare_arm,
    identify_arm,
)
from estimators.arms.online import ArmEstimator
from estimators.arms.payload import Payload, find_payload
from estimators.arms.standard import Nearest, nearest_body, standard_parameters
from estimators.arms.transmission import Transmission, find_transmissions

__all__ = [
    "ARM_SCHEMES",
    "ArmAddition",
    "ArmDiagnosis",
    "ArmEstimator",
    "ArmIdentification",
    "ArmIdentified",
    "Excited",
    "Follow",
    "JointError",
    "Nearest",
    "Payload",
    "Transmission",
    "add_arm",
    "compare_arm",
    "design_excitation",
    "diagnose_arm",
    "find_payload",
    "find_transmissions",
    "follow",
    "identify_arm",
    "nearest_body",
    "standard_parameters",
]
