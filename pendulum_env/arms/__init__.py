"""Arms of n joints: bodies from files, terms at joints, recordings, and simulated arms."""

from pendulum_env.arms.body import Body, BodyError, read_body
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.planar import TWO_LINK, Link
from pendulum_env.arms.plane import find_planar_links
from pendulum_env.arms.reading import find_logged_joints, read_arm_recording, read_arm_source
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.arms.robot import find_movable_joints
from pendulum_env.physics.joints import Links, friction, joint_effects, place_effect, place_term
from pendulum_env.physics.joints import at_joint as at_joint  # the names of place_effect and place_term in 1.0.0,
from pendulum_env.physics.joints import list_base_terms as arm_base
from pendulum_env.physics.joints import placed as placed  # kept for one release
from pendulum_env.physics.mechanism import BaseParameter

__all__ = [
    "TWO_LINK",
    "ArmModel",
    "ArmRecording",
    "BaseParameter",
    "Body",
    "BodyError",
    "Link",
    "Links",
    "arm_base",
    "find_logged_joints",
    "find_movable_joints",
    "find_planar_links",
    "friction",
    "joint_effects",
    "place_effect",
    "place_term",
    "read_arm_recording",
    "read_arm_source",
    "read_body",
]
