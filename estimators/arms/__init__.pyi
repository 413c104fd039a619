from .excitation import design_excitation
from .following import Follow, follow
from .payload import Payload, find_payload
from .reference import Reference
from .standard import Nearest, nearest_body, standard_parameters

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
