"""Planar arm in pymunk: n links on pivots with set-valued dry friction.

A `SimpleMotor` of rate zero between two links, with its force bounded by fc, is set-valued Coulomb friction. With
complete bias correction in each step, pymunk's steps are a leapfrog: positions at the steps, velocities half a step
later. The scheme is of second order and conserves energy without friction. If a joint reverses within a step, the step
is repeated with the friction up to the reversal.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Model, Samples
from pendulum_env.physics.joints import FRICTION, parse_effect
from pendulum_env.physics.simulation import CommandDelay, TorqueBalance, make_start_samples
from pendulum_env.plant import PAPER, Effects, hide, list_effects
from pendulum_env.recording.study import GRAVITY


@dataclass(frozen=True)
class Link:
    """Link of an arm, a line from its joint to the next one.

    Attributes:
        mass: mass of the link [kg].
        length: distance to the next joint [m].
        center: distance of the centre of mass from the joint, along the line [m].
        inertia: inertia about the centre of mass [kg m^2].
        viscous: viscous friction at the joint [N m s/rad].
        coulomb: dry friction at the joint [N m].
        center_offset: distance of the centre of mass from the line, to the right of a link that hangs down [m].
        angle: angle of the line from hanging down, counter-clockwise, with all joints at zero [rad].
    """

    mass: float = 1.0
    length: float = 0.45
    center: float = 0.2
    inertia: float = 0.02
    viscous: float = PAPER["viscous"]
    coulomb: float = PAPER["coulomb"]
    center_offset: float = 0.0
    angle: float = 0.0

    def __post_init__(self) -> None:
        if not (self.mass > 0 and self.inertia > 0 and self.length > 0):
            raise ValueError(f"a link needs a positive mass, inertia and length, not {self}")
        if not (self.viscous >= 0 and self.coulomb >= 0):
            raise ValueError(f"friction of a link cannot be negative, as in {self}")


TWO_LINK = (Link(1.2, 0.45, 0.2, 0.02), Link(0.8, 0.35, 0.15, 0.008))


def name_joints(count: int) -> tuple[str, ...]:
    """Return default names of joints: `shoulder`, `elbow`, `wrist`, `joint4`, ..."""
    return tuple(("shoulder", "elbow", "wrist")[k] if k < 3 else f"joint{k + 1}" for k in range(count))


def make_joint_models(
    friction: Sequence[tuple[float, float]],
    names: Sequence[str],
    effects: Effects = (),
    prismatic_joints: Collection[str] = (),
) -> tuple[Model, ...]:
    """Make a model without inertia for each joint, from its friction and hidden effects.

    `friction` holds viscous [N m s/rad] and dry friction [N m] of each joint; effects are `stribeck@elbow=0.4`.
    """
    models = [Model.build(FRICTION, np.array(pair)) for pair in friction]
    for text in list_effects(effects):
        place = re.split("[=:]", text, maxsplit=1)[0]
        kind, joint = parse_effect(place, names, prismatic_joints=prismatic_joints)
        at = list(names).index(joint)
        models[at] = hide(models[at], kind.id + text[len(place) :])
    return tuple(models)


class JointBalances:
    """Torque balances of the joints of a simulated arm, with their internal states."""

    def __init__(self, models: Sequence[Model], h: float) -> None:
        """Set the models of the joints, without inertia, and the step h [s]."""
        self._balances, self._h = [TorqueBalance(model.terms, model.theta) for model in models], h

    def start(self, position: Array, velocity: Array) -> None:
        """Set the initial positions (n,) [rad] and velocities (n,) [rad/s]."""
        self._lines = [CommandDelay(balance.terms, self._h, 1) for balance in self._balances]
        self._states = [make_start_samples(*state) for state in zip(self._balances, position, velocity, strict=True)]

    def delay_torque(self, torque: Array) -> Array:
        """Return the torques of the next step (n,) [N m], after the delays of the terms."""
        commands = (line.delay_command(part) for line, part in zip(self._lines, torque, strict=True))
        return np.array([delayed for command in commands for delayed in command])

    def torques(self, position: Array, velocity: Array, torque: Array) -> tuple[Array, Array]:
        """Return the torque without dry friction and the bound of dry friction, (n,) each [N m]."""
        pairs_of_samples = zip(self._balances, self._make_samples(position, velocity, torque), strict=True)
        pairs = [(balance.net(x), max(float(balance.dry(x)), 0.0)) for balance, x in pairs_of_samples]
        net, dry = np.array(pairs, dtype=float).T
        return net, dry

    def advance(self, position: Array, velocity: Array, torque: Array, mean: Array) -> None:
        """Advance the internal states by a step, with mean joint velocities (n,) [rad/s]."""
        steps = zip(self._balances, self._make_samples(position, velocity, torque), mean, strict=True)
        self._states = [
            Samples(x.time + self._h, x.position, x.velocity, x.torque, balance.advance(x, memory, self._h))
            for balance, x, memory in steps
        ]

    def _make_samples(self, position: Array, velocity: Array, torque: Array) -> list[Samples]:
        states = zip(self._states, position, velocity, torque, strict=True)
        return [Samples(x.time, q, v, u, x.memory) for x, q, v, u in states]


class PlanarBodies:
    """Simulated planar arm; positions and velocities are those of the joints."""

    at_rest = 1e-3  # [rad/s]; below it, friction may hold a joint up to the error of the solver
    iterations = 20  # iterations of pymunk's solver, which converges linearly

    def __init__(self, links: Sequence[Link], models: Sequence[Model], period: float, substeps: int) -> None:
        """Set links, models of the joints, sample time [s] and integration steps per sample."""
        self.links, self.substeps, self.step = tuple(links), substeps, period / substeps
        self._balances = JointBalances(models, self.step)

    def start(self, position: Array, velocity: Array) -> None:
        """Put the arm at joint angles (n,) [rad] with joint velocities (n,) [rad/s]."""
        import pymunk  # slow import, needed only to simulate

        self._space = pymunk.Space()
        self._space.gravity = (0.0, -GRAVITY)
        self._space.iterations = self.iterations
        self._bodies: list[Any] = []
        self._motors: list[Any] = []
        parent: Any = self._space.static_body
        joint, joint_velocity = np.zeros(2), np.zeros(2)
        self.position, self.velocity = np.array(position, dtype=float), np.array(velocity, dtype=float)
        anchor = (0.0, 0.0)
        for link, turn, rate in zip(self.links, np.cumsum(position), np.cumsum(velocity), strict=True):
            body = pymunk.Body(link.mass, link.inertia)
            angle = turn + link.angle
            along, across = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
            body.angle, body.angular_velocity = float(angle), float(rate)
            body.position = tuple(joint + link.center * along + link.center_offset * across)
            body.velocity = tuple(joint_velocity + rate * (link.center * across - link.center_offset * along))
            pivot = pymunk.PivotJoint(parent, body, anchor, (-link.center_offset, link.center))
            anchor = (-link.center_offset, link.center - link.length)
            pivot.error_bias = 0.0
            motor = pymunk.SimpleMotor(parent, body, 0.0)
            self._space.add(body, pivot, motor)
            self._bodies.append(body)
            self._motors.append(motor)
            joint, joint_velocity = joint + link.length * along, joint_velocity + rate * link.length * across
            parent = body
        self._command = np.zeros(len(self.links))
        self._balances.start(self.position, self.velocity)
        self._previous_velocity = self.velocity
        # advance the velocities by half a step; keep the positions
        places = [(body.position, body.angle) for body in self._bodies]
        self._step_bodies(self.position, self.velocity, self._command, 0.5 * self.step)
        for body, (place, angle) in zip(self._bodies, places, strict=True):
            body.position, body.angle = place, angle
        self._half_step_velocity = self._compute_rates()

    def advance(self, torque: Array) -> None:
        """Hold torques (n,) [N m] for one period."""
        h = self.step
        for _ in range(self.substeps):
            delayed = self._balances.delay_torque(torque)
            # a change of torque also acts in the previous half step, unless the joint stuck
            command = delayed + 0.5 * (delayed - self._command) * (np.abs(self._half_step_velocity) > self.at_rest)
            self._command = delayed
            position = self.position + h * self._half_step_velocity
            velocity = 1.5 * self._half_step_velocity - 0.5 * self._previous_velocity
            self._balances.advance(self.position, self._half_step_velocity, delayed, self._half_step_velocity)
            before = self._half_step_velocity
            states = [(body.position, body.angle, body.velocity, body.angular_velocity) for body in self._bodies]
            dry = self._step_bodies(position, velocity, command, h)
            after = self._compute_rates()
            is_reversed = (before * after < 0) & (np.abs(before) > self.at_rest)
            if is_reversed.any():  # repeat the step with reduced friction
                change = np.where(is_reversed, before - self._previous_velocity, 1.0)
                share = np.clip(np.where(is_reversed, -before / np.where(change == 0, -before, change), 0.0), 0.0, 1.0)
                for body, state in zip(self._bodies, states, strict=True):
                    body.position, body.angle, body.velocity, body.angular_velocity = state
                self._step_bodies(position, velocity, command - 2.0 * share * dry * np.sign(before), h)
                after = self._compute_rates()
            self.position, self._previous_velocity, self._half_step_velocity = position, before, after
        self.velocity = 0.5 * (self._previous_velocity + self._half_step_velocity)

    def _step_bodies(self, position: Array, velocity: Array, torque: Array, h: float) -> Array:
        """Advance pymunk by one step under joint torques (n,) [N m]; return the bound of dry friction (n,) [N m]."""
        net, dry = self._balances.torques(position, velocity, torque)
        for motor, bound in zip(self._motors, dry.tolist(), strict=True):
            if motor.max_force != bound:
                motor.max_force = bound
        for body, part in zip(self._bodies, (net - np.append(net[1:], 0.0)).tolist(), strict=True):
            body.torque = part
        self._space.step(h)
        return dry

    def _compute_rates(self) -> Array:
        return np.diff([body.angular_velocity for body in self._bodies], prepend=0.0)


def write_urdf(links: Sequence[Link], names: Sequence[str]) -> str:
    """Write the arm as URDF with joint names and friction; angles are those of the simulation."""
    from xml.sax.saxutils import quoteattr  # slow import

    bodies, joints = ['<link name="base"/>'], []
    parent, place = "base", "0 0 0"
    for k, (link, joint) in enumerate(zip(links, names, strict=True)):
        i = link.inertia
        bodies.append(
            f'<link name="link{k + 1}"><inertial><origin xyz="{_locate_point(link, link.center, link.center_offset)}"/>'
            f'<mass value="{link.mass}"/>'
            f'<inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i / 10}"/></inertial></link>'
        )
        joints.append(
            f'<joint name={quoteattr(joint)} type="continuous"><parent link="{parent}"/><child link="link{k + 1}"/>'
            f'<origin xyz="{place}"/><axis xyz="0 -1 0"/>'
            f'<dynamics damping="{link.viscous}" friction="{link.coulomb}"/></joint>'
        )
        parent, place = f"link{k + 1}", _locate_point(link, link.length, 0.0)
    return "\n".join(['<robot name="planar-arm">', *bodies, *joints, "</robot>", ""])


def _locate_point(link: Link, along: float, center_offset: float) -> str:
    """Return a link's point relative to its joint, all joints at zero: x to the right, z up [m]."""
    s, c = np.sin(link.angle), np.cos(link.angle)
    return f"{along * s + center_offset * c:.9g} 0 {center_offset * s - along * c:.9g}"
