"""Torque of a servo in a recording: as its drive asked for it, or as the logged output makes it."""

from dataclasses import replace

import numpy as np
import scipy

from pendulum_env._typing import Array
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.record import Recording
from pendulum_env.recording.sampling import average_torque
from pendulum_env.recording.vocabulary import OUTPUTS
from pendulum_env.servo.drive import ServoDrive
from pendulum_env.servo.loop import GAINS, compute_gains, compute_output

FINE = 500.0  # [Hz], at least, of a controller that acts all the time


def has_unknown_integral(recording: Recording) -> bool:
    """Return whether no known load tells the torque, as it is that of a controller with an integral part."""
    return recording.actuator.ki > 0 and recording.torque_unit != NEWTON_METRE


def get_bus_voltage(recording: Recording) -> Array:
    """Return the voltage of the bus (N,) [V]: as recorded, or else what the drive says, 1 without either."""
    if recording.supply is not None:
        return recording.supply
    return np.full(len(recording), recording.actuator.supply or 1.0)


def compute_asked_torque(recording: Recording) -> Array:
    """Return the torque (N,) that the drive asked for along a recording with a reference, in the drive's unit.

    An integral is zero at the begin of each segment. With one, or with the derivative of the error, it is the mean
    torque over each sample, along a spline through the positions.
    """
    parts = []
    for part in recording.segments:
        assert part.reference is not None  # there is no drive without one
        # a drive acts on its own estimate of the speed, which a log may have
        velocity = np.gradient(part.position, part.time) if part.velocity is None else part.velocity
        if depends_on_past(part.actuator):
            output = part.powered * _follow_controller(part, part.reference)
            parts.append(part.actuator.scale(get_bus_voltage(part)) * output)
        else:
            given = part.reference, part.position, velocity, get_bus_voltage(part), part.powered
            parts.append(part.actuator.torque(*given))
    return np.concatenate(parts)


def depends_on_past(drive: ServoDrive) -> bool:
    """Return whether the output of a controller depends on earlier errors."""
    return drive.ki > 0 or (drive.kd > 0 and drive.derivative == "error")


def _follow_controller(part: Recording, goal: Array) -> Array:
    """Return the mean output (N,) over each sample of a controller that looks at a measured motion in its turns.

    A speed that the log lacks is the difference of the last two positions that the controller saw.
    """
    drive = part.actuator
    rate = drive.rate or max(part.rate, FINE)
    gains = dict(zip(GAINS, compute_gains(drive, 1.0 / rate), strict=True))
    count, known = int(len(part) * rate / part.rate) + 1, np.arange(len(part), dtype=np.float64)
    samples = np.arange(count, dtype=np.float64) * part.rate / rate
    last = np.minimum((samples + 1e-6).astype(np.intp), len(part) - 1)
    motion = scipy.interpolate.CubicSpline(known, part.position)
    position = motion(np.minimum(samples, known[-1]))
    if part.velocity is not None:
        speed = np.interp(samples, known, part.velocity)
    elif drive.rate:
        speed = np.diff(position, prepend=motion(-part.rate / rate)) * rate
    else:
        speed = motion(np.minimum(samples, known[-1]), 1) * part.rate
    wanted = np.interp(samples, known, goal) if drive.goal == "ramp" else goal[last]
    error = wanted - (speed if drive.acts_on_speed else position)
    if drive.derivative == "error":
        speed = speed - np.diff(wanted, prepend=wanted[0]) * rate
    seen = scipy.signal.lfilter([gains["seen"]], [1.0, gains["seen"] - 1.0], speed)
    damping, integral, outputs = (0.0 if drive.acts_on_speed else drive.kd) * seen, 0.0, []
    for k, on in enumerate(part.powered[last]):
        output, grown = compute_output(error[k], damping[k], integral, gains)
        integral = grown if on else 0.0
        outputs.append(output)
    return average_torque(known, 1.0, samples, np.array(outputs))


def replace_drive(recording: Recording, drive: ServoDrive) -> Recording:
    """Return a recording with another drive, and the torque that this one asks for if none was logged."""
    changed = replace(recording, drive=drive)
    is_asked = depends_on_past(drive) and not recording.has_logged_torque
    return replace(changed, torque=compute_asked_torque(changed)) if is_asked else changed


def complete_torque(recording: Recording) -> Recording:
    """Return a recording with the torque that its drive asked for, or that its logged output makes, and a note."""
    drive = recording.actuator
    if not recording.has_logged_torque:
        torque, note = compute_asked_torque(recording), Note(NoteKind.TORQUE_OF_DRIVE)
    elif recording.torque_unit == OUTPUTS.get(drive.output):
        torque = drive.scale(get_bus_voltage(recording)) * recording.torque
        note = Note(NoteKind.TORQUE_BY_OUTPUT, headers=(drive.unit,), text=str(drive.output))
    else:
        return recording
    return replace(recording, torque=torque, torque_unit=drive.unit, notes=(*recording.notes, note))
