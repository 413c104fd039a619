"""Recordings of machines with hidden effects, simulated by MuJoCo, with laws that differ from the library's.

Friction is regularised, stops and play are soft constraints, a tilted base is a tilted gravity, and a link behind a
spring is a second body. Other laws are variants of the library's: friction that falls as 1 / (1 + (v / vs)^2), cogging
with an overtone, a hardening spring, bristles after Canudas de Wit. Inertias range from 0.5 g m^2 (a wheel) to
4 kg m^2 (an arm). Torques are random tones, a chirp, or those of a controller.

    python -m benchmarks.mujoco_plant OUT --seed 1         # a blind set: recordings and truth.json
    python -m benchmarks.known_truth OUT
"""

from __future__ import annotations

import argparse
import gzip
import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.draws import choose_pairs, make_generator
from benchmarks.independent_plant import LIBRARY

Array = NDArray[np.float64]

STEP = 0.25e-3  # largest step of the integrator [s]
GRAVITY = 9.81  # [m/s^2]
FASTEST = 400.0  # largest accepted speed [rad/s]
SHARES = (0.03, 0.25)  # accepted residual of the refitted base model over the torque; sizes are adapted to it
TURNS = 6  # largest number of adaptations
ATTEMPTS = 20  # largest number of drawn machines, if they run away


@dataclass(frozen=True)
class Machine:
    """Kind of machine, with typical values; plants have half to twice these values."""

    inertia: float  # [kg m^2]
    gravity: float  # [N m]
    viscous: float  # [N m s/rad]
    coulomb: float  # [N m]
    rates: tuple[float, ...]  # [Hz]
    counts: tuple[int, ...]  # per turn
    seconds: float  # of a recording
    pace: float  # typical frequency of motion [Hz]


MACHINES = {
    "servo": Machine(2e-3, 0.15, 5e-3, 0.02, (200.0, 250.0), (4096, 16384), 20.0, 1.0),
    "direct drive": Machine(0.03, 1.2, 0.02, 0.06, (300.0, 500.0, 1000.0), (16384, 131072), 15.0, 1.0),
    "rig": Machine(0.09, 2.0, 0.35, 0.8, (500.0, 1000.0), (65536, 1024000), 20.0, 0.8),
    "wheel": Machine(1e-3, 0.0, 5e-4, 0.01, (500.0, 1000.0), (8192,), 15.0, 1.0),
    "arm": Machine(2.0, 25.0, 3.0, 4.0, (250.0, 500.0), (131072, 524288), 30.0, 0.4),
}


@dataclass
class Hidden:
    """Implementation of an effect; load, dry and drive are functions of time, angle, speed and motor torque.

    Attributes:
        load: torque opposed to the motor's [N m].
        dry: additional dry friction [N m].
        drive: motor torque for a command [N m].
        motor: motor's share of the inertia, with a link behind a spring or play; 0 without a link.
        link: attributes of the joint between motor and link.
        stop: attributes of the motor's joint.
        tilt: of gravity [rad].
        late: delay of the command [s]; `lag` its time constant [s].
        payload: relative change of the link's mass, and its time [share of the recording].
        bristles: deflection of the bristles at which friction slides [rad]; 0: no bristles.
        reads: reading of the encoder as a function of the angle [rad].
        relaxes: stiffness [N m/rad] and time constant [s] of a relaxing spring.
    """

    load: Callable[[float, float, float, float], float] | None = None
    dry: Callable[[float, float, float, float], float] | None = None
    drive: Callable[[float, float, float, float], float] | None = None
    reads: Callable[[float], float] | None = None
    motor: float = 0.0
    link: str = ""
    stop: str = ""
    tilt: float = 0.0
    late: float = 0.0
    lag: float = 0.0
    payload: tuple[float, float] = (0.0, 0.5)
    bristles: float = 0.0
    relaxes: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True)
class Plant:
    """Machine with its parameters and hidden effects."""

    kind: str
    inertia: float
    gravity: float
    viscous: float
    coulomb: float
    hidden: tuple[str, ...] = ()
    seed: int = 0
    sizes: dict[str, float] = field(default_factory=dict)  # sizes of the effects relative to typical ones

    @property
    def torque(self) -> float:
        """Return the largest torque of the motor [N m]."""
        return 1.6 * (self.gravity + self.coulomb) + 2.0 * self.inertia * (2 * np.pi * MACHINES[self.kind].pace) ** 2

    @property
    def speed(self) -> float:
        """Return the typical speed [rad/s]."""
        return 2 * np.pi * MACHINES[self.kind].pace

    def effect(self, name: str) -> Hidden:
        """Return the implementation of a hidden effect."""
        return _effect(name, self, self.sizes.get(name, 1.0), np.random.default_rng([self.seed, *name.encode()]))


