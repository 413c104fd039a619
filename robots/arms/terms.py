"""Terms at the joints of an arm: the core's functions for any mechanism with joints, under their names for users."""

from pendulum_env.physics.joints import Links as Links
from pendulum_env.physics.joints import list_base_terms as arm_base
from pendulum_env.physics.joints import list_friction_terms as friction
from pendulum_env.physics.joints import list_joint_effects as joint_effects
from pendulum_env.physics.joints import place_effect as place_effect
from pendulum_env.physics.joints import place_term as place_term

__all__ = ["Links", "arm_base", "friction", "joint_effects", "place_effect", "place_term"]
