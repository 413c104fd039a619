"""Record simulated pendulums with encoder and torque noise."""

import numpy as np

from pendulum_env.backends.sensing import COUNTS, Sensor
from pendulum_env.excitation import Excitation
from pendulum_env.physics import Model
from pendulum_env.plant import paper_plant
from pendulum_env.recording import Recording

TORQUE_NOISE = 0.02  # [N m], standard deviation


def record(
    model: Model | None,
    excitation: Excitation,
    seconds: float,
    rate: float = 1000.0,
    counts: int = COUNTS,
    torque_noise: float = TORQUE_NOISE,
    *,
    rng: np.random.Generator | int,
    name: str = "simulated",
    release: float | None = None,
) -> Recording:
    """Record a simulated pendulum from rest, hanging down, or a free swing.

    Args:
        model: plant with its effects; None is the paper's pendulum.
        excitation: torque command, held over each period.
        seconds: length of the recording [s].
        rate: samples per second [Hz].
        counts: encoder counts per turn; 0 measures the angle exactly.
        torque_noise: standard deviation of the white noise on the recorded torque [N m].
        rng: random generator of the noise, or a seed.
        name: name of the recording.
        release: initial angle of a free swing [rad], at rest and without torque; None for an excited run.

    Raises:
        ValueError: if a number is out of its range.
    """
    for argument, value in (("seconds", seconds), ("rate", rate)):
        if not 0 < value < np.inf:
            raise ValueError(f"a recording needs {argument} above zero, got {value:g}")
    sensor = Sensor(counts, torque_noise if release is None else 0.0)
    samples = round(seconds * rate)
    if samples < 2:
        raise ValueError(f"{seconds:g} s at {rate:g} Hz are {samples} samples, at least 2 are needed")
    time = np.arange(samples) / rate
    torque = np.asarray(excitation.signal(time), dtype=float) if release is None else np.zeros(samples)
    plant = model or paper_plant()
    path = plant.simulate(1.0 / rate, torque, release or 0.0, 0.0)
    return Recording(
        name=name,
        time=time,
        position=sensor.position(path.position[:-1, 0]),
        torque=np.asarray(sensor.torque(torque, np.random.default_rng(rng))),
    )