def _effect(name: str, plant: Plant, size: float, rng: np.random.Generator) -> Hidden:
    """Return an effect; `size` is relative to a typical size for the machine's torque and speed."""
    sin, exp, pace = np.sin, np.exp, MACHINES[plant.kind].pace
    sign, torque, fast, dry = float(rng.choice([-1, 1])), 0.1 * plant.torque * size, plant.speed, plant.coulomb
    phase = rng.uniform(0, 2 * np.pi)
    match name:
        case "torque_offset":
            return Hidden(load=lambda t, q, v, u: sign * torque)
        case "gravity_tilt":
            return Hidden(tilt=sign * min(0.12 * size, 1.0))
        case "coulomb_asymmetry":
            part = sign * min(0.4 * size, 0.9) * dry
            return Hidden(load=lambda t, q, v, u: part * np.tanh(200 * abs(v) / fast))
        case "viscous_asymmetry":
            part = sign * min(0.5 * size, 0.95) * (plant.viscous + 0.05 * plant.torque / fast)
            return Hidden(load=lambda t, q, v, u: part * abs(v))
        case "stribeck":
            slow = 0.1 * fast * 2 ** rng.uniform(-1, 1)
            return Hidden(dry=lambda t, q, v, u: 1.5 * torque / (1 + (v / slow) ** 2))
        case "quadratic_drag":
            return Hidden(load=lambda t, q, v, u: 0.7 * torque * v * abs(v) / fast**2)
        case "load_dependent_friction":
            share = min(0.12 * size, 0.6)
            return Hidden(dry=lambda t, q, v, u: share * abs(u))
        case "position_dependent_friction":
            part = min(0.6 * size, 0.95) * dry
            return Hidden(dry=lambda t, q, v, u: part * sin(q + phase))
        case "cogging":
            order = int(rng.integers(5, 22))
            return Hidden(load=lambda t, q, v, u: torque * (sin(order * q + phase) + 0.2 * sin(2 * order * q)))
        case "torque_ripple":
            order = int(rng.integers(3, 14))
            part = min(0.12 * size, 0.9)
            return Hidden(drive=lambda t, q, v, u: u * (1 + part * sin(order * q + phase)))
        case "spring":
            rest = float(rng.uniform(-0.4, 0.4))
            return Hidden(load=lambda t, q, v, u: torque * ((q - rest) + 0.1 * (q - rest) ** 3))
        case "actuator_lag":
            return Hidden(lag=0.008 * size / pace)
        case "dead_time":
            return Hidden(late=0.008 * size / pace)
        case "torque_saturation":
            most = plant.torque * 0.5 / size**0.5
            return Hidden(drive=lambda t, q, v, u: float(np.clip(u, -most, most)))
        case "friction_drift":
            slow = 8.0
            return Hidden(
                dry=lambda t, q, v, u: min(0.6 * size, 2.0) * dry * exp(-t / slow),
                load=lambda t, q, v, u: min(0.6 * size, 2.0) * plant.viscous * v * exp(-t / slow),
            )
        case "payload_change":
            return Hidden(
                payload=(float(rng.choice([-0.5, 1.0])) * min(0.25 * size, 0.9), float(rng.uniform(0.3, 0.7)))
            )
        case "periodic_disturbance":
            turn = 3.1 * fast
            return Hidden(load=lambda t, q, v, u: torque * sin(turn * t + phase))
        case "joint_flexibility":
            stiff = plant.inertia * (25 * pace / size**0.5) ** 2
            return Hidden(motor=0.3, link=f'stiffness="{stiff}" damping="{0.02 * stiff / fast}"')
        case "backlash":
            gap = 0.015 * size
            return Hidden(motor=0.3, link=f'range="{-gap} {gap}" limited="true" solreflimit="0.006 0.6"')
        case "presliding":
            return Hidden(bristles=0.015 * size)
        case "encoder_eccentricity":
            return Hidden(reads=lambda q: q + 0.012 * size * (sin(q + phase) + 0.1 * sin(2 * q)))
        case "hard_stop":
            wall = 0.9 / size**0.5
            return Hidden(stop=f'range="{-wall} {1.2 * wall}" limited="true" solreflimit="0.03 0.4"')
        case "square_root_friction":  # this and the following: outside the library
            return Hidden(dry=lambda t, q, v, u: 2 * torque * abs(v / fast) ** 0.4)
        case "gain_drift":
            return Hidden(drive=lambda t, q, v, u: u * (1 - min(0.25 * size, 0.7) * (1 - exp(-t / 6.0))))
        case "relaxing_spring":
            return Hidden(relaxes=(torque, 1.0 / pace))
        case "bump":
            return Hidden(load=lambda t, q, v, u: 2 * torque * exp(-(((q - 0.2) / 0.12) ** 2)))
        case "deadzone":
            part = 0.12 * plant.torque * size
            return Hidden(drive=lambda t, q, v, u: float(u - np.clip(u, -part, part)))
    raise ValueError(f"unknown effect {name}")


