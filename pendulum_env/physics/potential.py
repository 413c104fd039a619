"""Effects with torque that depends on the angle and stores energy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics.term import Column, NonlinearParameter, Samples, Term

WEIGHT = ("gravity", "gravity_tilt")  # ids of the terms of weight, which the mass of the links causes
FINEST = 400  # largest order of cogging, twice the ratio of usual gears


@dataclass(frozen=True)
class GravityTilt(Term):
    """Gravity out of phase, g cos q: a tilted base, an offset centre of mass, or a wrong encoder zero."""

    id = "gravity_tilt"
    law = "g cos q"
    kind = "potential"
    is_decentralised = False
    is_revolute_only = True
    is_weight = True
    by_angle = ("cosine",)

    columns = (
        Column("gravity_tilt", "N m", force=lambda x: np.cos(x.position), potential=lambda x: np.sin(x.position)),
    )


@dataclass(frozen=True)
class Cogging(Term):
    """Torque of the magnets on the slots, s sin Nq + c cos Nq, N periods in a turn; motors often have several orders N.

    Further orders are 0, for none, unless the data require them. They are tried only if the motion covers several
    periods, because waves of any order fit any curve.
    """

    order: float = 12.0
    order_2: float = 0.0
    order_3: float = 0.0
    order_4: float = 0.0
    order_5: float = 0.0

    id = "cogging"
    law = "s sin Nq + c cos Nq"
    kind = "potential"
    is_revolute_only = True
    is_common = True
    nonlinear_parameters = (
        NonlinearParameter("order", "1", 2, FINEST, integer=True),
        *(NonlinearParameter(f"order_{k}", "1", 0, 120, integer=True, nominal=0.0) for k in range(2, 6)),
    )
    typical_size = "sin=0.15,cos=0.1"

    @property
    def _nonzero_orders(self) -> list[tuple[str, float]]:
        """Return the nonzero orders N with the suffixes of their parameters."""
        orders = [(f"_{k}", getattr(self, f"order_{k}")) for k in range(2, 6)]
        orders = [(suffix, n) for suffix, n in orders if not isinstance(n, float | np.ndarray) or np.any(n)]
        return [("", self.order), *orders]

    @property
    def columns(self) -> tuple[Column, ...]:
        return tuple(column for suffix, n in self._nonzero_orders for column in _make_wave(suffix, n))

    @property
    def fault(self) -> str:
        orders = [n for _, n in self._nonzero_orders]
        return "" if len(set(orders)) == len(orders) else "its orders have to differ"


def _make_wave(suffix: str, n: float) -> tuple[Column, Column]:
    """Make the sine and cosine columns of cogging with n periods per turn; `suffix` is the suffix of their names."""

    def store_sine(x: Samples) -> Array:
        return (1.0 - np.cos(n * x.position)) / n

    def store_cosine(x: Samples) -> Array:
        return np.sin(n * x.position) / n

    return (
        Column(f"cogging.sin{suffix}", "N m", force=lambda x: np.sin(n * x.position), potential=store_sine),
        Column(f"cogging.cos{suffix}", "N m", force=lambda x: np.cos(n * x.position), potential=store_cosine),
    )


@dataclass(frozen=True)
class Spring(Term):
    """Elastic pull towards a rest angle, k (q - q0): a cable or hose; linear in k and in k q0.

    A hardening or softening spring has degree 3, k q - k q0 + k2 q^2 + k3 q^3, if the data require it.
    """

    degree: float = 1.0

    id = "spring"
    is_restoring = True
    law = "k q + preload, preload = -k q0 (hardening: and k2 q^2 + k3 q^3)"
    kind = "potential"
    is_common = True
    by_angle = ("line", "one")
    nonlinear_parameters = (NonlinearParameter("degree", "1", 1, 3, integer=True, nominal=1.0),)
    typical_size = "preload=0.1"

    @property
    def columns(self) -> tuple[Column, ...]:
        preload = _make_power("spring.preload", "N m", 0)
        if isinstance(self.degree, float | np.ndarray) and not np.any(np.asarray(self.degree) > 1):  # not symbolic
            return _make_power("spring.stiffness", "N m/rad", 1), preload
        # negative stiffness and gravity together would fit any curve
        pulls = _make_power("spring.stiffness", "N m/rad", 1, least=0.0)
        quadratic, cubic = _make_power("spring.quadratic", "N m/rad^2", 2), _make_power("spring.cubic", "N m/rad^3", 3)
        return pulls, preload, quadratic, cubic

    @property
    def fault(self) -> str:
        return "its degree has to be 1 or 3" if np.any(np.asarray(self.degree) == 2) else ""


def _make_power(name: str, unit: str, n: int, least: float = -np.inf) -> Column:
    """Make the column of the n-th power of the angle, with its potential."""
    order = n + 1
    return Column(name, unit, force=lambda x: x.position**n, potential=lambda x: x.position**order / order, least=least)


@dataclass(frozen=True)
class HardStop(Term):
    """Ends of the range of motion, elastic with losses: k (x + c x x' + T x') at a depth x beyond `lower` or `upper`.

    Both stops have the same stiffness and losses, and only push; an infinite limit is no stop. The hysteresis c is that
    of a bumper with losses that begin at zero: after a slow impact at speed v, the speed is lower by the share 2 c v /
    3. The damping time T is that of a parallel spring and damper, d = k T, with a jump of the torque at contact.
    Source: Hunt and Crossley, Journal of Applied Mechanics 42(2), 1975, with exponent 1.
    """

    lower: float = -np.inf
    upper: float = np.inf
    hysteresis: float = 0.0
    damping_time: float = 0.0

    id = "hard_stop"
    law = "k (x + c x x' + T x') >= 0, x beyond lower or upper"
    kind = "potential"
    has_impacts = True
    nonlinear_parameters = (
        NonlinearParameter("lower", "rad", -np.inf, 1e6, nominal=-np.inf, is_position=True),
        NonlinearParameter("upper", "rad", -1e6, np.inf, nominal=np.inf, is_position=True),
        NonlinearParameter("hysteresis", "s/rad", 0.0, 100.0, nominal=0.0),
        NonlinearParameter("damping_time", "s", 0.0, 1.0, nominal=0.0),
    )
    typical_size = "stiffness=40,lower=-1.2,upper=1.2,hysteresis=0.05"

    @property
    def ends(self) -> tuple[float, float]:
        return self.lower, self.upper

    @property
    def columns(self) -> tuple[Column, ...]:
        return (
            Column(
                "hard_stop.stiffness",
                "N m/rad",
                force=lambda x: self._compute_depth(x) + self._compute_loss(x),
                potential=lambda x: 0.5 * self._compute_depth(x) ** 2,
                loss=self._compute_loss,
                least=0.0,
            ),
        )

    def _compute_loss(self, x: Samples) -> Array:
        """Return the inelastic torque per unit of stiffness [rad], bounded so that the stop does not pull."""
        depth = self._compute_depth(x)
        inwards = np.sign(depth) * x.velocity
        loss = (self.hysteresis * np.abs(depth) + self.damping_time * (depth != 0)) * inwards
        bounded: Array = np.sign(depth) * np.maximum(loss, -np.abs(depth))
        return bounded

    def _compute_depth(self, x: Samples) -> Array:
        """Return the penetration of a stop [rad], negative at the lower stop."""
        depth: Array = np.maximum(x.position - self.upper, 0.0) + np.minimum(x.position - self.lower, 0.0)
        return depth

    @property
    def fault(self) -> str:
        return "" if np.all(self.lower < self.upper) else "lower has to be below upper"
