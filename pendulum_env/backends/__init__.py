"""Where measurements come from."""

from pendulum_env.backends.hardware.rig import Rig, make_rig
from pendulum_env.backends.port import Backend, Maker, Sample, Setup, Start, Status
from pendulum_env.backends.replay import Replay
from pendulum_env.backends.rigid_body import RigidBody
from pendulum_env.backends.sensing import Sensor
from pendulum_env.backends.simulated import record

BACKENDS: dict[str, Maker] = {"pymunk": RigidBody, "replay": Replay, "dm1015b": make_rig}

__all__ = [
    "BACKENDS",
    "Backend",
    "Maker",
    "Replay",
    "Rig",
    "RigidBody",
    "Sample",
    "Sensor",
    "Setup",
    "Start",
    "Status",
    "record",
]
