"""Retellings: the same motion of the same machine, logged in another way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from benchmarks.draws import draw_size
from benchmarks.retold.logs import Log
from benchmarks.retold.machines import Run, Sensors

Array = NDArray[np.float64]
Rng = np.random.Generator

NAMES = {  # of loggers
    "time": ("t", "timestamp", "Time [s]", "time_s", "elapsed", "TIME"),
    "position": ("q", "angle", "Position (rad)", "pos", "theta", "joint_position", "actual_position"),
    "torque": ("tau", "effort", "Torque (Nm)", "torque_Nm", "u", "joint_effort", "measured_torque"),
}


def log_run(run: Run) -> Log:
    """Return the log with time from zero, position [rad] and torque [N m]."""
    recording = run.recording
    torque = recording.command if run.sensors.is_noise_unlogged else recording.torque
    return Log({"time": recording.time, "position": recording.position, "torque": torque})


class HasSensors(Protocol):
    """Run of a machine of any kind."""

    @property
    def sensors(self) -> Sensors:
        """Return the sensors of the log."""


Retelling = Callable[[Log, Run, Rng], Log]
CommonRetelling = Callable[[Log, HasSensors, Rng], Log]


def _keep(log: Log, run: HasSensors, rng: Rng) -> Log:
    return log


# ------------------------------------------------------------------------------------------------- time


def _count_from_1970(log: Log, run: HasSensors, rng: Rng) -> Log:
    scale = float(rng.choice([1.0, 1e3, 1e6]))
    stamps = (1_700_000_000 + float(rng.integers(10**7)) + log.columns["time"]) * scale
    return replace(log.change(time=stamps), texts=log.texts | {"time": ".6f" if scale == 1 else "d"})


def _jitter_clock(log: Log, run: HasSensors, rng: Rng) -> Log:
    """Return the log with stamps that are late by up to half a period, and a first step that is odd."""
    period = 1 / run.sensors.rate
    late = rng.uniform(0.0, 0.45 * period, len(log.columns["time"]))
    late[0] -= rng.uniform(0, 3) * period
    return log.change(time=log.columns["time"] + late)


def _keep_edges(log: Log, run: Run, rng: Rng) -> Log:
    """Return the log with a row per change of the encoder."""
    changed = np.append(True, np.diff(log.columns["position"]) != 0)
    return log.keep(np.flatnonzero(changed))


# ------------------------------------------------------------------------------------------------- angle


def _shift_zero(log: Log, run: Run, rng: Rng) -> Log:
    shift = float(rng.choice([np.pi / 2, -np.pi / 2, np.pi, rng.uniform(-np.pi, np.pi)]))
    return log.change(position=log.columns["position"] + shift)


def _flip_both(log: Log, run: Run, rng: Rng) -> Log:
    return log.change(position=-log.columns["position"], torque=-log.columns["torque"])


def _name_unit(log: Log, run: HasSensors, rng: Rng) -> Log:
    """Return the log with angles in degrees or turns, named in the header."""
    unit, scale = ("deg", 180 / np.pi) if rng.random() < 0.5 else ("rev", 0.5 / np.pi)
    names = log.find("position", "goal")
    return log.scale(scale, "position", "goal").rename(**{name: f"{name} [{unit}]" for name in names})


def _omit_unit(log: Log, run: Run, rng: Rng) -> Log:
    """Return the log with positions in degrees or turns, not named."""
    return log.change(position=log.columns["position"] * float(rng.choice([180 / np.pi, 0.5 / np.pi])))


def _add_turns(log: Log, run: Run, rng: Rng) -> Log:
    return log.change(position=log.columns["position"] + 2 * np.pi * float(rng.integers(-2000, 2000)))


# ------------------------------------------------------------------------------------------------- numbers


def _round_digits(log: Log, run: HasSensors, rng: Rng) -> Log:
    """Return the log with five to seven significant digits, as %g and MATLAB write them."""
    digits = int(rng.integers(5, 8))
    return replace(log, texts=log.texts | {name: f".{digits}g" for name in ("position", "torque", "goal")})


def _round_decimals(log: Log, run: Run, rng: Rng) -> Log:
    """Return the log with a fixed number of decimals of position and torque."""
    span, torque = np.ptp(log.columns["position"]), run.machine.torque
    fine = int(np.ceil(-np.log10(span))) + 4, int(np.ceil(-np.log10(torque))) + 3
    return replace(log, texts=log.texts | {"position": f".{max(fine[0], 0)}f", "torque": f".{max(fine[1], 0)}f"})


def _write_commas(log: Log, run: HasSensors, rng: Rng) -> Log:
    return replace(log, separator=";", comma=True)


# ------------------------------------------------------------------------------------------------- channels


def _log_speed_alone(log: Log, run: Run, rng: Rng) -> Log:
    """Return the log of a speed sensor with noise of a thousandth of the peak; a pendulum needs its angle, too."""
    speed = run.recording.velocity
    seen = speed + 1e-3 * np.abs(speed).max() * rng.standard_normal(len(speed))
    columns = {"time": log.columns["time"], "velocity": seen, "torque": log.columns["torque"]}
    if run.machine.kind == "pendulum":
        columns |= {"position": log.columns["position"]}
    return replace(log, columns=columns)


def _add_differences(log: Log, run: Run, rng: Rng) -> Log:
    """Return the log with a speed of backward differences, perhaps filtered."""
    speed = np.append(0.0, np.diff(log.columns["position"])) * run.sensors.rate
    if rng.random() < 0.5:
        speed = _filter_low_pass(speed, 2 * np.pi * 20 / run.sensors.rate)
    return log.change(velocity=speed)


def _filter_low_pass(series: Array, ratio: float) -> Array:
    """Return a series (N,) behind a low-pass filter from zero; `ratio` of the sampling period to the time constant."""
    share = 1 - np.exp(-ratio)
    return np.asarray(scipy.signal.lfilter([share], [1, share - 1], series))


def _log_sensor(log: Log, run: Run, rng: Rng) -> Log:
    """Return the log of a load sensor in the place of the motor's torque."""
    return replace(log.rename(torque="sensor"), named={"torque": "none", "load_torque": "sensor"})


