"""Backends of the environment: simulation, replay and rig."""

from functools import partial

from pendulum_env.backends.constrained_body import ConstrainedBody
from pendulum_env.backends.hardware.rig import make_rig
from pendulum_env.backends.port import Backend, Maker, Sample, Setup, Start, Status, Traits
from pendulum_env.backends.replay import Replay
from pendulum_env.backends.rigid_body import make_body
from pendulum_env.backends.sensing import Sensor
from pendulum_env.backends.simulated import record
from pendulum_env.backends.simulator import Simulator

BACKENDS: dict[str, Maker] = {
    "pymunk": partial(Simulator, make_engine=make_body),
    "mujoco": partial(Simulator, make_engine=ConstrainedBody),
    "replay": Replay,
    "dm1015b": make_rig,
}

__all__ = ["BACKENDS", "Backend", "Sample", "Sensor", "Setup", "Start", "Status", "Traits", "record"]
