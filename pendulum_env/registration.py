"""Environments of the project in Gymnasium: their names, and their registration."""

from gymnasium.envs.registration import register

PENDULUM = "pendulum_env/DirectDrivePendulum-v0"
ARM = "pendulum_env/PlanarArm-v0"
DESIGN = "pendulum_env/ExcitationDesign-v0"
ARM_DESIGN = "pendulum_env/ArmExcitationDesign-v0"

ENTRY_POINTS = {  # one environment, and a batch of them; found only when made: nothing here knows of agents
    PENDULUM: ("pendulum_env.env:DirectDrivePendulum", "pendulum_env.vector_env:DirectDrivePendulumVector"),
    ARM: ("pendulum_env.arms.env:PlanarArm", None),
    DESIGN: ("agents.design_env:ExcitationDesign", "agents.design_env:ExcitationDesignVector"),
    ARM_DESIGN: ("agents.arm_env:ArmExcitationDesign", "agents.arm_env:ArmExcitationDesignVector"),
}


def register_environments() -> None:
    """Make the environments known to `gymnasium.make` and `gymnasium.make_vec`."""
    for id, (single, batch) in ENTRY_POINTS.items():
        register(id, entry_point=single, vector_entry_point=batch)
