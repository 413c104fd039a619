"""Actuator of an exported servo: a drive with a goal input."""

import math
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from pendulum_env.export.actuators import OFFSETS, Gains, JointActuator
from pendulum_env.export.dynamics import NamedParameter, StepBuilder, StepQuantity
from pendulum_env.export.request import ExportError
from pendulum_env.physics import Model, has_link
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.symbols import make_symbol
from pendulum_env.recording.channel import NEWTON_METRE
from robots.servos import OUTPUT_UNITS, ServoDrive
from robots.servos.loop import (
    GAINS,
    Controller,
    ControllerState,
    ServoInputs,
    compute_control,
    compute_gains,
    compute_taps,
)


@dataclass(frozen=True)
class Servo(JointActuator):
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

    @property
    def gains(self) -> Gains:
        """Return the gains at the joint; raises ExportError if the supply is needed but unknown."""
        drive = self.controller
        scale = float(drive.scale(np.array(get_supply(drive))))
        stiffness, damping = (0.0, drive.kp) if drive.acts_on_speed else (drive.kp, drive.kd)
        per_volt = drive.gain if drive.output in ("duty", "voltage") else None
        return Gains(stiffness * scale, damping * scale, drive.max_output * scale, per_volt)

    def actuate(self, mujoco: Any, actuator: Any, model: Model, offset: float) -> None:
        """Configure a MuJoCo actuator as the servo; its limit includes the torque offset [N m]."""
        stiffness, damping, limit, _ = self.gains
        if self.controller.acts_on_speed:
            actuator.set_to_velocity(kv=damping)
        else:
            actuator.set_to_position(kp=stiffness, kv=damping)
        if math.isfinite(limit):
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = -limit - offset, limit - offset

    def connect(self, builder: StepBuilder) -> None:
        """Replace the torque input of a step by the drive with a goal input, which delays its own output."""
        drive, seconds, x = self.controller, builder.seconds, builder.x
        is_always_sampled = drive.rate is None or drive.rate * seconds >= 1.0
        gains: dict[str, Any] = dict(zip(GAINS, compute_gains(drive, seconds), strict=True))
        output = {"duty": "1", "voltage": "V", "current": "A", "torque": drive.unit}[drive.output]
        per = "s/rad" if drive.acts_on_speed else "rad"
        units = {"kp": f"{output}/{per}", "ki": f"{output}/({per} s)", "kd": f"{output} s/rad", "limit": output}
        for text, unit in units.items():
            if gains[text] not in (0.0, math.inf):
                builder.parameters.append(NamedParameter(text, gains[text], unit, 0.0))
                gains[text] = make_symbol(builder.parameters[-1].name)
        gains["stop_output"] = gains["limit"] if math.isfinite(gains["stop_output"]) else math.inf
        gains["max_integral"] = gains["limit"] / gains["ki"] if math.isfinite(gains["max_integral"]) else math.inf
        scale: Any = 1.0
        builder.given[0] = StepQuantity("goal", "rad/s" if drive.acts_on_speed else "rad")
        if drive.output == "duty":
            builder.given.append(StepQuantity("supply", "V", get_supply(drive)))
            scale = make_symbol("supply")
        if drive.gain is not None:
            builder.parameters.append(NamedParameter("gain", drive.gain, f"N m/{OUTPUT_UNITS[drive.output]}", 0.0))
            scale = scale * make_symbol("gain")
        builder.given.append(StepQuantity("on", "0: the motor is open", 1.0))
        weights = compute_taps(np.array((drive.delay + builder.delay) / seconds)).tolist()
        builder.delay = 0.0
        phase: Any = make_symbol("phase")  # time to the controller's next sample, in its periods
        samples_per_step, period = seconds * (drive.rate or 0.0), 1.0 / (drive.rate or math.inf)
        sample_time: Any = 0.5 * max(seconds - period, 0.0) if drive.rate else 0.0
        has_sample: Any = 1.0
        share: Any = 1.0
        elapsed: Any = seconds
        last_sample_time: Any = make_symbol("last_lead")
        if not is_always_sampled:
            sample_time, has_sample = np.maximum(phase, 0.0) * period, samples_per_step * (1.0 - 1e-6) - phase
            share, elapsed = 1.0 - sample_time / seconds, period - sample_time + last_sample_time
        previous_weight = (0.5 * period - sample_time) / elapsed
        past_outputs = tuple(make_symbol(f"before_{k + 1}") for k in range(len(weights) - 1))
        speed = x.velocity if is_always_sampled and gains["speed_weight"] == 1.0 else make_symbol("speed")
        last = make_symbol("last_velocity") if drive.rate else x.velocity
        integral: Any = make_symbol("integral") if drive.ki else 0.0
        state = ControllerState(make_symbol("held"), past_outputs, integral, speed, last)
        is_on: Any = make_symbol("on")
        goal, last_goal = (cast(Any, make_symbol(name)) for name in ("goal", "last_goal"))
        has_goal_speed = drive.kd > 0 and drive.acts_on_position and drive.derivative == "error"
        goal_speed = (goal - last_goal) / max(seconds, period) if has_goal_speed else 0.0
        times = {"share": share, "sample_time": sample_time, "previous_weight": previous_weight}
        inputs = ServoInputs(goal, scale, is_on, has_sample, **times, goal_speed=goal_speed)
        torque, after = compute_control(x, state, inputs, Controller(gains, weights, drive.acts_on_speed))
        memory = {id: (is_on,) if id == BackEmf.id else memory for id, memory in x.memory.items()}
        builder.x = replace(x, torque=torque, memory=memory)
        next_phase = np.where(has_sample > 0, phase + 1.0, phase) - samples_per_step
        builder.after = {"held": after.held_output, "integral": after.integral, "speed": after.speed}
        builder.after["phase"] = next_phase
        last_values = {"last_lead": (sample_time, last_sample_time), "last_goal": (goal, last_goal)}
        builder.after |= {name: np.where(has_sample > 0, *values) for name, values in last_values.items()}
        builder.after["last_velocity"] = after.velocity
        builder.after |= {symbol.label: value for symbol, value in zip(past_outputs, after.past_outputs, strict=True)}
        builder.start |= dict.fromkeys(builder.after, 0.0) | {
            "speed": make_symbol("velocity"),
            "last_velocity": make_symbol("velocity"),
            "last_goal": make_symbol("position"),
        }


def make_servo(model: Model, drive: ServoDrive) -> Servo:
    """Make the actuator of a drive; its torque is in the unit of the model.

    Raises:
        ExportError: if the gain of the drive is unknown, or play or elasticity is between drive and encoder.
    """
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