# ------------------------------------------------------------------------------------------------- torque


def _delay_torque(log: Log, run: Run, rng: Rng) -> Log:
    late = max(1, round(draw_size(rng, 0.002, 0.1) * min(1.0, run.machine.time) * run.sensors.rate))
    torque = log.columns["torque"]
    return log.change(torque=np.concatenate([np.full(late, torque[0]), torque[:-late]]))


def _filter_torque(log: Log, run: Run, rng: Rng) -> Log:
    """Return the log with torque through a low-pass filter."""
    constant = draw_size(rng, 0.004, 0.03) * min(1.0, run.machine.time)  # [s]
    return log.change(torque=_filter_low_pass(log.columns["torque"], 1 / (run.sensors.rate * constant)))


def _log_slowly(log: Log, run: Run, rng: Rng) -> Log:
    """Return every tenth row: the torque between them is not logged."""
    return log.keep(np.arange(0, len(log.columns["time"]), 10))


def _log_current(log: Log, run: Run, rng: Rng) -> Log:
    """Return the log of a current with a peak of 0.5 to 40 A: parameters are in A."""
    constant = run.machine.torque / draw_size(rng, 0.5, 40.0)
    truth = {name: value / constant for name, value in run.truth.items()} if run.motion != "free swing" else {}
    measured = log.scale(1 / constant, "torque").rename(torque="current")
    return replace(measured, named={"torque": "current:A*?"}, truth=truth)


# ------------------------------------------------------------------------------------------------- known values


def _fix_value(log: Log, run: Run, rng: Rng) -> Log:
    name = str(rng.choice([*run.truth]))
    value = getattr(run.machine.plant, name)
    inertia = run.machine.plant.inertia
    truth = {n: own * inertia for n, own in run.truth.items()} if run.motion == "free swing" else {}
    return replace(log, options=("--fix", f"{name}={float(value)!r}"), truth=truth)


def _bound_value(log: Log, run: Run, rng: Rng) -> Log:
    name = str(rng.choice([*run.truth]))
    value = run.truth[name]
    return replace(log, options=("--bound", f"{name}={0.5 * value!r}:{2 * value!r}"))


# ------------------------------------------------------------------------------------------------- rows


def _split_file(log: Log, run: HasSensors, rng: Rng) -> Log:
    return replace(log, cuts=(float(rng.uniform(0.4, 0.7)),))


