"""Actuators of an exported joint: their interface, and a motor with a torque input."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from pendulum_env.export.dynamics import StepBuilder
from pendulum_env.physics import Model, Term
from pendulum_env.physics.terms import is_pure_delay

OFFSETS = ("torque_offset", "coulomb_asymmetry")  # effects of constant torque


class Gains(NamedTuple):
    """Gains of a servo at its joint."""

    stiffness: float  # torque per error of the angle [N m/rad]
    damping: float  # torque per speed, of a speed controller per its error [N m s/rad]
    limit: float  # largest torque [N m], perhaps infinite
    per_volt: float | None  # torque per voltage of the motor at rest [N m/V]; None if the output is another


class JointActuator(ABC):
    """Actuator of an exported joint."""

    @property
    def gains(self) -> Gains | None:
        """Return the gains of a servo; None for another actuator."""
        return None

    @property
    def missing(self) -> tuple[str, ...]:
        """Return the parts of the actuator that MuJoCo lacks."""
        return ()

    @abstractmethod
    def list_held(self, model: Model) -> tuple[str, ...]:
        """List the ids of the effects that are included."""

    @abstractmethod
    def actuate(self, mujoco: Any, actuator: Any, model: Model, offset: float) -> None:
        """Configure a MuJoCo actuator; `offset`: torque offset of the model [N m]."""

    @abstractmethod
    def connect(self, builder: StepBuilder) -> None:
        """Replace the torque input of a step by the input of the actuator."""


def find_lag(terms: Sequence[Term]) -> Term | None:
    """Find the first term that is a lag of the torque, the one that MuJoCo represents."""
    return next((term for term in terms if term.lead and is_pure_delay(type(term))), None)


@dataclass(frozen=True)
class Motor(JointActuator):
    """Motor with lag and delay."""

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

    def connect(self, builder: StepBuilder) -> None:
        """Keep the torque input of a step."""
