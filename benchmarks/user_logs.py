"""Fresh variants of logs as users have them: what `diagnose` names, and its parameters against the truth.

    python -m benchmarks.user_logs ROW --seeds 4500:4510        # nine of ten variants should be right

A seed draws machine, rate, encoder and noise. The independent simulator moves the machine, and the log is written as
the tool of the row writes it: time stamps of 1970, angles in turns, words and empty cells, structures of MATLAB. A
variant is right if exactly the hidden effect is named, nothing else is unexplained, and each parameter is within three
standard errors. The row `coarse` feeds `OnlineEstimator` with default settings, and judges all of its schemes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.draws import draw_size
from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, simulate
from estimators.online import OnlineEstimator
from workbench.cli import main as run_command
from workbench.terminal import Terminal

Array = NDArray[np.float64]
Effects = dict[str, dict[str, float]]

MOST = 3.0  # standard errors
NOTHING: tuple[str, ...] = ()
EITHER_OFFSET = ("torque_offset", "coulomb_asymmetry")  # no recording of one mounting distinguishes them
SUPPLY, CONSTANT = 12.0, 0.25  # V, N m/V of the servos
MATLAB = b"MATLAB 7.3 MAT-file".ljust(128)


@dataclass(frozen=True)
class Variant:
    """Log of one machine with its truth.

    Attributes:
        setting: rate, encoder and other differences between variants.
        arguments: of `diagnose`.
        truth: parameters by name; empty if a table explains the hidden law.
        effects: hidden effect, or effects that look the same.
        tables: ids of tables that explain what is hidden.
    """

    setting: str
    arguments: Sequence[object]
    truth: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[str, ...] = NOTHING
    tables: tuple[str, ...] = NOTHING


class Judgement(NamedTuple):
    """Result of a variant: its setting, what is named, the largest deviation [standard errors], and the verdict."""

    setting: str
    named: str
    z: float
    parameter: str
    is_right: bool


def draw_plant(rng: np.random.Generator, effects: Effects | None = None) -> Plant:
    """Draw a machine between 0.5 and 5 N m, with friction of a tenth to a half of that."""
    size, shares = draw_size(rng, 0.5, 5.0), rng.uniform((0.02, 0.05, 0.1), (0.06, 0.15, 0.4))
    inertia, viscous, coulomb = (size * shares).tolist()
    return Plant(inertia, size, viscous, coulomb, effects or {})


def draw_sensors(rng: np.random.Generator, least_rate: float = 100.0) -> tuple[float, int]:
    """Draw a rate [Hz] and encoder counts per turn."""
    rates = [rate for rate in (100.0, 125.0, 200.0, 250.0, 500.0, 1000.0) if rate >= least_rate]
    return float(rng.choice(rates)), int(rng.choice([4096, 8192, 16_384, 65_536, 1_024_000]))


def draw_sines(rng: np.random.Generator, time: Array, peak: float, n: int = 2) -> Array:
    """Draw a torque of some sines between 0.2 and 2.5 Hz with a peak [N m]."""
    frequencies = 2 * np.pi * np.geomspace(0.2, 2.5, n + 1)[:-1] * rng.uniform(1.0, (2.5 / 0.2) ** (1 / n), n)
    torque = np.sin(np.outer(time, frequencies) + rng.uniform(0, 2 * np.pi, n)) @ rng.uniform(0.6, 1.0, n)
    return np.asarray(torque * peak / np.abs(torque).max())


def move(rng: np.random.Generator, plant: Plant, experiment: Experiment, n_sines: int = 2) -> SimulatedRecording:
    """Simulate a plant under sines that swing it far beyond its friction."""
    grip = plant.gravity + plant.coulomb
    command = draw_sines(rng, np.arange(experiment.samples) / experiment.rate, grip * rng.uniform(1.3, 2.2), n_sines)
    return simulate([(plant, experiment)], [command])[0]


def describe(experiment: Experiment, *more: str) -> str:
    return ", ".join([f"{experiment.rate:g} Hz", f"{experiment.counts} counts", *more])


def get_truth(plant: Plant, **others: float) -> dict[str, float]:
    return {name: getattr(plant, name) for name in ("inertia", "gravity", "viscous", "coulomb")} | others


def write_table(path: Path, columns: Mapping[str, Any], formats: Sequence[str]) -> Path:
    """Write columns as CSV, each with its format."""
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(form.format(cell) for form, cell in zip(formats, row, strict=True)) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n", encoding="utf-8")
    return path


def write_plain(path: Path, run: SimulatedRecording) -> Path:
    """Write time, position and torque."""
    columns = {"time": run.time, "position": run.position, "torque": run.torque}
    return write_table(path, columns, ("{:.6f}", "{:.9g}", "{:.6g}"))


def draw_unix_clock(seed: int, folder: Path) -> Variant:
    """Stamps that count from 1970; in every third variant, noise of the torque moves the machine and is not logged."""
    rng = np.random.default_rng([seed, 1])
    plant, (rate, counts), is_hidden = draw_plant(rng), draw_sensors(rng), seed % 3 == 0
    noise = plant.gravity * (draw_size(np.random.default_rng([seed, 13]), 0.01, 0.04) if is_hidden else 0.005)
    experiment = Experiment(rate, 20.0, seed=seed, counts=counts, torque_noise=noise, noise_in_plant=is_hidden)
    run = move(rng, plant, experiment)
    unit, scale = (("s", 1), ("ms", 10**3), ("ns", 10**9))[int(rng.integers(3))]
    start = 1_700_000_000 + int(rng.integers(10**7))
    stamps = [start * scale + round(t * 1e6) * scale // 10**6 for t in run.time.tolist()]
    clock = [f"{start + t:.6f}" for t in run.time.tolist()] if unit == "s" else [str(stamp) for stamp in stamps]
    columns = {"timestamp": clock, "position": run.position, "torque": run.command if is_hidden else run.torque}
    path = write_table(folder / "log.csv", columns, ("{}", "{:.7f}", "{:.6f}"))
    return Variant(describe(experiment, unit, *["hidden noise"] * is_hidden), [path], get_truth(plant))


def draw_swing(seed: int, folder: Path) -> Variant:
    """A pendulum that is let go, with a torque of 0 or none; in every third variant, its inertia is not known."""
    rng = np.random.default_rng([seed, 2])
    inertia, (rate, _) = draw_size(rng, 2e-5, 2e-2), draw_sensors(rng, 200.0)
    gravity = inertia * draw_size(rng, 40.0, 200.0)
    plant = Plant(inertia, gravity, inertia * rng.uniform(0.3, 1.0), gravity * draw_size(rng, 0.005, 0.03))
    counts, release = int(rng.choice([4096, 8192, 16_384])), float(rng.choice([-1, 1]) * rng.uniform(1.5, 2.8))
    experiment = Experiment(rate, 12.0, seed=seed, start=(release, 0.0), counts=counts, torque_noise=0.0)
    run = simulate([(plant, experiment)], [np.zeros(experiment.samples)])[0]
    columns = {"time": run.time, "angle": run.position, "torque": run.torque}
    formats, is_known, is_bare = ["{:.6g}", "{:.6f}", "{:g}"], seed % 3 != 0, seed % 2 == 0
    if is_bare:
        del columns["torque"]
    path = write_table(folder / "swing.csv", columns, formats[: len(columns)])
    truth = get_truth(plant)
    known = ["--fix", f"inertia={inertia!r}"] if is_known else []
    if not is_known:
        truth = {name: value / inertia for name, value in truth.items()}
    del truth["inertia"]
    setting = describe(experiment, "no torque" if is_bare else "torque 0", *["relative"] * (not is_known))
    return Variant(setting, [path, *known], truth)


def draw_constant_speed(seed: int, folder: Path) -> Variant:
    """A friction test at constant speeds both ways, with an offset of the torque that is far below friction."""
    rng = np.random.default_rng([seed, 3])
    offset, size = float(rng.choice([-1, 1])) * draw_size(rng, 0.01, 0.05), draw_size(rng, 0.3, 3.0)
    coulomb, inertia = size * rng.uniform(0.3, 0.8), size * rng.uniform(0.03, 0.1)
    plant = Plant(inertia, 0.0, size * rng.uniform(0.2, 0.6), coulomb, {"torque_offset": {"offset": -offset * size}})
    (rate, counts), files = draw_sensors(rng, 200.0), []
    for k, seconds in enumerate((90.0, 60.0)):
        gains = (2.0 * size, 4.0 * size)
        experiment = Experiment(
            rate, seconds, "speed_loop", 0.25, 2 * seed + k, counts=counts, torque_noise=0.003 * size,
            torque_step=0.002, gains=gains, torque_limit=5.0 * size, control="speed",
        )  # fmt: skip
        files.append(write_plain(folder / f"{k}.csv", simulate([(plant, experiment)])[0]))
    truth = get_truth(plant, torque_offset=offset * size)
    del truth["gravity"]
    arguments = [files[0], "--holdout", files[1], "--fix", "gravity=0"]
    return Variant(describe(experiment, f"offset {offset * size:+.3f}"), arguments, truth, EITHER_OFFSET)


def draw_cable(seed: int, folder: Path) -> Variant:
    """A horizontal joint that a cable turns by a sine of the angle and a second or third harmonic."""
    rng = np.random.default_rng([seed, 4])
    size, order, phase = draw_size(rng, 0.05, 2.0), int(rng.choice([2, 3])), rng.uniform(0, 2 * np.pi)
    share = rng.uniform(0.2, 0.4)
    wave = {"cog_n": order, "cog_s": -share * size * np.cos(phase), "cog_c": -share * size * np.sin(phase)}
    inertia, friction = size * rng.uniform(0.1, 0.3), size * rng.uniform(0.5, 1.0)
    plant = Plant(inertia, size, size * rng.uniform(0.3, 0.7), friction, {"cogging": wave})
    (rate, counts), files = draw_sensors(rng, 200.0), []
    for k in range(2):
        experiment = Experiment(rate, 30.0, seed=2 * seed + k, counts=counts, torque_noise=0.01 * size)
        files.append(write_plain(folder / f"{k}.csv", move(rng, plant, experiment, 3)))
    arguments = [files[0], "--holdout", files[1], "--fix", "gravity=0"]
    return Variant(describe(experiment, f"order {order}"), arguments, tables=("torque_by_angle",))


def draw_moteus(seed: int, folder: Path) -> Variant:
    """The log of a moteus controller, with position in turns."""
    rng = np.random.default_rng([seed, 5])
    plant, (rate, counts) = draw_plant(rng), draw_sensors(rng)
    run = move(rng, plant, Experiment(rate, 25.0, seed=seed, counts=counts, torque_noise=0.003 * plant.gravity))
    turns, ones = run.position / (2 * np.pi), np.ones(len(run.time))
    columns = {
        "time": run.time, "MODE": 10 * ones, "POSITION": turns, "VELOCITY": np.gradient(turns, run.time),
        "TORQUE": run.torque, "VOLTAGE": 24 * ones, "TEMPERATURE": 31 * ones, "FAULT": 0 * ones,
    }  # fmt: skip
    formats = ("{:.6f}", "{:.0f}", "{:.8f}", "{:.6f}", "{:.5f}", "{:.1f}", "{:.0f}", "{:.0f}")
    return Variant(describe(run.experiment), [write_table(folder / "moteus.csv", columns, formats)], get_truth(plant))


def draw_booleans(seed: int, folder: Path) -> Variant:
    """A log of AdvantageScope: words, cells that are empty unless changed; every third is disabled for a while."""
    rng = np.random.default_rng([seed, 6])
    plant, (rate, counts) = draw_plant(rng), draw_sensors(rng)
    experiment = Experiment(rate, 30.0, seed=seed, counts=counts, torque_noise=0.0, torque_step=0.01)
    time, is_disabled = np.arange(experiment.samples) / rate, seed % 3 == 0
    torque = draw_sines(rng, time, (plant.gravity + plant.coulomb) * rng.uniform(1.3, 2.2))
    is_on = ~(is_disabled & (time > 12.0) & (time < 16.0))
    run = simulate([(plant, experiment)], [np.where(is_on, torque, 0.0)])[0]
    names = ("/Arm/PositionRotations", "/Arm/Torque", "/DriverStation/Enabled")
    cells = [[f"{turn:.6f}" for turn in run.position / (2 * np.pi)], [f"{own:.2f}" for own in run.torque]]
    cells.append(["true" if on else "false" for on in is_on.tolist()])
    changed = [["" if k and own == column[k - 1] else own for k, own in enumerate(column)] for column in cells]
    columns = {"Timestamp": time + round(rng.uniform(1.0, 9.0), 1), **dict(zip(names, changed, strict=True))}
    path = write_table(folder / "scope.csv", columns, ("{:.6f}", "{}", "{}", "{}"))
    return Variant(describe(experiment, *["disabled"] * is_disabled), [path], get_truth(plant))


def draw_telemetry(seed: int, folder: Path) -> Variant:
    """The telemetry of a robot as MATLAB v7.3 writes it: structures with data (N, 1, joints) in degrees."""
    import h5py

    rng = np.random.default_rng([seed, 7])
    plant, (rate, counts), joints = draw_plant(rng), draw_sensors(rng), int(rng.choice([8, 16, 32]))
    run = move(rng, plant, Experiment(rate, 20.0, seed=seed, counts=counts, torque_noise=0.003 * plant.gravity))
    own, degrees = int(rng.integers(joints)), np.degrees(run.position)
    series = {"encoders": degrees, "torque": run.torque, "velocity": np.gradient(degrees, run.time)}
    path = folder / "telemetry.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        robot, cells = file.create_group("robot"), file.create_group("#refs#")
        for name, values in series.items():
            data = np.tile(3.0 * np.arange(joints) if name == "encoders" else np.zeros(joints), (len(run.time), 1, 1))
            data[:, 0, own] = values
            group = robot.create_group(name)
            group["data"], group["timestamps"] = data, (1.6165e9 + run.time)[:, None]
            group["dimensions"] = np.array([[joints], [1.0], [len(run.time)]])
            group["name"] = np.array([[ord(sign)] for sign in name], np.uint16)
            group["name"].attrs["MATLAB_class"] = np.bytes_("char")
            group.attrs["MATLAB_class"] = np.bytes_("struct")
        links = robot.create_dataset("description_list", (1, joints), dtype=h5py.ref_dtype)
        for k in range(joints):
            cells[str(k)] = np.array([[ord(sign)] for sign in f"joint_{k}"], np.uint16)
            cells[str(k)].attrs["MATLAB_class"] = np.bytes_("char")
            links[0, k] = cells[str(k)].ref
        links.attrs["MATLAB_class"], robot.attrs["MATLAB_class"] = np.bytes_("cell"), np.bytes_("struct")
    with path.open("r+b") as raw:
        raw.write(MATLAB)
    columns = f"time=robot.encoders.timestamps,position=robot.encoders.data[{own}]:deg,torque=robot.torque.data[{own}]"
    return Variant(describe(run.experiment, f"{joints} joints"), [path, "--columns", columns], get_truth(plant))


def draw_servo(rng: np.random.Generator, effects: Effects | None = None, inertia: float | None = None) -> Plant:
    inertia = inertia or draw_size(rng, 0.008, 0.03)
    return Plant(inertia, rng.uniform(0.4, 1.2), rng.uniform(0.1, 0.35), rng.uniform(0.05, 0.12), effects or {})


def write_study(seed: int, folder: Path, plant: Plant, gains: Sequence[float], held_out: int) -> tuple[str, Path]:
    """Write logs of goals and positions, and a study with the last ones held out; `gains`: of the duty [1/rad]."""
    rng = np.random.default_rng([seed, 8])
    log, limit = float(rng.choice([100.0, 125.0, 200.0])), SUPPLY * CONSTANT
    each, lines = round(1000.0 / log), ['[drive]\ncontrol = "position"\noutput = "duty"\nlimit = 1.0\nrate = 1000']
    lines.append(f"supply = {SUPPLY}\ngain = {CONSTANT}")
    for k, gain in enumerate(gains):
        experiment = Experiment(
            1000.0, 12.0, "pd_loop", float(rng.uniform(0.3, 0.6)), 100 * seed + k, counts=4096, torque_noise=0.0,
            gains=(gain * limit, 0.0), torque_limit=limit, control="servo", goal_hold=each,
        )  # fmt: skip
        run = simulate([(plant, experiment)])[0]
        columns = {"time": run.time[::each], "position": run.position[::each], "goal": run.goal[::each]}
        write_table(folder / f"{k}.csv", columns, ("{:.9f}", "{:.9f}", "{:.9f}"))
        lines.append(f'[[recording]]\nfile = "{k}.csv"\ndrive = {{kp = {gain}}}')
        lines += ['role = "holdout"'] * (k >= len(gains) - held_out)
    path = folder / "servo.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return f"{log:g} Hz, kp {gains[0]:g}", path


def draw_play(seed: int, folder: Path) -> Variant:
    """A servo with play between its gear and its load, read at the motor, under two gains."""
    rng = np.random.default_rng([seed, 9])
    gap, share = draw_size(rng, 0.004, 0.02), rng.uniform(0.35, 0.65)
    inertia = draw_size(rng, 0.008, 0.03)
    contact = {"bl_k": draw_size(rng, 200.0, 600.0), "bl_d": rng.uniform(0.3, 0.8)}
    plant = draw_servo(rng, {"backlash": {"Jm": share * inertia, "bl_gap": gap, **contact}}, inertia)
    soft = float(rng.choice([3.0, 4.0, 5.0]))
    setting, study = write_study(seed, folder, plant, [soft] * 3 + [2 * soft] * 3, 3)
    return Variant(f"{setting}, gap {gap:.2e}", [study], get_truth(plant) | {"backlash.gap": gap}, ("backlash",))


def draw_goals(seed: int, folder: Path) -> Variant:
    """A servo whose goals are held from row to row, with nothing missing."""
    rng = np.random.default_rng([seed, 10])
    plant = draw_servo(rng)
    setting, study = write_study(seed, folder, plant, [float(rng.choice([3.0, 5.0, 8.0]))] * 5, 2)
    return Variant(setting, [study], get_truth(plant))


def draw_drifting(seed: int, folder: Path) -> Variant:
    """Dry friction that falls by a fifth to a half, within 8 s or hardly within the recording."""
    rng = np.random.default_rng([seed, 11])
    fall, fading = rng.uniform(0.3, 1.0), draw_size(rng, 5.0, 25.0)
    drift = {"drift_a": fall, "drift_T": fading, "drift_b": 0.0}
    plant, (rate, counts), files = draw_plant(rng, {"friction_drift": drift}), draw_sensors(rng), []
    for k in range(2):
        noise = 0.003 * plant.gravity
        experiment = Experiment(rate, 20.0, seed=2 * seed + k, counts=counts, position_noise=2e-4, torque_noise=noise)
        files.append(write_plain(folder / f"{k}.csv", move(rng, plant, experiment, 6)))
    effect = {"coulomb": fall * plant.coulomb, "viscous": 0.0, "warm_up": fading}
    truth = get_truth(plant) | {f"friction_drift.{name}": value for name, value in effect.items()}
    setting = describe(experiment, f"-{fall:.0%} in {fading:.0f} s")
    return Variant(setting, [files[0], "--holdout", files[1]], truth, ("friction_drift",))


DRAWS: dict[str, Callable[[int, Path], Variant]] = {
    "unix_clock": draw_unix_clock, "swing": draw_swing, "constant_speed": draw_constant_speed, "cable": draw_cable,
    "moteus": draw_moteus, "booleans": draw_booleans, "telemetry": draw_telemetry, "play": draw_play,
    "goals": draw_goals, "drifting": draw_drifting,
}  # fmt: skip


def judge_diagnosis(variant: Variant, folder: Path) -> Judgement:
    """Run `diagnose`, and compare effects and parameters with the truth."""
    out, errors = folder / "out.json", io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
        code = run_command(["diagnose", *map(str, variant.arguments), "--json", str(out)])
    if code:
        return Judgement(variant.setting, f"refused: {errors.getvalue().strip()[-120:]}", np.nan, "", False)
    found = json.loads(out.read_text(encoding="utf-8"))
    selected, tables, is_left = tuple(found["selected"]), tuple(found["tables"]), found["unexplained"]["present"]
    groups = {group[0]: tuple(group) for group in found["ambiguous"]}
    is_named = not selected if not variant.effects else len(selected) == 1 and selected[0] in variant.effects
    named = ["|".join(groups.get(id, (id,))) for id in selected] or ["nothing"]
    named += [f"table {id}" for id in tables] + ["unexplained"] * is_left
    disagreements = [finding for finding in found["findings"] if finding["family"] == "disagreement"]
    named += ["recordings disagree"] * bool(disagreements)
    if variant.tables:
        return Judgement(variant.setting, ", ".join(named), np.nan, "", is_named and tables == variant.tables)
    theta, deviations = found["steps"][-1]["theta"], {}
    for name, value in variant.truth.items():
        own = theta.get(name)
        if own and own["std"] and not own.get("biased"):
            deviations[name] = (own["value"] - value) / own["std"]
        elif is_named and not (name == "torque_offset" and name not in selected):
            named.append(f"no {name}")
    worst = max(deviations, key=lambda name: abs(deviations[name]), default="")
    z = deviations.get(worst, np.nan)
    is_right = is_named and not is_left and not disagreements and abs(z) <= MOST
    return Judgement(variant.setting, ", ".join(named), z, worst, bool(is_right))


def judge_coarse(seed: int) -> Judgement:
    """Feed `OnlineEstimator` with a coarse encoder; in every third variant, two minutes at rest follow the motion."""
    rng = np.random.default_rng([seed, 12])
    plant, rate = draw_plant(rng), float(rng.choice([100.0, 200.0, 250.0, 500.0]))
    counts, seconds, rest = 2 ** int(rng.integers(12, 15)), 20.0, 120.0 if seed % 3 == 0 else 0.0
    noise = 0.2 * 2 * np.pi / counts
    experiment = Experiment(rate, seconds + rest, seed=seed, counts=counts, position_noise=noise, torque_noise=0.0)
    time = np.arange(experiment.samples) / rate
    torque = draw_sines(rng, time, (plant.gravity + plant.coulomb) * rng.uniform(1.3, 2.0), 3)
    torque = np.where(time < seconds, torque, 0.01 * plant.gravity * rng.standard_normal(len(time)))
    run = simulate([(plant, experiment)], [torque])[0]
    estimator, before = OnlineEstimator(rate, forgetting=0.999 if rest else 1.0), np.append(0.0, run.torque[:-1])
    for sample in zip(run.time, run.position, before, strict=True):
        now = estimator.take(*(np.full(1, value) for value in sample))
    truth = np.array([get_truth(plant)[name] for name in estimator.names])
    z = (now.theta[0] - truth) / now.std[0]  # (S, P)
    scheme, column = np.unravel_index(np.argmax(np.abs(z)), z.shape)
    worst, setting = float(z[scheme, column]), describe(experiment, *["rest, forgetting 0.999"] * bool(rest))
    return Judgement(setting, estimator.schemes[scheme].id, worst, estimator.names[column], abs(worst) <= MOST)


def judge_variant(row: str, seed: int) -> Judgement:
    """Draw the variant of a row, and judge it."""
    if row == "coarse":
        return judge_coarse(seed)
    with tempfile.TemporaryDirectory() as folder:
        return judge_diagnosis(DRAWS[row](seed, Path(folder)), Path(folder))


def parse_seeds(text: str) -> range:
    """Parse `FIRST:LAST`, the last one excluded."""
    first, _, last = text.partition(":")
    return range(int(first), int(last or int(first) + 1))


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table of the variants of each row, and how many are right."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m benchmarks.user_logs", description=__doc__, formatter_class=formatter)
    rows = [*DRAWS, "coarse"]
    parser.add_argument("rows", nargs="+", metavar="ROW", choices=rows, help=", ".join(rows))
    parser.add_argument("--seeds", type=parse_seeds, default=range(10), help="FIRST:LAST (default 0:10)")
    arguments, terminal = parser.parse_args(argv), Terminal()
    headers = ("seed", "variant", "named", "largest z", "CPU [s]", "verdict")
    for row in arguments.rows:
        lines, right = [], 0
        for seed in arguments.seeds:
            begin = time.process_time()
            own = judge_variant(row, seed)
            right += own.is_right
            deviation = "" if np.isnan(own.z) else f"{own.z:+.1f} {own.parameter}"
            seconds = f"{time.process_time() - begin:.0f}"
            lines.append((str(seed), own.setting, own.named, deviation, seconds, "" if own.is_right else "WRONG"))
        terminal.print_table(headers, lines, left=headers[1:4])
        terminal.print(f"{row}: {right} of {len(arguments.seeds)} right")
    return 0


if __name__ == "__main__":
    sys.exit(main())
