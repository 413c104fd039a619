"""Actuators of MuJoCo: a motor, which takes a torque, and a servo: a spring to the goal, a damper and a limit."""

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from pendulum_env.physics import Model, has_link
from pendulum_env.physics.actuation import ActuatorLag
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.servo import UNIT, ServoDrive
from workbench.export.request import ExportError, Request


@dataclass(frozen=True)
class Motor:
    """A motor behind a lag and a delay."""

    step: float  # [s]
    held: tuple[str, ...] = ("torque_offset", "coulomb_asymmetry", "actuator_lag", "dead_time")  # effects that it has
    missing: tuple[str, ...] = ()

    def actuate(self, mujoco: Any, actuator: Any, model: Model, offset: float) -> None:
        """Make an actuator of MuJoCo a motor."""
        actuator.set_to_motor()
        delay = sum(term.delay for term in model.terms)
        for term in model.terms:
            if isinstance(term, ActuatorLag):
                actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
                actuator.dynprm = [term.time_constant, *([0.0] * 9)]
                actuator.actearly = True  # what the filter reaches in a step acts in all of it: half a step early
                delay += 0.5 * self.step
        if delay:
            actuator.delay, actuator.interp = delay, 1  # between commands, as ours
            actuator.nsample = math.ceil(delay / self.step) + 2


@dataclass(frozen=True)
class Servo:
    """A drive as gains at the joint: the torque is gain times goal, less gain times angle, less damping times speed."""

    stiffness: float  # torque by the error of the angle [N m/rad]
    damping: float  # torque by the speed, or by its error under velocity control [N m s/rad]
    limit: float  # largest torque [N m], perhaps infinite
    acts_on_speed: bool
    missing: tuple[str, ...]  # what of the drive this is not
    held: tuple[str, ...] = ("torque_offset", "coulomb_asymmetry")  # effects that it has

    @classmethod
    def from_drive(cls, drive: ServoDrive) -> Self:
        """Return the gains of a drive under its supply; raises ExportError if it needs an unknown supply."""
        scale = float(drive.scale(np.array(get_supply(drive))))
        missing = []
        if drive.ki:
            missing.append("an integral of the error (ki): it is left out")
        if drive.rate is not None:
            missing.append(f"a controller at {drive.rate:g} Hz: it looks at every step")
        if drive.cutoff is not None:
            missing.append("a filter of the speed (cutoff): it is left out")
        if drive.delay:
            missing.append(f"a delay of {drive.delay:g} s from measuring to acting: it is left out")
        stiffness, damping = (0.0, drive.kp) if drive.acts_on_speed else (drive.kp, drive.kd)
        return cls(stiffness * scale, damping * scale, drive.most * scale, drive.acts_on_speed, tuple(missing))

    def actuate(self, mujoco: Any, actuator: Any, model: Model, offset: float) -> None:
        """Make an actuator of MuJoCo a servo, whose limit includes the offset of the torque."""
        if self.acts_on_speed:
            actuator.set_to_velocity(kv=self.damping)
        else:
            actuator.set_to_position(kp=self.stiffness, kv=self.damping)
        if math.isfinite(self.limit):
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = -self.limit - offset, self.limit - offset


def choose_actuator(request: Request) -> Motor | Servo:
    """Return the actuator of a request; raises ExportError as `Servo.from_drive`."""
    return Motor(request.step) if request.drive is None else Servo.from_drive(request.drive)


def convert_request(model: Model, request: Request) -> Request:
    """Return a request whose drive, if any, has torque in the unit of a model.

    Raises:
        ExportError: without the gain of the drive, or if play or elasticity is between the drive and its encoder.
    """
    if (drive := request.drive) is None:
        return request
    known = model.torque_constant
    if drive.gain is None and known is not None and known.unit == f"{NEWTON_METRE}/{UNIT[drive.output]}":
        drive = replace(drive, gain=known.value)
    if drive.unit != model.torque_unit:
        raise ExportError(
            f"the model is in {model.torque_unit}, but the drive gives {drive.unit}: give the drive its gain, or take "
            "a model in that unit"
        )
    if drive.encoder == "output" and has_link(model.terms):
        raise ExportError(
            "the drive reads the link behind the gear, which no format has: export without the drive, or leave out "
            "play and elasticity"
        )
    return replace(request, drive=drive)


def get_supply(drive: ServoDrive) -> float:
    """Return the voltage of the bus [V], for an output that is a share of it; raises ExportError if it is unknown."""
    if drive.supply is None and drive.output == "duty":
        raise ExportError("a duty is a share of the bus: say its voltage, as --drive output=duty,kp=0.6,supply=12")
    return drive.supply or 1.0
