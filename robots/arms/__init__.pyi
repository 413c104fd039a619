from .body import BaseParameter, Body, BodyError, read_body
from .excitation import design_excitation
from .following import Follow, follow
from .model import ArmModel
from .payload import Payload, find_payload
from .planar import TWO_LINK, Link
from .plane import find_planar_links
from .reading import find_logged_joints, read_arm_recording, read_arm_source
from .recording import ArmRecording
from .reference import Reference
from .robot import find_movable_joints
from .standard import Nearest, nearest_body, standard_parameters
from .terms import Links, arm_base, friction, joint_effects, place_effect, place_term

__all__ = [
    "TWO_LINK",
    "ArmModel",
    "ArmRecording",
    "BaseParameter",
    "Body",
    "BodyError",
    "Follow",
    "Link",
    "Links",
    "Nearest",
    "Payload",
    "Reference",
    "arm_base",
    "design_excitation",
    "find_logged_joints",
    "find_movable_joints",
    "find_payload",
    "find_planar_links",
    "follow",
    "friction",
    "joint_effects",
    "nearest_body",
    "place_effect",
    "place_term",
    "read_arm_recording",
    "read_arm_source",
    "read_body",
    "standard_parameters",
]
