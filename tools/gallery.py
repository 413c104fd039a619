"""Pictures of the residual of a model that lacks an effect, for every effect and the real machines."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from estimators import compare, diagnose, identify
from estimators.data.fits import fit_terms
from estimators.data.preparation import find_preparation
from estimators.data.regions import compute_profiles_at
from estimators.data.split import split_recordings
from estimators.signals.residual import AXES, REGIONS, SYMBOLS, Profile, compute_profiles
from estimators.weak_form.floors import compute_noise_floor
from pendulum_env._typing import Array
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.formatting import format_number, typeset
from pendulum_env.physics import BASE, Coulomb, Inertia, Samples, Term, Viscous, effects
from pendulum_env.physics.joints import list_base_terms
from pendulum_env.plant import make_plant
from pendulum_env.recording import Recording, Source, read_recording
from pendulum_env.robot_file import find_link_reader
from pendulum_env.units import TURNING, JointUnits

SECONDS = 20.0  # length of a recording [s]
WIDTH, HEIGHT, MARGIN = 190.0, 110.0, 8.0  # of a panel [px]
LEFT = 62.0  # of the scale before the panels [px]
CENTER = 0.5 * (HEIGHT - 14)  # height of the zero line, above the text [px]
GAP = 18.0  # above the row of a joint [px]
MOTIONS = "sin_sin", "lift_and_drop", "up_and_down", "sin_time_square"  # of the XL330
SERVO_AXES = "position", "velocity", "time"
COLUMNS = {"position": "pos", "torque": "tau"}  # of the double pendulum's log
CURVE, GRID, TEXT = "#c2611f", "#8a93a5", "#7c8699"  # visible on light and dark backgrounds


def gallery(folder: Path) -> None:
    """Write one picture for each effect of the library to a folder."""
    folder.mkdir(exist_ok=True)
    for id in effects():
        recording = record(make_plant(effects=id), excitation("paper", 1, SECONDS), SECONDS, rng=1)
        _write(folder / f"{id}.svg", draw_row(f"What {id} leaves of the base model", compute_residuals(recording)))


def machines(folder: Path, data: Path) -> None:
    """Write pictures of the residuals of `docs/machines.md`."""
    folder.mkdir(exist_ok=True)
    emps = read_recording(data / "emps" / "emps.csv.gz", columns={"position": "position:m", "torque": "torque:N"})
    drawn = compute_residuals(emps, (Inertia(), Viscous(), Coulomb()), JointUnits(is_prismatic=True))
    _write(folder / "emps.svg", draw_row("What friction that is the same in both directions leaves", drawn))
    motor = read_recording(data / "odrive" / "accel_5_nocomp_first22.csv.gz")
    _write(folder / "odrive.svg", draw_row("What a rotor without cogging leaves", compute_residuals(motor)))
    pendulum = read_recording(data / "dfki" / "pd_system_identification.csv")
    _write(folder / "dfki.svg", draw_row("What the rigid model leaves", compute_residuals(pendulum)))
    _write(folder / "xl330.svg", draw_servo(data / "xl330_loop"))
    measured = {f"{name}_Joint{k}": f"{short}_meas{k}" for name, short in COLUMNS.items() for k in (1, 2)}
    double = Source(data / "dfki_double" / "c1_143601.csv.gz", columns=measured)
    _write(folder / "dfki_double.svg", draw_joints(double, data / "dfki_double" / "c1.urdf", ("Joint1", "Joint2")))
    arm = Source(data / "tx40" / "tx40.csv.gz", range=(0.1, 7.5))
    _write(folder / "tx40.svg", draw_joints(arm, data / "tx40" / "tx40.urdf", ("joint_5", "joint_6"), rotors=True))


def compute_residuals(recording: Recording, terms: Sequence[Term] = BASE, units: JointUnits = TURNING) -> list[Profile]:
    """Fit a model to a recording; return its residual over angle (within a turn), velocity, torque and time."""
    prepared, _ = split_recordings([recording], [recording])
    model, fit = fit_terms(prepared, terms)
    noise = compute_noise_floor(prepared.data.windows, model.estimates["inertia"].value)
    return compute_profiles(prepared.samples, fit.residual, noise, tuple(AXES), units)


def draw_servo(folder: Path) -> str:
    """Diagnose a servo; return the position error of the stiff recordings without and with the effect as SVG."""
    fitted, stiff = (
        [
            read_recording(folder / f"{motion}_kp{kp}.csv.gz", drive={"preset": "xl330", "kp": kp})
            for kp in gains
            for motion in MOTIONS
        ]
        for gains in ((100, 200), (400,))
    )
    found = diagnose(fitted, stiff, only=["load_dependent_friction"])
    assert found.data is not None
    recordings, rows = found.data.holdout, dict[str, str]()
    for name, step in zip(("viscous and Coulomb friction", "load dependent friction"), found.steps, strict=True):
        motion = find_preparation(recordings).simulate(step.model, recordings)
        runs = [motion.select_recording(k) for k in range(len(recordings))]
        velocity = np.concatenate([np.gradient(run.measured, run.time) for run in runs])
        samples = Samples(motion.time, motion.measured, velocity, 0 * velocity)
        units = JointUnits(torque_unit="rad")
        noise = next(iter(found.floors.values()))
        rows[f"With {name}"] = draw_row(
            f"Position error with {name}", compute_profiles(samples, motion.error, noise, SERVO_AXES, units)
        )
    return stack_rows(rows)


def draw_joints(source: Source, robot: Path, joints: Sequence[str], rotors: bool | None = None) -> str:
    """Fit the rigid links of a robot file to a recording; return its residual at some joints, a row each, as SVG."""
    links = find_link_reader().open(robot, rotors=rotors)
    recording = links.read(source)
    model = identify([recording], list_base_terms(links.hold_joints([recording]))).model
    compared = compare(model, [recording]).data
    assert compared is not None
    data = compared.parts[0]
    residual = data.residual(model.terms, model.theta)
    return stack_rows(
        {
            joint: draw_row(f"What rigid links leave at {joint}", compute_profiles_at(data, residual, joint, [*AXES]))
            for joint in joints
        }
    )


def stack_rows(rows: Mapping[str, str]) -> str:
    """Stack rows of panels below their titles, as SVG."""
    width, height = LEFT + len(AXES) * WIDTH, len(rows) * (HEIGHT + GAP)
    moved = [
        f'<g transform="translate(0 {k * (HEIGHT + GAP) + GAP:g})"><text x="{LEFT + MARGIN:g}" y="-4" '
        f'font-family="system-ui, sans-serif" font-size="11" fill="{TEXT}">{title}</text>{row}</g>'
        for k, (title, row) in enumerate(rows.items())
    ]
    size = f'width="{width:g}" height="{height:g}" viewBox="0 0 {width:g} {height:g}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{"".join(moved)}</svg>\n'


def draw_row(title: str, profiles: Sequence[Profile]) -> str:
    """Return a row of panels on one scale, which stands before them, as SVG."""
    largest = max(float(np.abs(item.mean).max()) for item in profiles) or 1.0
    unit, width = typeset(profiles[0].units.unit("N m")), LEFT + len(profiles) * WIDTH
    panels = "".join(draw_panel(item, LEFT + k * WIDTH, largest) for k, item in enumerate(profiles))
    scale = [(MARGIN + 4, f"{largest:.2g} {unit}"), (CENTER + 4, "0"), (2 * CENTER - MARGIN + 4, f"−{largest:.2g}")]
    panels += "".join(f'<text x="{LEFT:g}" y="{y:g}" text-anchor="end">{text}</text>' for y, text in scale)
    size = f'width="{width:g}" height="{HEIGHT:g}" viewBox="0 0 {width:g} {HEIGHT:g}"'
    label = f"<title>{html.escape(title)}, up to {largest:.2g} {unit}; grey: noise, ±{REGIONS.z_limit:g}σ</title>"
    style = f'font-family="system-ui, sans-serif" font-size="11" fill="{TEXT}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {style}>{label}{panels}</svg>\n'


def draw_panel(item: Profile, left: float, largest: float) -> str:
    """Return a panel with the mean residual over one quantity, zero line and noise band, as SVG."""
    inner = WIDTH - 2 * MARGIN
    low, high = float(item.edges[0]), float(item.edges[-1])
    x = left + MARGIN + inner * (item.middle - low) / ((high - low) or 1.0)

    def place(x_values: Array, values: Array) -> str:
        y = CENTER - (CENTER - MARGIN) * np.clip(values / largest, -1.0, 1.0)
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x_values, y, strict=True))

    band = place(np.r_[x, x[::-1]], np.r_[item.band, -item.band[::-1]])
    below, ends = HEIGHT - 3, (left + MARGIN, left + WIDTH - MARGIN)
    return (
        f'<polygon points="{band}" fill="{GRID}" fill-opacity="0.3"/>'
        f'<path d="M{ends[0]:g} {CENTER:g}H{ends[1]:g}" stroke="{GRID}" stroke-width="0.7"/>'
        f'<polyline points="{place(x, item.mean)}" fill="none" stroke="{CURVE}" stroke-width="1.8"/>'
        f'<text x="{ends[0]:g}" y="{below:g}">{_write_end(low, high)}</text>'
        f'<text x="{0.5 * sum(ends):g}" y="{below:g}" text-anchor="middle">{typeset(SYMBOLS[item.axis])} '
        f"[{typeset(item.unit)}]</text>"
        f'<text x="{ends[1]:g}" y="{below:g}" text-anchor="end">{_write_end(high, low)}</text>'
    )


def _write_end(end: float, other: float) -> str:
    """Write an end of an axis to two digits; 0 for an end that is small beside the other."""
    return format_number(end if abs(end) > 0.01 * abs(other) else 0.0, 2)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