OUTSIDE = ("square_root_friction", "gain_drift", "relaxing_spring", "bump", "deadzone")
INSEPARABLE = [
    frozenset({"torque_offset", "coulomb_asymmetry"}),
    frozenset({"joint_flexibility", "backlash"}),
    frozenset({"actuator_lag", "dead_time"}),
]
HANGING = {"gravity_tilt", "payload_change", "hard_stop", "joint_flexibility", "backlash"}  # impossible for a wheel


class RunsAway(Exception):
    """The machine exceeds `FASTEST`, or the integration fails."""


@dataclass(frozen=True)
class Run:
    """Simulated recording with command and exact motion."""

    time: Array
    position: Array
    torque: Array
    command: Array
    exact: Array  # (3, N): angle [rad], speed [rad/s], acceleration [rad/s^2] of the motor


def _xml(plant: Plant, effects: Sequence[Hidden], step: float) -> str:
    motor = max((effect.motor for effect in effects), default=0.0)
    link = next((effect.link for effect in effects if effect.motor), "")
    stop = next((effect.stop for effect in effects if effect.stop), "")
    tilt = sum(effect.tilt for effect in effects)
    hanging = (1 - motor) * plant.inertia
    length = 0.5 * hanging * GRAVITY / plant.gravity if plant.gravity else 0.0  # so that m l^2 is half of the inertia
    mass = plant.gravity / (GRAVITY * length) if length else 1.0
    own = hanging - mass * length**2
    body = f'<inertial pos="0 0 {-length}" mass="{mass}" diaginertia="{own} {own} {own}"/>'
    friction = 'solreffriction="0.001 1" solimpfriction="0.99 0.999 0.001"'
    joint = f'<joint name="motor" axis="0 1 0" damping="{plant.viscous}" {friction} {stop} '
    if motor:
        tiny = 1e-6 * plant.inertia
        inside = (
            f'{joint} armature="{motor * plant.inertia}"/>'
            f'<inertial pos="0 0 0" mass="1e-6" diaginertia="{tiny} {tiny} {tiny}"/>'
            f'<body name="link"><joint name="link" axis="0 1 0" {link}/>{body}</body>'
        )
        inside = f"<body>{inside}</body>"
    else:
        inside = f'<body name="link">{joint}/>{body}</body>'
    down = f"{GRAVITY * np.sin(tilt)} 0 {-GRAVITY * np.cos(tilt)}"
    return (
        f'<mujoco><compiler autolimits="false" angle="radian"/><option timestep="{step}" integrator="implicitfast" '
        f'gravity="{down}" tolerance="1e-12"/><worldbody>{inside}</worldbody></mujoco>'
    )


