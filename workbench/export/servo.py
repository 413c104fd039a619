"""Actuators of an exported joint: a motor with a torque input, and a servo with a goal input."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from pendulum_env.physics import Model, Term, has_link
from pendulum_env.physics.terms import is_pure_delay
from pendulum_env.recording.channel import NEWTON_METRE
from robots.servos import OUTPUT_UNITS, ServoDrive
from workbench.export.request import ExportError, Request

OFFSETS = ("torque_offset", "coulomb_asymmetry")  # effects of constant torque


def find_lag(terms: Sequence[Term]) -> Term | None:
    """Find the first term that is a lag of the torque, the one that MuJoCo represents."""
    return next((term for term in terms if term.lead and is_pure_delay(type(term))), None)


@dataclass(frozen=True)
class Motor:
    """Motor with lag and delay."""

    missing: ClassVar[tuple[str, ...]] = ()
    step: float  # [s]

    def list_held(self, model: Model) -> tuple[str, ...]:
        """List the ids of the effects that are included: offsets, one lag, and all delays."""
        late, lag = (term for term in model.terms if is_pure_delay(type(term))), find_lag(model.terms)
        return (*OFFSETS, *(term.id for term in late if not term.lead or term is lag))

    def actuate(self, mujoco: Any, actuator: Any, model: Model, offset: float) -> None:
        """Configure a MuJoCo actuator as the motor of a model; `offset` is unused."""
        actuator.set_to_motor()
        delay = sum(term.delay for term in model.terms)
        if (lag := find_lag(model.terms)) is not None:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            actuator.dynprm = [lag.lead, *([0.0] * 9)]
            actuator.actearly = True  # the filter's end value acts in the whole step: half a step early
            delay += 0.5 * self.step
        if delay:
            actuator.delay, actuator.interp = delay, 1  # linear interpolation, as in our simulation
            actuator.nsample = math.ceil(delay / self.step) + 2


@dataclass(frozen=True)
class Servo:
    """Drive as a proportional and derivative controller at the joint: torque = kp (goal - angle) - kd speed."""

    controller: ServoDrive

    def list_held(self, model: Model) -> tuple[str, ...]:
        """List the ids of the effects that are included."""
        return OFFSETS

    @property
    def missing(self) -> tuple[str, ...]:
        """Return the parts of the drive that MuJoCo lacks."""
        drive, missing = self.controller, []
        if drive.ki:
            missing.append("an integral of the error (ki): it is left out")
        if drive.kd and drive.derivative == "error":
            missing.append("a derivative of the goal: kd acts on the speed alone")
        if drive.rate is not None:
            missing.append(f"a controller at {drive.rate:g} Hz: it looks at every step")
        if drive.cutoff is not None:
            missing.append("a filter of the speed (cutoff): it is left out")
        if drive.delay:
            missing.append(f"a delay of {drive.delay:g} s from measuring to acting: it is left out")
        return tuple(missing)

    def actuate(self, mujoco: Any, actuator: Any, model: Model, offset: float) -> None:
        """Configure a MuJoCo actuator as the servo; its limit includes the torque offset [N m].

        Raises ExportError if the supply is needed but unknown.
        """
        drive = self.controller
        scale = float(drive.scale(np.array(get_supply(drive))))
        if drive.acts_on_speed:
            actuator.set_to_velocity(kv=drive.kp * scale)
        else:
            actuator.set_to_position(kp=drive.kp * scale, kv=drive.kd * scale)
        limit = drive.max_output * scale  # largest torque [N m]
        if math.isfinite(limit):
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = -limit - offset, limit - offset


def choose_actuator(model: Model, request: Request) -> Motor | Servo:
    """Return the actuator of a request; the torque of a servo is in the unit of the model.

    Raises:
        ExportError: if the gain of the drive is unknown, or play or elasticity is between drive and encoder.
    """
    if (drive := request.drive) is None:
        return Motor(request.step)
    constant = model.torque_constant
    if drive.gain is None and constant is not None and constant.unit == f"{NEWTON_METRE}/{OUTPUT_UNITS[drive.output]}":
        drive = replace(drive, gain=constant.value)
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
    return Servo(drive)


def get_supply(drive: ServoDrive) -> float:
    """Return the supply [V], 1 if the output is not a duty cycle; raises ExportError if it is needed but unknown."""
    if drive.supply is None and drive.output == "duty":
        raise ExportError("a duty is a share of the bus: say its voltage, as --drive output=duty,kp=0.6,supply=12")
    return drive.supply or 1.0
