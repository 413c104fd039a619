"""Where measurements come from."""

from pendulum_env.backends.port import Backend, Maker, Sample, Setup, Start, Status
from pendulum_env.backends.replay import Replay
from pendulum_env.backends.rigid_body import RigidBody
from pendulum_env.backends.sensing import Sensor
from pendulum_env.backends.simulated import record

BACKENDS: dict[str, Maker] = {"pymunk": RigidBody, "replay": Replay}

__all__ = [
    "BACKENDS",
    "Backend",
    "Maker",
    "Replay",
    "RigidBody",
    "Sample",
    "Sensor",
    "Setup",
    "Start",
    "Status",
    "record",
]