def simulate(plant: Plant, drive: str, rate: float, seconds: float, counts: int, noise: float, seed: int) -> Run:
    """Simulate a plant under a torque ("sines", "chirp") or a position controller with a reference ("track", "steps").

    Raises RunsAway if the speed exceeds `FASTEST`, or the integration fails.
    """
    effects = [plant.effect(name) for name in plant.hidden]
    inner = max(1, int(np.ceil(1 / (rate * STEP) - 1e-9)))
    model = mujoco.MjModel.from_xml_string(_xml(plant, effects, 1 / (rate * inner)))
    data = mujoco.MjData(model)
    rng, count = np.random.default_rng(seed), round(rate * seconds)
    time = np.arange(count) / rate
    signal = _signal(plant, drive, rng, time)
    stiff = plant.inertia * (2 * plant.speed) ** 2 + 2 * plant.gravity
    damping = 1.2 * np.sqrt(stiff * plant.inertia)
    late = sum(effect.late for effect in effects)
    lag, bent = sum(effect.lag for effect in effects), sum(effect.bristles for effect in effects)
    kept = 1 - np.exp(-model.opt.timestep / lag) if lag else 1.0
    commands, positions, exact = np.zeros(count), np.zeros(count), np.zeros((3, count))
    grain, speed, before, made, bristle, spring = 2 * np.pi / counts, 0.0, 0.0, 0.0, 0.0, 0.0
    link = model.body("link").id
    for k in range(count):
        for effect in effects:
            if effect.payload[0] and k == round(effect.payload[1] * count):
                model.body_mass[link] *= 1 + effect.payload[0]
                model.body_inertia[link] *= 1 + effect.payload[0]
                mujoco.mj_setConst(model, mujoco.MjData(model))
        read = float(data.qpos[0])
        for effect in effects:
            read = effect.reads(read) if effect.reads else read
        positions[k] = np.round(read / grain) * grain
        if drive in ("track", "steps"):
            speed += (1 - np.exp(-2 * np.pi * 30 / rate)) * ((positions[k] - before) * rate - speed)
            slope = (signal[k] - signal[max(k - 1, 0)]) * rate
            wanted = stiff * (signal[k] - positions[k]) + damping * (slope - speed)
            commands[k] = np.clip(wanted, -2 * plant.torque, 2 * plant.torque)
            before = positions[k]
        else:
            commands[k] = signal[k]
        for i in range(inner):
            at = (k * inner + i) / inner - late * rate
            asked = commands[int(at)] if at >= 0 else 0.0
            made += kept * (asked - made)
            t, q, v, u = float(data.time), float(data.qpos[0]), float(data.qvel[0]), float(made)
            load, dry = 0.0, plant.coulomb
            for effect in effects:
                u = effect.drive(t, q, v, u) if effect.drive else u
            for effect in effects:
                load += effect.load(t, q, v, u) if effect.load else 0.0
                dry += effect.dry(t, q, v, u) if effect.dry else 0.0
                if effect.relaxes[0]:
                    spring += model.opt.timestep * (v - spring / effect.relaxes[1])
                    load += effect.relaxes[0] * spring
            dry = max(dry, 0.0)
            if bent:  # Canudas de Wit et al., 1995, with damped bristles; exact for constant speed
                end = np.sign(v) * bent
                after = end + (bristle - end) * np.exp(-abs(v) * model.opt.timestep / bent)
                slope, bristle = (after - bristle) / model.opt.timestep, after
                load, dry = load + dry * (bristle + 0.05 / plant.speed * slope) / bent, 0.0
            model.dof_frictionloss[0] = dry
            data.qfrc_applied[0] = u - load
            mujoco.mj_step(model, data)
            if i == 0:  # just after the sample
                exact[:, k] = q, v, data.qacc[0]
            if not abs(v) < FASTEST:
                raise RunsAway(f"{plant} turns at {v:.3g} rad/s")
    return Run(time, positions, commands + noise * rng.standard_normal(count), commands, exact)


def _signal(plant: Plant, drive: str, rng: np.random.Generator, time: Array) -> Array:
    pace, length = MACHINES[plant.kind].pace, float(time[-1])
    match drive:
        case "sines":
            return plant.torque * _tones(rng, time, rng.uniform(0.3, 3.0, 5) * pace)
        case "chirp":
            low, high = 0.2 * pace, 4 * pace
            turns = low * time + 0.5 * (high - low) / length * time**2
            return np.asarray(0.8 * plant.torque * np.sin(2 * np.pi * turns + rng.uniform(0, 2 * np.pi)))
        case "track":
            return 1.5 * _tones(rng, time, rng.uniform(0.2, 1.5, 4) * pace)
        case _:
            knots = np.arange(0.0, length + 2, 0.7 / pace)
            values = np.append(0.0, rng.uniform(-1.5, 1.5, len(knots) - 1))
            smooth = np.clip((time[:, None] - knots) / (0.35 / pace), 0, 1)
            ease = smooth**2 * (3 - 2 * smooth)
            return np.asarray(ease[:, 1:] @ np.diff(values))


def _tones(rng: np.random.Generator, time: Array, frequencies: Array) -> Array:
    """Return a sum of random sinusoids of given frequencies [Hz], with a peak of 1."""
    phases, sizes = rng.uniform(0, 2 * np.pi, len(frequencies)), rng.uniform(0.3, 1, len(frequencies))
    total = np.sin(2 * np.pi * time[:, None] * frequencies + phases) @ sizes
    return np.asarray(total / np.abs(total).max())


DRIVES = ("sines", "chirp", "track", "steps")


def missing_share(run: Run) -> float:
    """Return the residual of the base model over the RMS of the commanded torque, in motion."""
    q, v, a = run.exact
    use = np.abs(v) > 0.02 * np.abs(v).max()
    phi = np.column_stack([a, np.sin(q), v, np.sign(v)])[use]
    tau = run.command[use]
    return float(np.std(tau - phi @ np.linalg.lstsq(phi, tau, rcond=None)[0]) / np.sqrt(np.mean(tau**2)))


