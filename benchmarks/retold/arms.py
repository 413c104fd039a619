"""Scenarios of an arm with two joints in a vertical plane, with its robot file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.draws import draw_size
from benchmarks.retold.bound import compute_acceleration_noise, compute_errors, count_samples, cut
from benchmarks.retold.logs import Log
from benchmarks.retold.machines import Sensors
from benchmarks.retold.retellings import COMMON, Rng
from benchmarks.retold.scenario import Scenario
from benchmarks.two_link import GRAVITY, Multisine, TwoLink

Array = NDArray[np.float64]

JOINTS = ("shoulder", "elbow")
PEAK = (3.5, 2.2)  # torque of a tone of a plain arm [N m]
MOTIONS = {"multisine": 1.0, "slow multisine": 0.5}  # factor of the paper's frequencies


@dataclass(frozen=True)
class ArmRun:
    """Simulated motion of an arm: series (N, 2), positions as the encoders read them, noise of the torque (2,)."""

    arm: TwoLink
    sensors: Sensors
    noise: Array
    time: Array
    exact_position: Array
    position: Array
    velocity: Array
    torque: Array

    @property
    def truth(self) -> dict[str, float]:
        """Return base parameters, with the names of the program, and friction."""
        (m1, m2), (c1, c2), (i1, i2), l1 = self.arm.mass, self.arm.center, self.arm.inertia, self.arm.length
        links = {"mx@shoulder": 0.0, "mz@shoulder": -m1 * c1 - m2 * l1, "Iyy@shoulder": i1 + m1 * c1**2 + m2 * l1**2}
        links |= {"mx@elbow": 0.0, "mz@elbow": -m2 * c2, "Iyy@elbow": i2 + m2 * c2**2}
        friction = {"viscous": self.arm.viscous, "coulomb": self.arm.coulomb}
        return links | {f"{id}@{name}": own[k] for id, own in friction.items() for k, name in enumerate(JOINTS)}


def draw_machine(rng: Rng) -> tuple[TwoLink, float]:
    """Draw an arm with its weight moment, relative to that of the plain one."""
    weight, stretch, plain = draw_size(rng, 0.4, 4.0), draw_size(rng, 0.7, 1.5), TwoLink()
    size = weight * stretch
    mass = [own * weight * rng.uniform(0.8, 1.2) for own in plain.mass]
    arm = TwoLink(
        (mass[0], mass[1]),
        plain.length * stretch,
        (plain.center[0] * stretch, plain.center[1] * stretch),
        (plain.inertia[0] * weight * stretch**2, plain.inertia[1] * weight * stretch**2),
        viscous=(size * rng.uniform(0.2, 0.5), size * rng.uniform(0.2, 0.5)),
        coulomb=(size * rng.uniform(0.4, 1.0), size * rng.uniform(0.4, 1.0)),
    )
    return arm, size


def hide_effect(rng: Rng, arm: TwoLink, size: float) -> tuple[TwoLink, str]:
    """Hide drag or cogging at a joint of an arm."""
    joint, id = int(rng.integers(2)), str(rng.choice(["quadratic_drag", "cogging"]))
    sizes = [0.0, 0.0]
    sizes[joint] = size * rng.uniform(0.1, 0.2)
    own = (sizes[0], sizes[1])
    hiding = replace(arm, drag=own) if id == "quadratic_drag" else replace(arm, cogging=own)
    return hiding, f"{id}@{JOINTS[joint]}"


def run_arm(rng: Rng, arm: TwoLink, size: float, motion: str, sensors: Sensors) -> ArmRun:
    """Simulate an arm under sines of torque at each joint."""
    plain = Multisine.paper(int(rng.integers(2**31)), (PEAK[0] * size, PEAK[1] * size))
    signal = replace(plain, frequency=plain.frequency * MOTIONS[motion])
    time = np.arange(round(sensors.seconds * sensors.rate)) / sensors.rate
    exact, velocity = arm.simulate(signal, time)
    step, noise = 2 * np.pi / (sensors.counts or 1e9), sensors.noise * 2.7 * size * np.array(PEAK)
    torque = signal.held(time, 1 / sensors.rate) + noise * rng.standard_normal(exact.shape)
    return ArmRun(arm, sensors, noise, time, exact, np.round(exact / step) * step, velocity, torque)


def bound_errors(run: ArmRun) -> dict[str, float]:
    """Return the least relative standard errors of parameters that are not zero.

    Rows of the equations of motion are means over windows in which their joint slides. Each link has three parameters:
    moments of inertia and of mass, along the link and across it.
    """
    size, noise_of_motion = count_samples(run.sensors), compute_acceleration_noise(run.sensors)
    acceleration = np.gradient(run.velocity, 1 / run.sensors.rate, axis=0)
    (q1, q2), (v1, v2), (a1, a2) = (
        [cut(own[:, k], size) for k in range(2)] for own in (run.exact_position, run.velocity, acceleration)
    )
    zero, l1 = np.zeros_like(q1), run.arm.length
    sine, cosine, both = np.sin(q2), np.cos(q2), q1 + q2
    coupled, centrifugal = 2 * a1 + a2, (2 * v1 + v2) * v2
    along = l1 * (cosine * coupled - sine * centrifugal) + GRAVITY * np.sin(both)
    across = l1 * (sine * coupled + cosine * centrifugal) - GRAVITY * np.cos(both)
    shoulder = [a1, GRAVITY * np.sin(q1), GRAVITY * np.cos(q1), a1 + a2, along, across, v1, np.sign(v1), zero, zero]
    along = l1 * (cosine * a1 + sine * v1**2) + GRAVITY * np.sin(both)
    across = l1 * (sine * a1 - cosine * v1**2) - GRAVITY * np.cos(both)
    elbow = [zero, zero, zero, a1 + a2, along, across, zero, zero, v2, np.sign(v2)]
    rows = []
    for k, (columns, v) in enumerate(((shoulder, v1), (elbow, v2))):
        is_clear = (np.ptp(np.sign(v), axis=1) == 0) & (np.abs(v).min(axis=1) > 0)
        inertia = run.arm.mass_matrix(np.zeros(2))[k].sum()
        noise = np.hypot(run.noise[k] / np.sqrt(size), inertia * noise_of_motion)
        rows.append(np.column_stack([own.mean(axis=1)[is_clear] for own in columns]) / noise)
    names = ["Iyy@shoulder", "mz@shoulder", "mx@shoulder", "Iyy@elbow", "mz@elbow", "mx@elbow"]
    names += [f"{id}@{name}" for name in JOINTS for id in ("viscous", "coulomb")]
    return compute_errors(np.concatenate(rows), {name: run.truth[name] for name in names})


# ------------------------------------------------------------------------------------------------- retellings

Retelling = Callable[[Log, ArmRun, Rng], Log]


def log_arm(run: ArmRun) -> Log:
    """Return the log with time from zero, positions [rad] and torques [N m]."""
    columns = {"time": run.time}
    columns |= {f"position_{name}": run.position[:, k] for k, name in enumerate(JOINTS)}
    return Log(columns | {f"torque_{name}": run.torque[:, k] for k, name in enumerate(JOINTS)})


def _shift_zero(log: Log, run: ArmRun, rng: Rng) -> Log:
    """Return the log with another zero of a joint: at the elbow, the moment of mass turns in the forearm's frame."""
    joint, shift = str(rng.choice(JOINTS)), float(rng.choice([np.pi / 2, -np.pi / 2, np.pi]))
    name, moment = f"position_{joint}", run.truth["mz@elbow"]
    turned = {"mx@elbow": moment * np.sin(shift), "mz@elbow": moment * np.cos(shift)} if joint == "elbow" else {}
    return replace(log.change(**{name: log.columns[name] + shift}), truth=turned)


