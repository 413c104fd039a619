"""Torque of a servo in a recording: as its drive asked for it, or as the logged output makes it."""

from dataclasses import replace

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.record import Recording
from pendulum_env.recording.vocabulary import OUTPUTS


def has_unknown_integral(recording: Recording) -> bool:
    """Return whether no known load tells the torque, as it is that of a controller with an integral part."""
    return recording.actuator.ki > 0 and recording.torque_unit != NEWTON_METRE


def get_bus_voltage(recording: Recording) -> Array:
    """Return the voltage of the bus (N,) [V]: as recorded, or else what the drive says, 1 without either."""
    if recording.supply is not None:
        return recording.supply
    return np.full(len(recording), recording.actuator.supply or 1.0)


def compute_asked_torque(recording: Recording) -> Array:
    """Return the torque (N,) that the drive asked for along a recording with a reference, in the drive's unit."""
    parts = []
    for part in recording.segments:
        assert part.reference is not None  # there is no drive without one
        # a drive acts on its own estimate of the speed, which a log may have
        velocity = np.gradient(part.position, part.time) if part.velocity is None else part.velocity
        parts.append(part.actuator.torque(part.reference, part.position, velocity, get_bus_voltage(part), part.powered))
    return np.concatenate(parts)


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