def case(hidden: tuple[str, ...], seed: int) -> tuple[Run, Run, dict[str, Any]]:
    """Return two runs of a random machine with adapted effects, and its entry of truth.json."""
    for attempt in range(ATTEMPTS):
        try:
            return _case(hidden, seed, np.random.default_rng([seed, attempt]))
        except RunsAway:
            continue
    raise RunsAway(f"{hidden} does so on every machine")


def _case(hidden: tuple[str, ...], seed: int, rng: np.random.Generator) -> tuple[Run, Run, dict[str, Any]]:
    kinds = [kind for kind in MACHINES if not (kind == "wheel" and HANGING & set(hidden))]
    kind = str(rng.choice(kinds))
    machine = MACHINES[kind]
    drawn = {
        name: getattr(machine, name) * 2 ** rng.uniform(-1, 1) for name in ("inertia", "gravity", "viscous", "coulomb")
    }
    plant = Plant(kind, **drawn, hidden=hidden, seed=seed)
    first, second = rng.choice(DRIVES, 2, replace=False).tolist()
    rate, counts = float(rng.choice(machine.rates)), int(rng.choice(machine.counts))
    noise = float(plant.torque * rng.choice([0.002, 0.005, 0.01]))
    one, other = rng.integers(2**31, size=2).tolist()
    run = simulate(plant, first, rate, machine.seconds, counts, noise, one)
    # the exact motion does not contain the eccentricity of the encoder
    for _ in range(TURNS if hidden and "encoder_eccentricity" not in hidden else 0):
        share = missing_share(run)
        if SHARES[0] <= share <= SHARES[1]:
            break
        factor = 1.7 if share < SHARES[0] else 0.6
        plant = replace(plant, sizes={name: plant.sizes.get(name, 1.0) * factor for name in hidden})
        run = simulate(plant, first, rate, machine.seconds, counts, noise, one)
    held = simulate(plant, second, rate, machine.seconds, counts, noise, other)
    tilt = sum(plant.effect(name).tilt for name in hidden)
    entry = {
        "hidden": list(hidden),
        "plant": {**drawn, "gravity": drawn["gravity"] * np.cos(tilt)},
        "effect_parameters": {},
        "rate_hz": rate,
        "encoder_counts": counts,
        "torque_noise_rms": noise,
        "excitation": f"{kind}, {first}, {second}",
        "effect_share": {
            part: {"refit": round(missing_share(one), 5)} for part, one in (("train", run), ("holdout", held))
        },
    }
    return run, held, entry


def write(folder: Path, name: str, run: Run) -> None:
    """Write a recording as NAME.csv.gz."""
    rows = zip(run.time.tolist(), run.position.tolist(), run.torque.tolist(), strict=True)
    body = "\n".join(f"{t:.6f},{q:.9g},{u:.6g}" for t, q, u in rows)
    with gzip.open(folder / f"{name}.csv.gz", "wb", 6) as file:
        file.write(f"time,position,torque\n{body}\n".encode())


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mujoco_plant", description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for the recordings and truth.json")
    parser.add_argument("--each", type=int, default=1, help="cases of each effect (default 1)")
    parser.add_argument("--nulls", type=int, default=8, help="cases with nothing hidden (default 8)")
    parser.add_argument("--pairs", type=int, default=0, help="cases with two effects (default 0)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args(argv)
    wanted = [((), copy) for copy in range(arguments.nulls)]
    wanted += [((name,), copy) for copy in range(arguments.each) for name in (*LIBRARY, *OUTSIDE)]
    wanted += [(couple, 0) for couple in choose_pairs(arguments.seed, LIBRARY, INSEPARABLE)[: arguments.pairs]]
    seeds = [int(make_generator(arguments.seed, copy, *hidden).integers(2**31)) for hidden, copy in wanted]
    arguments.out.mkdir(parents=True, exist_ok=True)
    truth = {}
    with ProcessPoolExecutor(arguments.workers) as pool:
        for k, (run, held, entry) in enumerate(pool.map(case, [hidden for hidden, _ in wanted], seeds)):
            name = f"case_{k:03d}"
            write(arguments.out, f"{name}.train", run)
            write(arguments.out, f"{name}.holdout", held)
            truth[name] = entry
            print(name, entry["hidden"], entry["excitation"], entry["effect_share"], flush=True)
    (arguments.out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
