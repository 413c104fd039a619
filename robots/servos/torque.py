"""Torque of a servo in a recording, computed from its goal or from its logged output."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import scipy

from pendulum_env._typing import Array
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.record import Recording, complete_torque
from pendulum_env.recording.sampling import average_torque
from robots.servos.drive import ServoDrive
from robots.servos.loop import GAINS, compute_gains, compute_output

FINE = 500.0  # [Hz], least rate of the simulation of a continuous controller


def find_drive(recording: Recording) -> ServoDrive:
    """Return the drive of a recording that has one."""
    assert isinstance(recording.drive, ServoDrive)
    return recording.drive


def list_drives(recordings: Iterable[Recording]) -> list[ServoDrive]:
    """List the drives of recordings, without those that have none."""
    return [recording.drive for recording in recordings if isinstance(recording.drive, ServoDrive)]


def get_bus_voltage(recording: Recording) -> Array:
    """Return the bus voltage (N,) [V]: recorded, else of the drive, else 1."""
    if recording.supply is not None:
        return recording.supply
    return np.full(len(recording), next((drive.supply for drive in list_drives([recording])), None) or 1.0)


def compute_commanded_torque(recording: Recording) -> Array:
    """Return the commanded torque (N,) [unit of the drive] along a recording with a reference.

    The integral is zero at the start of each segment. With an integral or the derivative of the error, the result is
    the mean torque over each sample, along a spline through the positions.
    """
    parts = []
    for part in recording.segments:
        assert part.reference is not None  # recordings with a drive have one
        # logged velocity is the drive's own estimate
        velocity = np.gradient(part.position, part.time) if part.velocity is None else part.velocity
        drive = find_drive(part)
        if depends_on_past(drive):
            output = part.powered * _follow_controller(part, part.reference)
            parts.append(drive.scale(get_bus_voltage(part)) * output)
        else:
            motion = part.reference, part.position, velocity, get_bus_voltage(part), part.powered
            parts.append(drive.torque(*motion))
    return np.concatenate(parts)


def depends_on_past(drive: ServoDrive) -> bool:
    """Return whether the output of a controller depends on earlier errors."""
    return drive.ki > 0 or (drive.kd > 0 and drive.derivative == "error")


def _follow_controller(part: Recording, goal: Array) -> Array:
    """Return the mean output (N,) over each sample of a controller along the measured motion.

    Without logged speed, the controller uses the difference of its last two positions, at first that of the next two.
    """
    drive = find_drive(part)
    rate = drive.rate or max(part.rate, FINE)
    gains = dict(zip(GAINS, compute_gains(drive, 1.0 / rate), strict=True))
    count, rows = int(len(part) * rate / part.rate) + 1, np.arange(len(part), dtype=np.float64)
    samples = np.arange(count, dtype=np.float64) * part.rate / rate
    row = np.minimum((samples + 1e-6).astype(np.intp), len(part) - 1)
    motion = scipy.interpolate.CubicSpline(rows, part.position)
    position = motion(np.minimum(samples, rows[-1]))
    if part.velocity is not None:
        speed = np.interp(samples, rows, part.velocity)
    elif drive.rate:
        speed = np.diff(position, prepend=2 * position[0] - position[min(1, count - 1)]) * rate
    else:
        speed = motion(np.minimum(samples, rows[-1]), 1) * part.rate
    goals = follow_goals(goal, samples) if drive.goal == "ramp" else goal[row]
    error = goals - (speed if drive.acts_on_speed else position)
    if drive.derivative == "error":
        speed = speed - np.diff(goals, prepend=goals[0]) * rate
    filtered = scipy.signal.lfilter([gains["speed_weight"]], [1.0, gains["speed_weight"] - 1.0], speed)
    damping, integral, outputs = (0.0 if drive.acts_on_speed else drive.kd) * filtered, 0.0, []
    for k, is_powered in enumerate(part.powered[row]):
        output, new_integral = compute_output(error[k], damping[k], integral, gains)
        integral = new_integral if is_powered else 0.0
        outputs.append(output)
    return average_torque(rows, 1.0, samples, np.array(outputs))


def follow_goals(goals: Array, samples: Array) -> Array:
    """Return goals (N,) that run on between rows, at `samples` [rows] (M,); the last one stays.

    A cubic by the slopes of the neighbouring rows: straight runs stay straight, and steps do not overshoot widely.

    Source: Akima, Journal of the ACM 17(4), 1970.
    """
    last = len(goals) - 1
    if last < 2:
        return np.interp(samples, np.arange(last + 1), goals)
    return np.asarray(scipy.interpolate.Akima1DInterpolator(np.arange(last + 1), goals)(np.minimum(samples, last)))


def replace_drive(recording: Recording, drive: ServoDrive) -> Recording:
    """Return the recording with another drive, and its commanded torque if none was logged."""
    if drive == recording.drive:
        return recording
    result = replace(recording, drive=drive)
    is_recomputed = depends_on_past(drive) and not recording.has_logged_torque
    return replace(result, torque=compute_commanded_torque(result)) if is_recomputed else result


@complete_torque.register
def _complete_torque(drive: ServoDrive, recording: Recording) -> Recording:
    """Return the recording with the torque from its drive or its logged output, and a note."""
    if not recording.has_logged_torque:
        torque, note = compute_commanded_torque(recording), Note(NoteKind.TORQUE_OF_DRIVE)
    elif recording.torque_unit == drive.logged_unit:
        torque = drive.scale(get_bus_voltage(recording)) * recording.torque
        note = Note(NoteKind.TORQUE_BY_OUTPUT, headers=(drive.unit,), text=str(drive.output))
    else:
        return recording
    return replace(recording, torque=torque, torque_unit=drive.unit, notes=(*recording.notes, note))