def _flip_both(log: Log, run: ArmRun, rng: Rng) -> Log:
    joint = rng.choice(JOINTS)
    return log.change(**{name: -log.columns[name] for name in (f"position_{joint}", f"torque_{joint}")})


def _delay_torque(log: Log, run: ArmRun, rng: Rng) -> Log:
    """Return the log with the torque of a joint late."""
    name, late = f"torque_{rng.choice(JOINTS)}", max(1, round(draw_size(rng, 0.002, 0.02) * run.sensors.rate))
    torque = log.columns[name]
    return log.change(**{name: np.concatenate([np.full(late, torque[0]), torque[:-late]])})


def _rename_columns(log: Log, run: ArmRun, rng: Rng) -> Log:
    """Return the log with other spellings of quantity and joint."""
    position, torque = [("q", "tau"), ("pos", "effort"), ("angle", "current_torque"), ("position", "effort")][
        int(rng.integers(4))
    ]
    style = [lambda own, k: f"{own}_{JOINTS[k]}", lambda own, k: f"{JOINTS[k]}/{own}", lambda own, k: f"{own}_{k + 1}",
             lambda own, k: f"{own}[{k}]"][int(rng.integers(4))]  # fmt: skip
    names = {f"position_{name}": style(position, k) for k, name in enumerate(JOINTS)}
    return log.rename(**names, **{f"torque_{name}": style(torque, k) for k, name in enumerate(JOINTS)})


RETELLINGS: dict[str, Retelling] = {
    **COMMON,
    "other zero": _shift_zero,
    "both signs": _flip_both,
    "torque late": _delay_torque,
    "renamed": _rename_columns,
}


def draw_arm(rng: Rng, row: str, motion: str | None = None) -> Scenario:
    """Draw an arm, its motion, and its retold log."""
    motion = motion or str(rng.choice([*MOTIONS], p=[0.7, 0.3]))
    (arm, size), hidden = draw_machine(rng), tuple[str, ...]()
    if rng.random() < 0.3:
        arm, id = hide_effect(rng, arm, size)
        hidden = (id,)
    counts = int(rng.choice([4096, 16_384, 65_536, 1_000_000]))
    run = run_arm(rng, arm, size, motion, Sensors(float(rng.choice([200, 500, 1000])), 12.0, counts))
    log = RETELLINGS[row](log_arm(run), run, rng)
    write = partial(_write_files, arm=arm, log=log)
    return Scenario("arm", row, motion, hidden, {**run.truth, **log.truth}, bound_errors(run), write)


def _write_files(folder: Path, arm: TwoLink, log: Log) -> list[str]:
    path = folder / "arm.urdf"
    path.write_text(arm.urdf(), encoding="utf-8")
    return [*log.write(folder), "--robot", str(path), *log.make_options()]
