"""Friction effects."""

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics.actuation import is_powered
from pendulum_env.physics.term import ROOM, Column, Memory, NonlinearParameter, Samples, Term, return_one


@dataclass(frozen=True)
class CoulombAsymmetry(Term):
    """Dry friction that differs by direction: fc + d forwards, fc - d backwards, hence the constant d.

    The set-valued law is shifted by d. In a single recording, this equals a torque offset of -d.
    """

    id = "coulomb_asymmetry"
    law = "d |sgn q'|"
    kind = "dissipative"

    columns = (Column("coulomb_asymmetry", "N m", force=return_one),)


@dataclass(frozen=True)
class ViscousAsymmetry(Term):
    """Viscous friction that differs by direction: b + d forwards, b - d backwards."""

    id = "viscous_asymmetry"
    law = "d |q'|"
    kind = "dissipative"

    columns = (Column("viscous_asymmetry", "N m s/rad", force=lambda x: np.abs(x.velocity)),)


@dataclass(frozen=True)
class Stribeck(Term):
    """Extra dry friction at low speed that fades with the Stribeck velocity vs.

    The exponent n is 2 unless the data require another value; published values for bearings are 0.5 to 2.
    Source: Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30(7), 1994.
    """

    stribeck_velocity: float = 0.5
    exponent: float = 2.0

    id = "stribeck"
    law = "fs exp(-|q'/vs|^n) sgn q' (usually n = 2)"
    kind = "dissipative"
    is_common = True
    nonlinear_parameters = (
        NonlinearParameter("stribeck_velocity", "rad/s", 1e-6, 1e4),
        NonlinearParameter("exponent", "1", 0.3, 6.0, nominal=2.0),
    )
    typical_size = "stribeck=0.45"

    @property
    def columns(self) -> tuple[Column, ...]:
        def share(x: Samples) -> ArrayLike:
            return np.exp(-(np.abs(x.velocity / self.stribeck_velocity) ** self.exponent))

        return (Column("stribeck", "N m", dry=share, least=0.0),)


@dataclass(frozen=True)
class QuadraticDrag(Term):
    """Air drag on the bob, c q'|q'|, c >= 0; dissipates c |q'|^3.

    Hard to distinguish from viscous friction at nearly constant |q'|.
    Source: Nelson and Olsson, American Journal of Physics 54(2), 1986.
    """

    id = "quadratic_drag"
    law = "c q' |q'|"
    kind = "dissipative"
    is_common = True

    columns = (  # non-negative: at high speed, drag dominates all friction
        Column("quadratic_drag", "N m s^2/rad^2", force=lambda x: x.velocity * np.abs(x.velocity), least=0.0),
    )


@dataclass(frozen=True)
class LoadDependentFriction(Term):
    """Dry friction that grows with the load of a gear, (mu |tau| + mu_o |w sin q|) sgn q'.

    Each side of the teeth has its own coefficient: mu for the motor torque without the back-EMF, mu_o for the load,
    which is the model's gravity w plus the known load. If the motor causes all motion, mu and the scale of the torque
    are indistinguishable.
    Source: Duclusaud et al., Extended Friction Models for the Physics Simulation of Servo Actuators, 2024.
    """

    weight: float = 0.0
    back_emf: float = 0.0

    largest_coefficient = 0.7  # bound of both coefficients; above it, a gear is not backdrivable
    id = "load_dependent_friction"
    law = "(mu |tau| + mu_o |w sin q|) sgn q'"
    kind = "dissipative"
    can_hide_scale = True
    is_common = True
    nonlinear_parameters = (
        NonlinearParameter("weight", "N m", -1e9, 1e9, follows="gravity"),
        NonlinearParameter("back_emf", "N m s/rad", -1e9, 1e9, follows="back_emf", nominal=0.0),
    )

    @property
    def columns(self) -> tuple[Column, ...]:
        return (
            Column(
                "load_dependent_friction",
                "1",
                dry=lambda x: np.abs(x.torque - self.back_emf * x.velocity * is_powered(x)),
                of_torque=True,
                least=0.0,
                most=self.largest_coefficient,
            ),
            Column(
                "load_dependent_friction.output",
                "1",
                dry=lambda x: np.abs((self.weight + x.load.gravity) * np.sin(x.position) - x.load.torque),
                is_of_weight=True,
                least=0.0,
                most=self.largest_coefficient,
            ),
        )


