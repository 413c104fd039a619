"""Excitation, payload and standard parameters of arms."""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from estimators.arms.excitation import design_excitation
    from estimators.arms.following import Follow, follow
    from estimators.arms.payload import Payload, find_payload
    from estimators.arms.reference import Reference
    from estimators.arms.standard import Nearest, nearest_body, standard_parameters
else:
    __getattr__, __dir__ = lazy_exports(__name__)

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
