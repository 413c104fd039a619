"""Elastic or loose transmission between motor and link.

The encoder and the friction sit at the motor; the link, of inertia J and weight mgl, hangs on the transmission:

    (I - J) q'' + friction + T = tau          J ql'' + mgl sin ql + fl sgn ql' + bl ql' = T

The torque is that of the rigid model plus J (ql'' - q'') + mgl (sin ql - sin q). A known load counts as if it hung on
the motor's side. The link may have parts fl and bl of the dry and viscous friction, as of a bearing behind the gear.
They delay its motion; `coulomb` and `viscous` are those of both sides. The link's own motion follows from the measured
motion of the motor: with w^2 = k / J, damping c = d / J, g = mgl / J, f = fl / J and b = bl / J,

    ql'' = a(q - ql, q' - ql') - g sin ql - f sgn ql' - b ql',     a = w^2 s + c s'

where s is the extension of the transmission. A controller and a log with the encoder at the output read ql
and ql', and q is simulated: see `read_encoder`. Source: Spong, ASME Journal of Dynamic Systems 109(4), 1987.

Behind a play, the damping c s' begins with a jump at each contact. An integrator of fixed steps would err by up to a
step's impulse, in either direction, and its error would jump with the parameters. Therefore forces are averaged over a
short time: c times the change of s is the impulse of the damping, for a contact that begins anywhere in a step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics.simulation import LEAST_INERTIA, clip_state, count_substeps
from pendulum_env.physics.symbols import may_be_true
from pendulum_env.physics.term import Column, Memory, NonlinearParameter, Samples, T, Term, return_zero

CONTACT_TIME = 5e-4  # [s], averaging time of the forces of a contact, which then begins and ends without a jump


class Transmission(Term):
    """Base of elastic and loose transmissions; `play` is the gap on either side [rad]."""

    kind = "transmission"
    is_decentralised = False
    link = True
    resonance: float
    damping: float
    gravity: float
    friction: float
    viscous: float

    @property
    def play(self) -> float:
        """Return the angle on either side over which no torque passes [rad]."""
        return 0.0

    @property
    def columns(self) -> tuple[Column, ...]:
        def force(x: Samples) -> ArrayLike:  # T - mgl sin q, per unit of J
            position, velocity = x.memory[self.id]
            pull = self._compute_pull(x.position - position, x.velocity - velocity, self.resonance**2, self.damping)
            return pull - self._compute_deceleration(x.position, x.velocity)

        def mass(x: Samples) -> ArrayLike:
            return -np.ones_like(x.velocity)

        dry = (lambda x: -self.friction) if may_be_true(self.friction) else return_zero  # of the link, not of the motor
        return (Column(self.id, "kg m^2", mass=mass, force=force, dry=dry, least=0.0),)

    def _compute_pull(self, twist: ArrayLike, speed: ArrayLike, stiffness: ArrayLike, damping: ArrayLike) -> ArrayLike:
        """Return the acceleration of the link by the transmission [rad/s^2]."""
        if not may_be_true(self.play):
            return stiffness * twist + damping * speed
        change = 0.5 * CONTACT_TIME * speed
        ahead, behind = self._compute_extension(twist + change), self._compute_extension(twist - change)
        return stiffness * (ahead + behind) / 2.0 + damping * (ahead - behind) / CONTACT_TIME

    def _compute_extension(self, twist: Any) -> Any:
        """Return the extension of the transmission [rad], which is the twist beyond the play."""
        return twist - np.minimum(np.maximum(twist, -self.play), self.play)

    def _compute_deceleration(self, position: Array, velocity: Array) -> Array:
        """Return the deceleration of the link by its weight and viscous friction [rad/s^2]."""
        weight = self.gravity * np.sin(position)
        return weight + self.viscous * velocity if may_be_true(self.viscous) else weight

    def bind(self: T, linear: Mapping[str, float]) -> T:
        """Return the transmission with no more weight and friction at the link than the joint has."""
        bases = {"gravity": "gravity", "friction": "coulomb", "viscous": "viscous"}
        largest = {name: linear.get(base, np.inf) for name, base in bases.items()}
        inertia = max(linear.get(self.id, 0.0), LEAST_INERTIA)
        values = {
            parameter.name: min(getattr(self, parameter.name), max(largest[parameter.name] / inertia, parameter.low))
            for parameter in self.nonlinear_parameters
            if parameter.name in largest
        }
        return replace(self, **values)

    def _apply_dry_friction(self, velocity: Array, duration: ArrayLike) -> Array:
        """Return a velocity of the link after its dry friction has acted, which stops it at most."""
        if not may_be_true(self.friction):
            return velocity
        largest = duration * self.friction
        return velocity - np.minimum(np.maximum(velocity, -largest), largest)

    def derived(self, theta: Array) -> dict[str, tuple[float, str]]:
        quantities = {
            "k": (theta[0] * self.resonance**2, "N m/rad"),
            "d": (theta[0] * self.damping, "N m s/rad"),
            "mgl": (theta[0] * self.gravity, "N m"),
        }
        if self.friction:
            quantities["link_coulomb"] = theta[0] * self.friction, "N m"
        if self.viscous:
            quantities["link_viscous"] = theta[0] * self.viscous, "N m s/rad"
        return quantities

    def start(self, x: Samples) -> Memory:
        # the link hangs at the extension that carries its weight, and moves with the motor
        weight = self.gravity * np.sin(x.position)
        return x.position - weight / self.resonance**2 - self.play * np.sign(weight), x.velocity + 0.0 * weight

    def advance(self, memory: Memory, x: Samples, duration: ArrayLike) -> Memory:
        # velocity Verlet in short steps, while the motor moves on at constant speed
        position, velocity = memory
        steps = count_substeps(duration)
        h = duration / steps
        stiffness = np.minimum(self.resonance**2, 1 / h**2)  # stiffer contacts would be unstable at this step
        damping = np.minimum(self.damping, 0.5 / h)

        def accelerate(elapsed: ArrayLike, position: Array, link_speed: Array, duration: ArrayLike) -> Array:
            """Return the velocity after a duration, from `velocity` with the acceleration of a state."""
            twist, speed = x.position + elapsed * x.velocity - position, x.velocity - link_speed
            pull = self._compute_pull(twist, speed, stiffness, damping)
            pull = pull - self._compute_deceleration(position, link_speed)
            return self._apply_dry_friction(velocity + duration * pull, duration)

        for k in range(steps):
            middle_q = position + 0.5 * h * velocity
            middle_v = accelerate(k * h, position, velocity, 0.5 * h)
            velocity = clip_state(accelerate((k + 0.5) * h, middle_q, middle_v, h))
            position = clip_state(middle_q + 0.5 * h * velocity)
        return position, velocity


@dataclass(frozen=True)
class JointFlexibility(Transmission):
    """Elastic transmission: the link swings against the motor at its own resonance."""

    resonance: float = 50.0
    damping: float = 1.0
    gravity: float = 25.0
    friction: float = 0.0
    viscous: float = 0.0

    id = "joint_flexibility"
    law = "J (ql'' - q'') + mgl (sin ql - sin q) + fl (sgn ql' - sgn q') + bl (ql' - q')"
    nonlinear_parameters = (
        NonlinearParameter("resonance", "rad/s", 1.0, 2e3, is_frequency=True),
        NonlinearParameter("damping", "1/s", 1e-2, 1e3),
        NonlinearParameter("gravity", "1/s^2", 0.1, 1e4),
        NonlinearParameter("friction", "1/s^2", 0.0, 1e4, nominal=0.0),
        NonlinearParameter("viscous", "1/s", 0.0, 1e3, nominal=0.0),
    )


@dataclass(frozen=True)
class Backlash(Transmission):
    """Play between motor and link: no torque passes within the gap on either side, a stiff contact beyond it."""

    gap: float = 0.01
    resonance: float = 100.0
    damping: float = 15.0
    gravity: float = 25.0
    friction: float = 0.0
    viscous: float = 0.0

    id = "backlash"
    law = "J (ql'' - q'') + mgl (sin ql - sin q) + fl (sgn ql' - sgn q') + bl (ql' - q') with play of +-gap"
    nonlinear_parameters = (
        NonlinearParameter("gap", "rad", 1e-4, 0.5),
        NonlinearParameter("resonance", "rad/s", 10.0, 5e3, is_frequency=True),
        NonlinearParameter("damping", "1/s", 1e-2, 1e4),
        NonlinearParameter("gravity", "1/s^2", 0.1, 1e4),
        NonlinearParameter("friction", "1/s^2", 0.0, 1e4, nominal=0.0),
        NonlinearParameter("viscous", "1/s", 0.0, 1e3, nominal=0.0),
    )

    @property
    def reductions(self) -> tuple[Term, ...]:
        return (JointFlexibility(self.resonance, self.damping, self.gravity, self.friction, self.viscous),)

    @property
    def play(self) -> float:
        return self.gap
