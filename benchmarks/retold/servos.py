"""Scenarios of a servo in its loop: goals and positions of several recordings are logged, and no torque.

The output of the controller is kp (goal - position) within its limit, a duty or a current.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.draws import draw_size
from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, simulate
from benchmarks.retold.bound import bound_errors
from benchmarks.retold.logs import Log
from benchmarks.retold.machines import Machine, Run, Sensors
from benchmarks.retold.retellings import COMMON, Rng
from benchmarks.retold.scenario import Scenario
from benchmarks.servos import SHOWN
from benchmarks.user_logs import draw_servo as draw_plant

Array = NDArray[np.float64]
Effects = dict[str, dict[str, float]]

CYCLES = 1000.0  # of the controller [Hz]
COUNTS = 4096  # of the encoder a turn
RECORDINGS, HELD_OUT = 5, 2
HIDDEN = ("load_dependent_friction", "quadratic_drag", "viscous_asymmetry", "coulomb_asymmetry", "cogging", "dead_time")


@dataclass(frozen=True)
class Servo:
    """Servo with its controller.

    Attributes:
        plant: with its effects.
        output: of the controller, duty or current.
        scale: torque per unit of the output [N m].
        limit: of the output.
        supply: voltage of the bus [V].
        stiffness: torque per error at the smaller gain [N m/rad].
    """

    plant: Plant
    output: str
    scale: float
    limit: float
    supply: float
    stiffness: float

    def describe(self, is_supply_logged: bool) -> list[str]:
        """Return the lines of `[drive]` in a study."""
        of_duty = [f"gain = {self.scale / self.supply!r}"]
        of_duty += [] if is_supply_logged else [f"supply = {self.supply!r}"]
        lines = [f'output = "{self.output}"', f"limit = {self.limit!r}", f"rate = {CYCLES:g}"]
        return ["[drive]", *lines, *(of_duty if self.output == "duty" else [f"gain = {self.scale!r}"])]


def draw_machine(rng: Rng, output: str, effects: Sequence[str]) -> Servo:
    """Draw a servo of 0.5 to 15 N m."""
    size, plant, stiffness = draw_size(rng, 0.2, 5.0), draw_plant(rng), 3.0 * rng.uniform(3.0, 5.0)
    laws: Effects = {id: SHOWN[id](rng, plant.gravity, plant.coulomb) for id in effects}
    if "dead_time" in laws:  # so short that the larger gain does not oscillate
        longest = CYCLES * plant.viscous / (2 * stiffness)
        laws["dead_time"] = {"dead_n": float(max(1, round(longest * rng.uniform(0.3, 0.6))))}
    unscaled = ("cog_n", "dead_n")
    laws = {
        id: {name: value if name in unscaled else value * size for name, value in law.items()}
        for id, law in laws.items()
    }
    base = {name: getattr(plant, name) * size for name in ("inertia", "gravity", "viscous", "coulomb")}
    torque, supply = 3.0 * size, float(rng.choice([7.4, 12.0, 24.0]))
    limit = 1.0 if output == "duty" else draw_size(rng, 0.5, 10.0)
    return Servo(Plant(**base, effects=laws), output, torque / limit, limit, supply, stiffness * size)


# ------------------------------------------------------------------------------------------------- motions


def _smooth_goals(rng: Rng, time: Array) -> Array:
    wave = np.sin(np.outer(time, rng.uniform(0.5, 7.5, 6)) + rng.uniform(0, 2 * np.pi, 6)) @ rng.uniform(0.15, 0.6, 6)
    return np.asarray(wave * (1 - np.exp(-time / 0.5)))  # starts at zero


def _steps_of_goals(rng: Rng, time: Array) -> Array:
    edges = np.cumsum(rng.uniform(0.4, 1.6, int(time[-1] / 0.4) + 2))
    levels = np.append(0.0, rng.uniform(-1.2, 1.2, len(edges)))
    return np.asarray(levels[np.searchsorted(edges, time, side="right")])


def _slow_triangle(rng: Rng, time: Array) -> Array:
    phase = time / time[-1] * rng.uniform(2.0, 4.0)
    return np.asarray(rng.uniform(0.8, 1.5) * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * phase)))


MOTIONS: dict[str, Sequence[Callable[[Rng, Array], Array]]] = {  # of the recordings in turn
    "smooth goals": (_smooth_goals,),
    "steps of goals": (_steps_of_goals,),
    "slow triangle": (_slow_triangle,),
    "mixed goals": (_smooth_goals, _steps_of_goals, _smooth_goals, _slow_triangle),
}
SHARES = (0.45, 0.2, 0.1, 0.25)  # of MOTIONS


@dataclass(frozen=True)
class Sampling:
    """Rate of the log [Hz], cycles of the controller between two goals, idle seconds at the ends, duration."""

    rate: float
    hold: int
    idle: float = 0.0
    seconds: float = 10.0


def draw_sampling(rng: Rng, row: str) -> Sampling:
    """Draw the sampling of a row; goals change with the rows of the log unless the row says otherwise."""
    rate = float(rng.choice([25.0, 40.0, 50.0] if row == "slow log" else [100.0, 125.0, 200.0]))
    hold = {"slow log": 1, "slow goals": int(rng.choice([20, 40]))}.get(row, round(CYCLES / rate))
    return Sampling(rate, hold, float(rng.uniform(1.0, 3.0)) if row == "idle" else 0.0)


def run_servo(rng: Rng, servo: Servo, motion: str, sampling: Sampling) -> list[Run]:
    """Simulate the recordings of a servo, each second one with twice the stiffness, at the rows of the log."""
    torque, every = servo.scale * servo.limit, round(CYCLES / sampling.rate)
    machine = Machine("pendulum", servo.plant, torque, 1.0, 1.0)
    cases, goals = [], []
    for k in range(RECORDINGS):
        stiffness = servo.stiffness * (1 + k % 2)
        experiment = Experiment(
            CYCLES, sampling.seconds + 2 * sampling.idle, "pd_loop", seed=int(rng.integers(2**31)), counts=COUNTS,
            torque_noise=0.0, gains=(stiffness, 0.0), torque_limit=torque, control="servo", goal_hold=sampling.hold,
        )  # fmt: skip
        time = np.arange(experiment.samples) / CYCLES
        moving = MOTIONS[motion][k % len(MOTIONS[motion])]
        goals.append(moving(rng, np.clip(time - sampling.idle, 0.0, sampling.seconds)))
        cases.append((servo.plant, experiment))
    sensors = Sensors(sampling.rate, sampling.seconds, COUNTS, noise=0.0)
    recordings = [take_rows(recording, every) for recording in simulate(cases, goals=goals)]
    return [Run(machine, motion, sensors, own, tuple(servo.plant.effects), ()) for own in recordings]


def take_rows(recording: SimulatedRecording, every: int) -> SimulatedRecording:
    """Return a recording with each n-th sample."""
    series = [own.name for own in fields(recording) if isinstance(getattr(recording, own.name), np.ndarray)]
    return replace(recording, **{name: getattr(recording, name)[::every] for name in series})


# ------------------------------------------------------------------------------------------------- retellings

NAMES = {
    "time": ("t", "timestamp", "Time [s]", "elapsed"),
    "position": ("q", "angle", "actual_position", "joint_position", "pos"),
    "goal": ("reference", "setpoint", "goal_position", "desired_position", "position_command"),
}
Retelling = Callable[[Log, Run, Rng], Log]


def _keep(log: Log, run: Run, rng: Rng) -> Log:
    return log


def _count_positions(log: Log, run: Run, rng: Rng) -> Log:
    counted = log.scale(COUNTS / (2 * np.pi), "position", "goal")
    named = {"position": f"position:counts/{COUNTS}", "reference": f"goal:counts/{COUNTS}"}
    return replace(counted, texts=log.texts | {"position": "d", "goal": ".3f"}, named=named)


def _rename_columns(log: Log, run: Run, rng: Rng) -> Log:
    return log.rename(**{name: str(rng.choice(words)) for name, words in NAMES.items()})


RETELLINGS: dict[str, Retelling] = {
    **COMMON,
    "counts": _count_positions,
    "slow goals": _keep,
    "slow log": _keep,
    "renamed": _rename_columns,
    "supply logged": _keep,
    "current": _keep,
    "idle": _keep,  # at both ends of the motion
}


def draw_servo(rng: Rng, row: str, motion: str | None = None) -> Scenario:
    """Draw a servo, its recordings, and their retold logs."""
    drawn = str(rng.choice([*MOTIONS], p=SHARES))
    motion = motion or (drawn if row != "slow log" else "smooth goals")  # steps between rows are not logged
    is_hidden = motion in ("smooth goals", "mixed goals") and rng.random() < 0.4
    output = "current" if row == "current" or (row != "supply logged" and rng.random() < 0.3) else "duty"
    servo = draw_machine(rng, output, [str(rng.choice(HIDDEN))] if is_hidden else [])
    runs = run_servo(rng, servo, motion, draw_sampling(rng, row))
    seed = int(rng.integers(2**31))  # one retelling for all recordings
    logs = [RETELLINGS[row](log_goals(run, servo, row), run, np.random.default_rng(seed)) for run in runs]
    write = partial(_write_files, servo=servo, logs=logs, is_supply_logged=row == "supply logged")
    return Scenario("servo", row, motion, runs[0].hidden, {**runs[0].truth, **logs[0].truth}, bound_errors(runs), write)


def log_goals(run: Run, servo: Servo, row: str) -> Log:
    """Return the log with time from zero, position and goal [rad], and perhaps the supply [V]."""
    recording = run.recording
    columns = {"time": recording.time, "position": recording.position, "goal": recording.goal}
    columns |= {"volts": np.full(len(recording.time), servo.supply)} if row == "supply logged" else {}
    return Log(columns)


def _write_files(folder: Path, servo: Servo, logs: Sequence[Log], is_supply_logged: bool) -> list[str]:
    """Write the logs and a study."""
    lines = servo.describe(is_supply_logged)
    if named := logs[0].named:
        lines += ["[columns]", *(f'{quantity} = "{text}"' for quantity, text in named.items())]
    for k, log in enumerate(logs):
        gain = servo.stiffness * (1 + k % 2) / servo.scale
        for file in log.write(folder, f"log{k}_"):
            lines += ["[[recording]]", f'file = "{Path(file).name}"', f"drive = {{kp = {gain!r}}}"]
            lines += ['role = "holdout"'] * (k >= RECORDINGS - HELD_OUT)
    path = folder / "servo.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [str(path)]