def _cut_gaps(log: Log, run: HasSensors, rng: Rng) -> Log:
    n = len(log.columns["time"])
    kept = np.ones(n, bool)
    for first in rng.integers(0, n, 3):
        kept[first : first + int(rng.integers(2, max(3, n // 20)))] = False
    kept[rng.random(n) < 0.005] = False
    return log.keep(np.flatnonzero(kept))


def _repeat_rows(log: Log, run: HasSensors, rng: Rng) -> Log:
    """Return the log with some rows written twice."""
    n = len(log.columns["time"])
    return log.keep(np.sort(np.concatenate([np.arange(n), rng.integers(0, n, n // 100)])))


def _repeat_readings(log: Log, run: HasSensors, rng: Rng) -> Log:
    """Return the log with some rows in which an encoder has its last value."""
    name = str(rng.choice(log.find("position")))
    seen = log.columns[name].copy()
    for k in np.flatnonzero(rng.random(len(seen)) < draw_size(rng, 0.001, 0.05)):
        seen[k] = seen[max(k - 1, 0)]
    return log.change(**{name: seen})


def _add_columns(log: Log, run: HasSensors, rng: Rng) -> Log:
    n = len(log.columns["time"])
    more = {
        "temperature": np.full(n, 31.0),
        "voltage": np.full(n, 24.0),
        "status": np.zeros(n),
        "id": np.arange(n) + 0.0,
    }
    return log.change(**more)


def _rename_columns(log: Log, run: Run, rng: Rng) -> Log:
    return log.rename(**{name: str(rng.choice(words)) for name, words in NAMES.items()})


def _pad_with_rest(log: Log, run: HasSensors, rng: Rng) -> Log:
    """Return the log with idle seconds before the motion, which begins at rest."""
    n = round(rng.uniform(1.0, 6.0) * run.sensors.rate)
    columns = {name: np.concatenate([np.full(n, values[0]), values]) for name, values in log.columns.items()}
    for name in log.find("torque"):
        columns[name][:n] = 0.0
    columns["time"] = np.arange(len(columns["time"])) / run.sensors.rate
    return replace(log, columns=columns)


COMMON: dict[str, CommonRetelling] = {  # of machines of every kind
    "as it is": _keep,
    "Unix clock": _count_from_1970,
    "jitter": _jitter_clock,
    "unit in header": _name_unit,
    "significant digits": _round_digits,
    "decimal comma": _write_commas,
    "split": _split_file,
    "gaps": _cut_gaps,
    "rows repeated": _repeat_rows,
    "readings repeated": _repeat_readings,
    "further columns": _add_columns,
    "idle": _pad_with_rest,
}
RETELLINGS: dict[str, Retelling] = {
    **COMMON,
    "encoder edges": _keep_edges,
    "other zero": _shift_zero,
    "both signs": _flip_both,
    "unit unnamed": _omit_unit,
    "far from zero": _add_turns,
    "decimals": _round_decimals,
    "speed alone": _log_speed_alone,
    "speed by differences": _add_differences,
    "load sensor": _log_sensor,
    "actuator noise": _keep,
    "torque late": _delay_torque,
    "torque filtered": _filter_torque,
    "fast controller": _log_slowly,
    "current": _log_current,
    "value fixed": _fix_value,
    "value bounded": _bound_value,
    "extreme machine": _keep,
    "renamed": _rename_columns,
}


def draw_sensors(rng: Rng, row: str, seconds: float) -> Sensors:
    """Draw the sensors of a row of retellings."""
    if row == "extreme machine":
        counts = int(rng.choice([400, 1024, 4096, 1_000_000]))
        return Sensors(float(rng.choice([50, 100, 200, 1000, 2000])), seconds * draw_size(rng, 0.3, 2.0), counts)
    if row == "actuator noise":
        return Sensors(500.0, seconds, noise=draw_size(rng, 0.002, 0.03), is_noise_unlogged=True)
    if row == "fast controller":
        return Sensors(2000.0, seconds, 1_000_000)
    if row == "encoder edges":
        return Sensors(1000.0, seconds, 4096)
    rate, counts = float(rng.choice([100, 200, 500, 1000])), int(rng.choice([4096, 16_384, 65_536, 1_000_000]))
    return Sensors(rate, seconds, counts)