@dataclass(frozen=True)
class PositionDependentFriction(Term):
    """Dry friction that varies over a turn, as from a misaligned bearing: (fs sin q + fc cos q) sgn q'."""

    id = "position_dependent_friction"
    law = "(s sin q + c cos q) sgn q'"
    kind = "dissipative"
    is_revolute_only = True

    columns = (
        Column("position_dependent_friction.sin", "N m", dry=lambda x: np.sin(x.position)),
        Column("position_dependent_friction.cos", "N m", dry=lambda x: np.cos(x.position)),
    )


@dataclass(frozen=True)
class TemperatureDependentFriction(Term):
    """Friction that changes with the measured temperature T of the joint: the base friction is that at 25 deg C.

    Viscous friction of a warming lubricant falls by one to three per cent per kelvin; dry friction may rise.
    Source: Bittencourt and Gunnarsson, ASME Journal of Dynamic Systems 134(5), 2012.
    """

    id = "temperature_dependent_friction"
    law = "(b1 q' + f1 sgn q') (T - 25 deg C)"
    kind = "dissipative"
    typical_size = "viscous=-0.001,coulomb=0.001"
    percent_of = ("viscous", "coulomb")
    needs = "temperature"
    span = 1.0  # [s], interval of the temperature's rate of change

    @property
    def columns(self) -> tuple[Column, ...]:
        def compute_warming(x: Samples) -> ArrayLike:
            return x.memory.get(self.id, (x.temperature,))[0] - ROOM

        return (
            Column(
                "temperature_dependent_friction.viscous", "N m s/rad/K", force=lambda x: x.velocity * compute_warming(x)
            ),
            Column(
                "temperature_dependent_friction.coulomb",
                "N m/K",
                dry=lambda x: compute_warming(x) * np.ones_like(x.velocity),
            ),
        )

    def start(self, x: Samples) -> Memory:
        temperature = x.temperature + 0.0 * x.position
        return temperature, 0.0 * temperature

    def advance(self, memory: Memory, x: Samples, duration: ArrayLike) -> Memory:
        temperature, rate = memory  # extrapolated from the last measurement
        return temperature + duration * rate, rate + 0.0

    def trace(self, x: Samples, command: Array, period: float) -> Memory:
        measured = np.broadcast_to(x.temperature, x.time.shape)
        later = np.minimum(x.time + self.span, x.time[-1])
        return measured, (np.interp(later, x.time, measured) - measured) / np.maximum(later - x.time, period)


@dataclass(frozen=True)
class Presliding(Term):
    """Dry friction that acts as a stiff spring before it slips: f z instead of f sgn q', with d z' = q' - |q'| z.

    After a reversal, the state z changes from -1 to 1 over a few displacements d. f is the part of the dry friction
    with this behaviour, usually all. Stiffness at reversal: f / d.
    Source: Dahl, Aerospace Corporation report TOR-0158, 1968.
    """

    displacement: float = 0.02

    id = "presliding"
    law = "f (z - sgn q') with d z' = q' - |q'| z"
    kind = "dissipative"
    nonlinear_parameters = (NonlinearParameter("displacement", "rad", 1e-5, 1.0),)

    @property
    def columns(self) -> tuple[Column, ...]:
        return (
            Column(
                "presliding",
                "N m",
                force=lambda x: x.memory[self.id][0],
                dry=lambda x: -np.ones_like(x.velocity),
                least=0.0,  # friction does not accelerate
            ),
        )

    def start(self, x: Samples) -> Memory:
        return (np.sign(x.velocity) + 0.0 * x.position,)

    def advance(self, memory: Memory, x: Samples, duration: ArrayLike) -> Memory:
        # exact for a constant direction: z - sgn q' decays with the distance travelled
        direction = np.sign(x.velocity)
        return (direction + (memory[0] - direction) * np.exp(-np.abs(x.velocity) * duration / self.displacement),)
