"""Measurements of a pendulum: physics, recordings, excitation, backends and the Gymnasium environment.

Importing it makes the environments known to `gymnasium.make`, as is Gymnasium's custom; pymunk waits until then.
"""

from gymnasium.envs.registration import register

from pendulum_env.registration import ARM, ARM_DESIGN, DESIGN, PENDULUM

register(
    PENDULUM,
    entry_point="pendulum_env.env:DirectDrivePendulum",
    vector_entry_point="pendulum_env.vector_env:DirectDrivePendulumVector",
)
register(ARM, entry_point="pendulum_env.arms.env:PlanarArm")
register(
    DESIGN,
    entry_point="agents.design_env:ExcitationDesign",  # found only when it is made: nothing here knows of agents
    vector_entry_point="agents.design_env:ExcitationDesignVector",
)
register(
    ARM_DESIGN,
    entry_point="agents.arm_env:ArmExcitationDesign",
    vector_entry_point="agents.arm_env:ArmExcitationDesignVector",
)
