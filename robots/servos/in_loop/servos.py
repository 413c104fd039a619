"""Recordings of servos: whether they are, which parts are fitted, and their base model."""

from collections.abc import Sequence

from estimators.decisions.score import HELD_OUT
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env.physics import BASE, Term, list_ids
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.recording import Recording, RecordingError
from robots.servos.torque import find_drive, list_drives


def choose_parts(holdout: Sequence[Recording]) -> tuple[Part, Part]:
    """Return the parts of recordings to fit and to hold out: without held-out recordings, the end of each."""
    return (WHOLE, WHOLE) if holdout else ((0.0, 1 - HELD_OUT), (1 - HELD_OUT, 1.0))


def are_driven(recordings: Sequence[Recording]) -> bool:
    """Return whether recordings are of servos with known controllers.

    Raises:
        RecordingError: if only some of them are, or they cannot be simulated together.
    """
    first_drive = next(iter(list_drives(recordings)), None)
    if first_drive is None:
        return False
    for recording in recordings:
        name = recording.name
        if recording.drive is None:
            raise RecordingError(f"{name}: has no drive, but others have one: say its drive, or leave it out")
        drive = find_drive(recording)
        if not recording.torque.any():
            raise RecordingError(
                f"{name}: torque is 0 throughout, but a drive moves the joint: read_recording({{'time': ..., "
                "'position': ..., 'reference': ...}, drive=...) computes the torque that the drive asks for"
            )
        if drive.acts_on_speed != first_drive.acts_on_speed:
            raise RecordingError(f"{name}: controls another quantity than the others: take those apart")
        if drive.encoder != first_drive.encoder:
            raise RecordingError(f"{name}: has its encoder at another shaft than the others: take those apart")
        if recording.torque_unit != drive.unit:
            raise RecordingError(
                f"{name}: has torque in {recording.torque_unit}, but a drive that gives {drive.unit}: give the drive a "
                f"gain [N m/{drive.unit}], or leave out the one that it has"
            )
    return True


def make_base(recordings: Sequence[Recording], base: Sequence[Term] = BASE) -> tuple[Term, ...]:
    """Return the base model of servos, with a tilt of gravity if it has gravity, since a horn is mounted by hand.

    Back-EMF is added if a motor driven by a voltage is ever off; otherwise it equals viscous friction.
    """
    has_gravity = "gravity" in list_ids(base)
    added = [*([GravityTilt()] if has_gravity else []), *([BackEmf()] if has_unpowered_motor(recordings) else [])]
    return (*base, *(term for term in added if term.id not in list_ids(base)))


def has_unpowered_motor(recordings: Sequence[Recording]) -> bool:
    """Return whether a motor that a voltage drives is ever off."""
    return not all(recording.powered.all() for recording in select_voltage_drives(recordings))


def select_voltage_drives(recordings: Sequence[Recording]) -> list[Recording]:
    """Return the recordings with a drive that gives the motor a voltage, not a torque."""
    return [r for r in recordings if any(drive.output in ("duty", "voltage") for drive in list_drives([r]))]
