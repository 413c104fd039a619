"""Names of the environments in Gymnasium."""

PENDULUM = "pendulum_env/DirectDrivePendulum-v0"
ARM = "pendulum_env/PlanarArm-v0"
DESIGN = "pendulum_env/ExcitationDesign-v0"
ARM_DESIGN = "pendulum_env/ArmExcitationDesign-v0"
