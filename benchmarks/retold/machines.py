"""Machines of the independent plant under the motions that users make, each with its truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.draws import draw_size
from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, simulate

Array = NDArray[np.float64]
Rng = np.random.Generator


@dataclass(frozen=True)
class Machine:
    """Plant with its scales of torque, speed and time.

    Attributes:
        kind: pendulum, axis (no gravity, moves to and fro) or motor (no gravity, turns).
        plant: without effects.
        torque: peak of motions [N m].
        speed: typical of motions [rad/s].
        time: of the slowest dynamics [s].
    """

    kind: str
    plant: Plant
    torque: float
    speed: float
    time: float

    @property
    def options(self) -> tuple[str, ...]:
        """Return the options that describe the machine."""
        return () if self.kind == "pendulum" else ("--fix", "gravity=0")


def draw_machine(rng: Rng, kind: str, is_extreme: bool = False) -> Machine:
    """Draw a machine; `is_extreme`: of an inertia from 1e-6 to 1e3 kg m^2, else from 3e-3 to 3 kg m^2."""
    inertia = draw_size(rng, *(1e-6, 1e3) if is_extreme else (3e-3, 3.0))
    if kind == "pendulum":
        pace = draw_size(rng, 3.0, 9.0)  # rad/s, of small swings
        gravity = inertia * pace**2
        coulomb, viscous = gravity * rng.uniform(0.05, 0.4), inertia * pace * rng.uniform(0.2, 1.5)
        plant = Plant(inertia, gravity, viscous, coulomb)
        return Machine(kind, plant, (gravity + coulomb) * rng.uniform(1.2, 1.9), pace, 2 * np.pi / pace)
    speed, time = draw_size(rng, *(2.0, 15.0) if kind == "axis" else (20.0, 150.0)), draw_size(rng, 0.05, 0.4)
    torque = inertia * speed / time
    coulomb, viscous = torque * rng.uniform(0.1, 0.4), torque / speed * rng.uniform(0.2, 0.6)
    return Machine(kind, Plant(inertia, 0.0, viscous, coulomb), torque, speed, time)


# ------------------------------------------------------------------------------------------------- motions


def _two_sines(rng: Rng, machine: Machine, time: Array) -> Array:
    return _add_tones(rng, machine, time, 2)


def _multisine(rng: Rng, machine: Machine, time: Array) -> Array:
    return _add_tones(rng, machine, time, 6)


def _add_tones(rng: Rng, machine: Machine, time: Array, n: int) -> Array:
    """Return sines of 2 to 16 times the slowest period of the machine."""
    slowest = 0.12 * min(machine.speed, 6.0 / machine.time if machine.kind != "pendulum" else machine.speed)
    frequency = slowest * np.geomspace(1.0, 16.0, n + 1)[:-1] * rng.uniform(1.0, 16.0 ** (1 / n), n)
    wave = np.sin(np.outer(time, frequency) + rng.uniform(0, 2 * np.pi, n)) @ rng.uniform(0.6, 1.0, n)
    return np.asarray(machine.torque * wave / np.abs(wave).max())


def _chirp(rng: Rng, machine: Machine, time: Array) -> Array:
    slow, fast = 0.05 / machine.time, rng.uniform(0.6, 1.2) / machine.time
    return np.asarray(machine.torque * np.sin(2 * np.pi * (slow * time + (fast - slow) * time**2 / (2 * time[-1]))))


def _steps(rng: Rng, machine: Machine, time: Array) -> Array:
    edges = np.cumsum(machine.time * rng.uniform(0.3, 2.0, int(time[-1] / (0.3 * machine.time)) + 2))
    return np.asarray(machine.torque * rng.uniform(-1, 1, len(edges) + 1)[np.searchsorted(edges, time)])


def _staircase(rng: Rng, machine: Machine, time: Array) -> Array:
    """Return levels up and down again, each held for several time constants, in both directions or in one."""
    n = int(rng.integers(4, 9))
    top = np.arange(n + 1) / n
    levels = np.concatenate([top, top[-2::-1]])
    levels = levels if rng.random() < 0.5 else np.concatenate([levels, -levels])
    return np.asarray(machine.torque * levels[(time / time[-1] * len(levels) * 0.9999).astype(int)])


def _relay(rng: Rng, machine: Machine, time: Array) -> Array:
    """Return a constant torque that changes its sign."""
    edges = np.cumsum(
        machine.time * rng.uniform(0.8, 1.2) * rng.uniform(0.97, 1.03, int(2 * time[-1] / machine.time) + 4)
    )
    height = rng.uniform(0.5, 0.9) * machine.torque
    return np.asarray(height * (-1.0) ** np.searchsorted(edges, time))


def _one_direction(rng: Rng, machine: Machine, time: Array) -> Array:
    return np.asarray(machine.torque * (0.72 + 0.25 * _add_tones(rng, machine, time, 3) / machine.torque))


def _constant(rng: Rng, machine: Machine, time: Array) -> Array:
    return np.where(time < 0.05 * time[-1], 0.0, machine.torque * rng.uniform(0.6, 1.0))


def _pulses(rng: Rng, machine: Machine, time: Array) -> Array:
    """Return pulses of either sign with rest between them."""
    period, share = machine.time * rng.uniform(3.0, 6.0), rng.uniform(0.15, 0.4)
    number = (time / period).astype(int)
    heights = rng.choice([-1, 1], number[-1] + 1) * rng.uniform(0.6, 1.0, number[-1] + 1) * machine.torque
    return np.where(time % period < share * period, heights[number], 0.0)


def _tiny(rng: Rng, machine: Machine, time: Array) -> Array:
    """Return sines that move a pendulum by a few degrees, and others little."""
    return _add_tones(rng, machine, time, 2) * (machine.plant.coulomb * rng.uniform(1.3, 2.0) / machine.torque)


def _let_go(rng: Rng, machine: Machine, time: Array) -> Array:
    return np.zeros(len(time))


OPEN: dict[str, Callable[[Rng, Machine, Array], Array]] = {
    "two sines": _two_sines,
    "multisine": _multisine,
    "chirp": _chirp,
    "steps": _steps,
    "staircase": _staircase,
    "relay": _relay,
    "one direction": _one_direction,
    "constant": _constant,
    "pulses": _pulses,
    "tiny": _tiny,
    "free swing": _let_go,
    "standing": _staircase,
}
CLOSED = ("slow sweep", "position loop")  # triangle or smooth reference
ORDINARY = ("two sines", "multisine", "chirp", "steps")
UNUSUAL = ("staircase", "relay", "one direction", "constant", "pulses", "tiny", "free swing", "standing", "slow sweep")


@dataclass(frozen=True)
class Sensors:
    """Rate [Hz], duration [s], encoder counts a turn, and noise of the torque as a share of its peak."""

    rate: float = 500.0
    seconds: float = 20.0
    counts: int | None = 65_536
    noise: float = 0.003
    is_noise_unlogged: bool = False  # the noise acts on the plant, and the log has the command


@dataclass(frozen=True)
class Run:
    """Simulated motion of a machine with the options that a user gives."""

    machine: Machine
    motion: str
    sensors: Sensors
    recording: SimulatedRecording
    hidden: tuple[str, ...]
    options: tuple[str, ...]

    @property
    def truth(self) -> dict[str, float]:
        """Return the base parameters; relative to the inertia in a free swing."""
        plant = self.recording.plant
        theta = {name: float(getattr(plant, name)) for name in ("inertia", "gravity", "viscous", "coulomb")}
        if self.machine.kind != "pendulum":
            del theta["gravity"]
        if self.motion == "free swing":
            inertia = theta.pop("inertia")
            theta = {name: value / inertia for name, value in theta.items()}
        return theta


def run_machine(
    rng: Rng, machine: Machine, motion: str, sensors: Sensors, effects: dict[str, dict[str, float]] | None = None
) -> Run:
    """Simulate a machine under a motion."""
    effects, start, options = dict(effects or {}), (0.0, 0.0), machine.options
    seed = int(rng.integers(2**31))
    if motion == "standing":
        reach = 0.6 if machine.kind == "pendulum" else 0.3 * machine.speed * machine.time
        effects["hard_stop"] = {"wall_hi": reach, "wall_k": 60 * machine.torque, "wall_c": 0.05}
    if motion == "free swing":
        far = rng.uniform(1.2, 2.6) if machine.kind == "pendulum" else 0.0
        start = (float(rng.choice([-1, 1]) * far), 0.0 if machine.kind == "pendulum" else machine.speed)
    plant = replace(machine.plant, effects=effects)
    experiment = Experiment(
        sensors.rate,
        sensors.seconds,
        seed=seed,
        start=start,
        counts=sensors.counts,
        torque_noise=0.0 if motion == "free swing" else sensors.noise * machine.torque,
        noise_in_plant=sensors.is_noise_unlogged,
    )
    if motion in CLOSED:
        return Run(machine, motion, sensors, _follow(rng, machine, plant, experiment, motion), tuple(effects), options)
    command = OPEN[motion](rng, machine, np.arange(experiment.samples) / experiment.rate)
    recording = simulate([(plant, experiment)], [command])[0]
    return Run(machine, motion, sensors, recording, tuple(effects), options)


def _follow(rng: Rng, machine: Machine, plant: Plant, experiment: Experiment, motion: str) -> SimulatedRecording:
    """Simulate a position loop along a slow triangle or a smooth reference."""
    if machine.kind == "pendulum":
        reach = rng.uniform(1.0, 1.6)
    else:
        reach = rng.uniform(0.5, 1.5) * machine.speed * machine.time
    stiffness = 10 * machine.torque / reach
    loop: dict[str, Any] = {
        "excitation": "triangle" if motion == "slow sweep" else "pd_loop",
        "scale": reach if motion == "slow sweep" else reach / 2,
        "gains": (stiffness, 2 * np.sqrt(stiffness * plant.inertia)),
        "torque_limit": 2 * machine.torque,
    }
    return simulate([(plant, replace(experiment, **loop))])[0]


# ------------------------------------------------------------------------------------------------- hidden effects


def draw_effect(rng: Rng, machine: Machine) -> dict[str, dict[str, float]]:
    """Draw one effect of a tenth to a third of the torque."""
    torque, speed, plant = machine.torque, machine.speed, machine.plant
    size, sign = torque * rng.uniform(0.08, 0.25), float(rng.choice([-1, 1]))
    names = ["stribeck", "quadratic_drag", "viscous_asymmetry", "coulomb_asymmetry", "cogging", "friction_drift"]
    id = str(rng.choice(names + ["spring", "load_dependent_friction"] * (machine.kind == "pendulum")))
    laws: dict[str, dict[str, float]] = {
        "stribeck": {"strib_d": size, "strib_v": 0.15 * speed},
        "quadratic_drag": {"drag": size / speed**2},
        "viscous_asymmetry": {"asym_v": sign * min(size / speed, 0.6 * plant.viscous)},
        "coulomb_asymmetry": {"asym_c": sign * min(size, 0.6 * plant.coulomb)},
        "cogging": {"cog_n": float(rng.integers(5, 16)), "cog_s": 0.7 * size, "cog_c": -0.7 * size},
        "friction_drift": {"drift_a": rng.uniform(0.4, 0.8), "drift_T": rng.uniform(4.0, 9.0)},
        "spring": {"spring_k": size, "spring_q0": float(rng.uniform(-0.5, 0.5))},
        "load_dependent_friction": {"load_mu": rng.uniform(0.08, 0.2)},
    }
    return {id: laws[id]}
