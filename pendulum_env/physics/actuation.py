"""Terms between the torque command and the torque at the joint."""

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.filters import filter_lag, filter_shifted
from pendulum_env.physics.symbols import may_be_true
from pendulum_env.physics.term import Column, Memory, NonlinearParameter, Samples, Term, return_one


@dataclass(frozen=True)
class TorqueOffset(Term):
    """Constant bias of the torque channel: the joint receives tau - c."""

    id = "torque_offset"
    law = "c"
    kind = "actuation"
    by_angle = ("one",)

    columns = (Column("torque_offset", "N m", force=return_one),)


@dataclass(frozen=True)
class TorqueRipple(Term):
    """Motor gain that varies over a turn: the joint receives tau (1 - s sin Nq - c cos Nq)."""

    order: float = 6.0

    id = "torque_ripple"
    law = "s tau sin Nq + c tau cos Nq"
    kind = "actuation"
    is_revolute_only = True
    nonlinear_parameters = (NonlinearParameter("order", "1", 1, 200, integer=True),)
    typical_size = "sin=0.07,cos=-0.04"

    @property
    def columns(self) -> tuple[Column, ...]:
        n = self.order
        return (
            Column("torque_ripple.sin", "1", force=lambda x: x.torque * np.sin(n * x.position), of_torque=True),
            Column("torque_ripple.cos", "1", force=lambda x: x.torque * np.cos(n * x.position), of_torque=True),
        )


@dataclass(frozen=True)
class TorqueSaturation(Term):
    """Loss of gain at high torque: the joint receives L tanh(|tau / L|^(1/r))^r sgn tau.

    The roundness r is 1, which gives L tanh(tau / L), unless the data require another value. A current limit has a
    sharp corner, with r near 0.
    """

    limit: float = 10.0
    roundness: float = 1.0

    id = "torque_saturation"
    law = "tau - L tanh(|tau / L|^(1/r))^r sgn tau, r = 1"
    kind = "actuation"
    nonlinear_parameters = (
        NonlinearParameter("limit", "N m", 1e-3, 1e4),
        NonlinearParameter("roundness", "1", 0.01, 2.0, nominal=1.0),
    )
    typical_size = "limit=8"

    @property
    def fixed(self) -> tuple[Column, ...]:
        def lost(x: Samples) -> ArrayLike:
            times = np.minimum(np.abs(x.torque / self.limit), 100.0)  # saturated from here on
            return x.torque - self.limit * np.sign(x.torque) * np.tanh(times ** (1 / self.roundness)) ** self.roundness

        return (Column("torque_saturation", "1", force=lost),)


@dataclass(frozen=True)
class ActuatorLag(Term):
    """First-order lag of the torque, T tau_a' = tau - tau_a: current loop, amplifier or filter."""

    time_constant: float = 0.01

    id = "actuator_lag"
    law = "tau - tau_a with T tau_a' = tau - tau_a"
    kind = "actuation"
    nonlinear_parameters = (NonlinearParameter("time_constant", "s", 1e-4, 2.0, can_be_zero=True),)

    @property
    def fixed(self) -> tuple[Column, ...]:
        return (Column("actuator_lag", "1", force=lambda x: x.torque - x.memory[self.id][0]),)

    @property
    def lead(self) -> float:
        return self.time_constant

    def start(self, x: Samples) -> Memory:
        return (x.torque + 0.0 * x.position,)

    def advance(self, memory: Memory, x: Samples, duration: ArrayLike) -> Memory:
        if not may_be_true(self.time_constant):
            return (x.torque + 0.0 * memory[0],)
        return (x.torque + (memory[0] - x.torque) * np.exp(-duration / self.time_constant),)

    def trace(self, x: Samples, command: Array, period: float) -> Memory:
        return (average_lagged(command, self.time_constant / period),)


def average_lagged(command: Array, time_constant: float) -> Array:
    """Average a held torque (N,) after a lag, under the triangle of the equation of motion at each sample (N,).

    The triangle spans the samples k - 1 to k + 1. Within a period tau_a = tau + (tau_a[k] - tau) exp(-t / T), which has
    a falling and a rising moment. The time constant T is in samples.
    """
    if not time_constant:
        return filter_shifted(command, *average_delayed(0.0))
    ratio = 1.0 / time_constant
    keep = np.exp(-ratio)  # tau_a[k + 1] = keep tau_a[k] + (1 - keep) tau[k]
    lagged = np.concatenate([command[:1], filter_lag(command[:-1], keep, command[0])])
    falling = (ratio - 1.0 + keep) / ratio**2
    rising = (1.0 - (1.0 + ratio) * keep) / ratio**2
    after = 0.5 * command + (lagged - command) * falling
    before = 0.5 * command + (lagged - command) * rising
    return np.asarray(after + np.concatenate([[before[0]], before[:-1]]))


@dataclass(frozen=True)
class DeadTime(Term):
    """Pure delay of the torque: the joint receives tau(t - d)."""

    dead_time: float = 0.005

    id = "dead_time"
    law = "tau(t) - tau(t - d)"
    kind = "actuation"
    nonlinear_parameters = (NonlinearParameter("dead_time", "s", 1e-4, 1.0, can_be_zero=True),)

    @property
    def fixed(self) -> tuple[Column, ...]:
        # A simulation delays the command, so that the column is zero.
        return (Column("dead_time", "1", force=lambda x: x.torque - x.memory.get("dead_time", (x.torque,))[0]),)

    @property
    def delay(self) -> float:
        return self.dead_time

    def trace(self, x: Samples, command: Array, period: float) -> Memory:
        return (filter_shifted(command, *average_delayed(self.dead_time / period)),)


def average_delayed(delay: float) -> tuple[int, Array]:
    """Return the filter that averages a held torque `delay` samples later, under a triangle of two samples.

    With a delay of n + f samples, the triangle from one sample before to one after the instant covers three periods.
    The filter is that of `filter_shifted`: its newest sample and weights (3,).
    """
    whole, share = divmod(delay, 1.0)
    return -int(whole), np.array([0.5 * (1 - share) ** 2, 0.5 + share - share**2, 0.5 * share**2])


@dataclass(frozen=True)
class BackEmf(Term):
    """Torque that a powered motor loses to its back-EMF, k q' while it is on.

    Indistinguishable from viscous friction if the motor is never off.
    """

    id = "back_emf"
    law = "k q' while the motor is on"
    kind = "actuation"

    columns = (Column("back_emf", "N m s/rad", force=lambda x: x.velocity * is_powered(x), least=0.0),)

    def start(self, x: Samples) -> Memory:
        return (1.0 + 0.0 * x.position,)

    def advance(self, memory: Memory, x: Samples, duration: ArrayLike) -> Memory:
        return (memory[0] + 0.0,)


def is_powered(x: Samples) -> ArrayLike:
    """Return 1 where the motor is on, else 0; 1 if unknown."""
    return x.memory.get(BackEmf.id, (1.0,))[0]
