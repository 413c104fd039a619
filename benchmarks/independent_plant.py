"""Recordings of pendulums with hidden effects, from a simulator that shares no code with the packages under test.

    I q'' + mgl sin q + b q' + fc Sgn q' + effects = tau          q = 0 hangs down, counter-clockwise positive, SI units

Many different plants run at once: the batch axis holds recordings, each with its own parameters, effects, excitation,
sampling rate and sensors. While the joint slides one way the right-hand side is smooth and a classical Runge-Kutta step
is as good as exact. Where the velocity would change sign inside a step, the step is cut at the zero; there the joint
sticks if the torques at rest are within the dry friction, and otherwise slides on in the direction they push.

    python -m benchmarks.independent_plant OUT --n 60 --seed 1        # a blind set: recordings and truth.json
"""

from __future__ import annotations

import argparse
import difflib
import gzip
import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.excitation import CLOSED_LOOP, EXCITATIONS, OPEN_LOOP

Array = NDArray[np.float64]
Policy = Callable[[Array], Array]  # positions (B,) [rad], one for each plant, to torques (B,) [N m]

MAX_STEP = 1e-3  # s, inner step of a rigid joint
STIFF_STEP = 0.5e-3  # s, inner step with walls or presliding
CONTACT_STEP = 0.2e-3  # s, inner step with two masses: the damper of a contact sets in with a jump of torque
PUSH_RATE = 1000  # Hz, at which random disturbing torques change
NEVER = 1e9  # a limit that is not reached

# Parameters of each effect with the values that switch it off (or, for shapes, the usual law). Signs: torques of
# the motor (offset, cogging) and the disturbance add to tau; tilt, spring, walls and friction stand on the left.
EFFECTS: dict[str, dict[str, float]] = {
    "torque_offset": {"offset": 0.0},  # tau + offset
    "gravity_tilt": {"tilt_cos": 0.0},  # tilt_cos cos q
    "coulomb_asymmetry": {"asym_c": 0.0},  # fc + asym_c forwards, fc - asym_c backwards
    "viscous_asymmetry": {"asym_v": 0.0},  # asym_v |v|
    "stribeck": {"strib_d": 0.0, "strib_v": 1.0, "strib_p": 2.0},  # strib_d exp(-|v / strib_v|^strib_p) sgn v
    "quadratic_drag": {"drag": 0.0},  # drag v|v|
    # (load_mu |tau + load_w sin q| + load_out |sin q|) sgn v
    "load_dependent_friction": {"load_mu": 0.0, "load_w": 0.0, "load_out": 0.0},
    "position_dependent_friction": {"pos_s": 0.0, "pos_c": 0.0},  # (pos_s sin q + pos_c cos q) sgn v
    "cogging": {"cog_n": 0.0, "cog_s": 0.0, "cog_c": 0.0},  # tau + cog_s sin Nq + cog_c cos Nq
    "torque_ripple": {"rip_n": 0.0, "rip_s": 0.0, "rip_c": 0.0},  # tau (1 + rip_s sin Nq + rip_c cos Nq)
    "spring": {"spring_k": 0.0, "spring_q0": 0.0},  # spring_k (q - spring_q0)
    "actuator_lag": {"lag_T": 0.0},  # lag_T tau' = command - tau
    "dead_time": {"dead_n": 0.0},  # tau is the command of dead_n samples ago (may be fractional), 0 before the first
    "torque_saturation": {"sat": NEVER, "sat_law": 0.0},  # 0: sat tanh(tau/sat), 1: clip, 2: tau / hypot(1, tau/sat)
    "friction_drift": {"drift_a": 0.0, "drift_T": 1.0, "drift_b": 1.0},  # dry (and drift_b of fluid) friction times
    #                                                                      1 + drift_a exp(-t / drift_T)
    "payload_change": {"pay_t": NEVER, "pay_I": 0.0, "pay_mgl": 0.0},  # I + pay_I, mgl + pay_mgl from pay_t on (rounded
    #                                                                   to an inner step)
    "periodic_disturbance": {"dist_a": 0.0, "dist_w": 0.0, "dist_ph": 0.0},  # tau + dist_a sin(dist_w t + dist_ph)
    # Motor inertia Jm and link inertia I - Jm, coupled by bl_k, bl_d beyond a play of +-bl_gap; with bl_grip = 0 the
    # damper cannot hold the two together.
    "backlash": {"Jm": 0.0, "bl_gap": 0.0, "bl_k": 0.0, "bl_d": 0.0, "bl_grip": 1.0},
    "joint_flexibility": {"Jm": 0.0, "bl_k": 0.0, "bl_d": 0.0},  # the same without play
    # Friction z' = dahl_sigma v (1 - sgn(v) z/f)^dahl_n with f the dry friction, plus dahl_d z'/dahl_sigma.
    "presliding": {"dahl_sigma": 0.0, "dahl_n": 1.0, "dahl_d": 0.0},
    "encoder_eccentricity": {"ecc_e": 0.0, "ecc_ph": 0.0},  # the encoder reads q + ecc_e sin(q + ecc_ph)
    # Pushes back by wall_k x (1 + wall_c x') + wall_d x' at a depth x beyond either wall, and never pulls.
    "hard_stop": {"wall_lo": -NEVER, "wall_hi": NEVER, "wall_k": 0.0, "wall_c": 0.0, "wall_d": 0.0},
    # Outside the library: what an honest diagnosis calls unexplained.
    "cubic_damping": {"cubic": 0.0},  # cubic v^3
    "knocks": {"knock_rate": 0.0, "knock_height": 0.0, "knock_width": 0.03},  # half-sine pulses at random times
    "random_walk_torque": {"walk_rms": 0.0, "walk_T": 4.0},  # wandering torque with correlation time walk_T
    "friction_spot": {"spot_f": 0.0, "spot_q": 0.0, "spot_w": 0.3},  # spot_f exp(-((q - spot_q) / spot_w)^2) sgn v
    "gain_falls_with_speed": {"fall": 0.0},  # tau (1 - fall |v|)
}
OUTSIDE_LIBRARY = ("cubic_damping", "knocks", "random_walk_torque", "friction_spot", "gain_falls_with_speed")
LIBRARY = tuple(effect for effect in EFFECTS if effect not in OUTSIDE_LIBRARY)
_TRANSMISSION = frozenset({"backlash", "joint_flexibility"})
_STIFF = frozenset({"presliding", "hard_stop"})
_RESTLESS = _TRANSMISSION | {"actuator_lag", "periodic_disturbance", "friction_drift"}  # free a stuck joint at any time
_NEUTRAL = {name: value for parameters in EFFECTS.values() for name, value in parameters.items()}


@dataclass(frozen=True)
class Plant:
    """A pendulum: base parameters and, by effect, the parameters listed in `EFFECTS` (others keep their default)."""

    inertia: float = 0.09  # kg m^2, motor and link together
    gravity: float = 2.0  # N m
    viscous: float = 0.35  # N m s/rad
    coulomb: float = 0.8  # N m
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    friction_side: str = "motor"  # where friction acts with backlash or flexibility: motor or link
    encoder_side: str = "motor"  # what the encoder sees with backlash or flexibility: motor or link

    def __post_init__(self) -> None:
        for effect, parameters in self.effects.items():
            _require(effect, EFFECTS, "effect")
            for name in parameters:
                _require(name, EFFECTS[effect], f"parameter of {effect}")
        if _TRANSMISSION <= self.effects.keys():
            raise ValueError("a plant has backlash or joint_flexibility, not both: they share the one transmission")
        if self.inertia <= self.parameters["Jm"]:
            raise ValueError(
                f"inertia {self.inertia:g} includes the motor's Jm {self.parameters['Jm']:g}: make it larger"
            )
        for side in (self.friction_side, self.encoder_side):
            _require(side, ("motor", "link"), "side")

    @property
    def parameters(self) -> dict[str, float]:
        """Every parameter of the simulation by name, neutral where the plant lacks the effect."""
        base = {name: getattr(self, name) for name in ("inertia", "gravity", "viscous", "coulomb")}
        return base | _NEUTRAL | {name: value for chosen in self.effects.values() for name, value in chosen.items()}


@dataclass(frozen=True)
class Experiment:
    """What is done to a plant and how it is measured. Time-varying effects start anew with each recording."""

    rate: float = 1000.0  # Hz; the command is held from one sample to the next
    seconds: float = 20.0
    excitation: str = "two_tone"  # one of EXCITATIONS
    scale: float = 1.0  # of the torque, or of the reference motion in a closed loop
    seed: int = 0  # of excitation, noise and random disturbances
    start: tuple[float, float] = (0.0, 0.0)  # rad, rad/s
    counts: int | None = 1_024_000  # encoder counts per turn; None reads exactly
    truncate: bool = False  # encoder counts down to the lower edge instead of to the nearest
    position_noise: float = 0.0  # rad RMS, before counting
    torque_noise: float = 0.02  # N m RMS, white, on the recorded torque
    torque_step: float = 0.0  # N m, resolution of the recorded torque
    noise_in_plant: bool = False  # whether the torque noise is real, not only recorded
    gains: tuple[float, float] = (12.0, 1.2)  # N m/rad, N m s/rad of the closed loop
    torque_limit: float = 8.0  # N m of the closed loop
    control: str = "pd"  # of the closed loop: pd, by the error's rate; servo, by the joint's speed; or speed, with PI

    def __post_init__(self) -> None:
        _require(self.excitation, EXCITATIONS, "excitation")

    @property
    def samples(self) -> int:
        return round(self.rate * self.seconds)


@dataclass(frozen=True)
class SimulatedRecording:
    """A recording as a user would have it, with the truth behind it."""

    plant: Plant
    experiment: Experiment
    time: Array  # (N,) s
    position: Array  # (N,) rad, as the encoder reads it
    torque: Array  # (N,) N m, as recorded
    command: Array  # (N,) N m, noise-free, held until the next sample
    exact_position: Array  # (N,) rad on the encoder's side, without counting and noise
    velocity: Array  # (N,) rad/s, its exact rate
    acceleration: Array  # (N,) rad/s^2, just after the sample
    sliding: NDArray[np.bool_]  # (N,) False while the joint sticks
    goal: Array  # (N,) of a closed loop, rad, or rad/s under control of the speed

    @property
    def truth(self) -> dict[str, Any]:
        """What is hidden, in the layout of truth.json."""
        plant, experiment = self.plant, self.experiment
        parameters: dict[str, Any] = {}
        for chosen in plant.effects.values():
            parameters |= chosen
        for pair, key in (("drift_a", "drift_T"), "drift"), (("ecc_e", "ecc_ph"), "ecc"):
            if pair[0] in parameters:
                parameters[key] = [parameters.pop(name) for name in pair]
        return {
            "hidden": list(plant.effects),
            "plant": {name: getattr(plant, name) for name in ("inertia", "gravity", "viscous", "coulomb")},
            "effect_parameters": parameters,
            "rate_hz": experiment.rate,
            "encoder_counts": experiment.counts,
            "torque_noise_rms": experiment.torque_noise,
        }


def _require(name: str, known: Iterable[str], what: str) -> None:
    """Raise for an unknown name, with the nearest and all known ones."""
    known = list(known)
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ValueError(f"unknown {what} '{name}': {hint}Known: {', '.join(known)}")


# ---------------------------------------------------------------------------------------------------------- physics


@dataclass(frozen=True)
class _Model:
    """Which effects a batch has, and where each state is in the rows of the state array."""

    effects: frozenset[str]
    motor_friction: bool  # of the batch's transmissions

    @cached_property
    def two_masses(self) -> bool:
        return bool(self.effects & _TRANSMISSION)

    @cached_property
    def lag(self) -> int:  # row of the lagged torque
        return 4 if self.two_masses else 2

    @cached_property
    def bristle(self) -> int:  # row of the presliding torque
        return self.lag + ("actuator_lag" in self.effects)

    @cached_property
    def states(self) -> int:
        return self.bristle + ("presliding" in self.effects)

    @cached_property
    def sliding(self) -> int:  # row of the velocity that friction opposes
        return 3 if self.two_masses and self.motor_friction else 1


class _Table:
    """Parameters of a batch: one row per name, readable and writable as an attribute view, one column per recording."""

    def __init__(self, names: Sequence[str], rows: Array) -> None:
        self.names, self.rows = names, rows
        self.__dict__.update(zip(names, rows, strict=True))

    def __getattr__(self, name: str) -> Array:  # only reached for names that are not rows
        raise AttributeError(f"no parameter '{name}' in the table")

    def take(self, columns: NDArray[np.intp]) -> _Table:
        return _Table(self.names, self.rows[:, columns])


def _table(model: _Model, plants: Sequence[Plant]) -> _Table:
    """Rows for the base parameters, the effects any plant has, and the torques that change on the way."""
    needed = model.effects | (_TRANSMISSION if model.two_masses else frozenset())
    unused = {name for effect in EFFECTS.keys() - needed for name in EFFECTS[effect]} - {
        name for effect in needed for name in EFFECTS[effect]
    }
    columns = [plant.parameters | {"command": 0.0, "push": 0.0} for plant in plants]
    names = [name for name in columns[0] if name not in unused]
    return _Table(names, np.array([[column[name] for column in columns] for name in names], dtype=float))


def _motor_torque(model: _Model, p: _Table, state: Array, angle: Array) -> Array:
    """Torque the motor makes of the (delayed) command."""
    tau = p.command
    if "actuator_lag" in model.effects:
        tau = np.where(p.lag_T > 0, state[model.lag], tau)
    if "torque_saturation" in model.effects:
        clipped = np.clip(tau, -p.sat, p.sat)
        ratio = tau / p.sat
        tau = np.select([p.sat_law == 0, p.sat_law == 1], [p.sat * np.tanh(ratio), clipped], tau / np.hypot(1, ratio))
    if "torque_ripple" in model.effects:
        tau = tau * (1 + p.rip_s * np.sin(p.rip_n * angle) + p.rip_c * np.cos(p.rip_n * angle))
    if "gain_falls_with_speed" in model.effects:
        tau = tau * np.maximum(1 - p.fall * np.abs(state[3] if model.two_masses else state[1]), 0)
    return tau


def _link_load(model: _Model, p: _Table, q: Array, v: Array) -> Array:
    """Torque of gravity, springs and walls against the motion of the link."""
    load = p.gravity * np.sin(q)
    if "gravity_tilt" in model.effects:
        load = load + p.tilt_cos * np.cos(q)
    if "spring" in model.effects:
        load = load + p.spring_k * (q - p.spring_q0)
    if "hard_stop" in model.effects:
        for side, depth in ((1, q - p.wall_hi), (-1, p.wall_lo - q)):
            push = p.wall_k * depth * (1 + p.wall_c * side * v) + p.wall_d * side * v
            load = load + side * (depth > 0) * np.maximum(push, 0)
    return load


def _friction(
    model: _Model, p: _Table, time: float | Array, q: Array, v: Array, tau: Array
) -> tuple[Array, Array]:  # fluid, dry
    """Friction that is a function of the velocity, and the bound of the dry friction (which may be set-valued)."""
    fluid, dry = p.viscous * v, p.coulomb
    if "viscous_asymmetry" in model.effects:
        fluid = fluid + p.asym_v * np.abs(v)
    if "quadratic_drag" in model.effects:
        fluid = fluid + p.drag * v * np.abs(v)
    if "cubic_damping" in model.effects:
        fluid = fluid + p.cubic * v**3
    if "stribeck" in model.effects:
        dry = dry + p.strib_d * np.exp(-(np.abs(v / p.strib_v) ** p.strib_p))
    if "load_dependent_friction" in model.effects:
        dry = dry + p.load_mu * np.abs(tau + p.load_w * np.sin(q)) + p.load_out * np.abs(np.sin(q))
    if "position_dependent_friction" in model.effects:
        dry = np.maximum(dry + p.pos_s * np.sin(q) + p.pos_c * np.cos(q), 0)
    if "friction_spot" in model.effects:
        dry = dry + p.spot_f * np.exp(-(((q - p.spot_q) / p.spot_w) ** 2))
    moved = p.asym_c if "coulomb_asymmetry" in model.effects else None  # [-(fc - a), fc + a] is [-fc, fc] moved by a
    if "friction_drift" in model.effects:
        warm = p.drift_a * np.exp(-time / p.drift_T)
        fluid, dry = fluid * (1 + p.drift_b * warm), dry * (1 + warm)
        moved = None if moved is None else moved * (1 + warm)
    return fluid if moved is None else fluid + moved, dry


def _balance(model: _Model, p: _Table, time: float | Array, state: Array) -> tuple[Array, Array, Array, Array | None]:
    """Torque on the rubbing body without dry friction, bound of the dry friction, its inertia, the other body's q''."""
    q, v = state[0], state[1]
    angle, speed = (state[2], state[3]) if model.two_masses else (q, v)
    tau = _motor_torque(model, p, state, angle)
    load = _link_load(model, p, q, v)
    friction_at = (angle, speed) if model.motor_friction else (q, v)
    fluid, dry = _friction(model, p, time, *friction_at, tau)
    if "torque_offset" in model.effects:
        tau = tau + p.offset
    if "cogging" in model.effects:
        tau = tau + p.cog_s * np.sin(p.cog_n * angle) + p.cog_c * np.cos(p.cog_n * angle)
    if "periodic_disturbance" in model.effects:
        load = load - p.dist_a * np.sin(p.dist_w * time + p.dist_ph)
    if "knocks" in model.effects or "random_walk_torque" in model.effects:
        load = load - p.push
    if not model.two_masses:
        return tau - load - fluid, dry, p.inertia, None
    twist = angle - q
    stretch = twist - np.clip(twist, -p.bl_gap, p.bl_gap)
    coupling = p.bl_k * stretch + p.bl_d * (speed - v) * (stretch != 0)
    coupling = np.where((p.bl_grip == 0) & (coupling * stretch < 0), 0.0, coupling)
    if model.motor_friction:
        return tau - coupling - fluid, dry, p.Jm, (coupling - load) / (p.inertia - p.Jm)
    return coupling - load - fluid, dry, p.inertia - p.Jm, (tau - coupling) / p.Jm


_Balance = tuple[Array, Array, Array, Array | None]


def _rate(model: _Model, p: _Table, state: Array, direction: Array, balance: _Balance) -> Array:
    """Time derivative of the state while `direction` (-1, 0 sticking, 1) does not change."""
    drive, dry, inertia, other = balance
    rate = np.empty_like(state)
    friction = direction * dry
    if "presliding" in model.effects:
        v, z = state[model.sliding], state[model.bristle]
        room = 1 - np.sign(v) * z / dry
        bristle = p.dahl_sigma * v * np.sign(room) * np.abs(room) ** p.dahl_n
        rate[model.bristle] = bristle
        viscous = p.dahl_d * bristle / np.where(p.dahl_sigma > 0, p.dahl_sigma, 1)
        friction = np.where(p.dahl_sigma > 0, z + viscous, friction)
    own = (direction != 0) * (drive - friction) / inertia
    rate[0], rate[1] = state[1], own
    if other is not None:
        rate[2], rate[3] = state[3], other
        if model.motor_friction:
            rate[1], rate[3] = other, own
    if "actuator_lag" in model.effects:
        rate[model.lag] = (p.command - state[model.lag]) / np.where(p.lag_T > 0, p.lag_T, 1)
    return rate


def _runge_kutta(
    model: _Model,
    p: _Table,
    time: float | Array,
    step: float | Array,
    state: Array,
    direction: Array,
    balance: _Balance,
) -> tuple[Array, Array]:  # state after the step, rate before it
    """One classical fourth-order step without a change of direction; `balance` is the one at its beginning."""

    def rate(after: float | Array, moved: Array) -> Array:
        return _rate(model, p, moved, direction, _balance(model, p, time + after, moved))

    k1 = _rate(model, p, state, direction, balance)
    k2 = rate(step / 2, state + step / 2 * k1)
    k3 = rate(step / 2, state + step / 2 * k2)
    k4 = rate(step, state + step * k3)
    return state + step / 6 * (k1 + 2 * (k2 + k3) + k4), k1


def _direction_from_rest(balance: _Balance) -> Array:
    """Where a joint at rest starts to slide; 0 if dry friction holds it."""
    drive, dry = balance[:2]
    return np.sign(drive) * (np.abs(drive) > dry)


def _first_zero(before: Array, rate: Array, after: Array) -> Array:
    """Fraction of the step at which the parabola through both velocities, with the given rate, first changes sign."""
    c0, c1 = before, rate
    c2 = after - c0 - c1
    r = -0.5 * (c1 + np.where(c1 < 0, -1, 1) * np.sqrt(np.maximum(c1**2 - 4 * c2 * c0, 0)))
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = r / c2, c0 / r
    inside = (one > 0) & (one <= 1)
    fraction: Array = np.clip(np.nan_to_num(np.where(inside, one, two)), 0, 1)
    return fraction * (before != 0)


def _finish(
    model: _Model, p: _Table, time: Array, step: Array, state: Array, direction: Array, balance: _Balance
) -> tuple[Array, Array]:
    """State and direction after the rest of a step that changed its direction; a second change in it ends in stick."""
    after, _ = _runge_kutta(model, p, time, step, state, direction, balance)
    again = direction * after[model.sliding] < 0
    after[model.sliding, again] = 0.0
    return after, np.where(again, 0.0, direction)


def _select(balance: _Balance, columns: NDArray[np.intp]) -> _Balance:
    drive, dry, inertia, other = balance
    return drive[columns], dry[columns], inertia[columns], None if other is None else other[columns]


def _step(
    model: _Model, p: _Table, time: float, step: float, state: Array, direction: Array
) -> tuple[Array, Array, Array, Array]:  # state and direction after the step, direction and rate at its beginning
    """One inner step, cut where the sliding of a recording ends or begins."""
    balance = _balance(model, p, time, state)
    direction = np.where(direction == 0, _direction_from_rest(balance), direction)
    after, rate = _runge_kutta(model, p, time, step, state, direction, balance)
    end, row = direction.copy(), model.sliding

    turned = direction * after[row] < 0
    if "presliding" in model.effects:
        turned &= p.dahl_sigma == 0  # friction with a state is smooth through zero
    if (at := np.flatnonzero(turned)).size:
        some, start = p.take(at), state[:, at]
        part = step * _first_zero(start[row], step * rate[row, at], after[row, at])
        stop, _ = _runge_kutta(model, some, time, part, start, direction[at], _select(balance, at))
        stop[row] = 0.0
        at_rest = _balance(model, some, time + part, stop)
        onward = _direction_from_rest(at_rest) * (start[row] != 0)  # what only just came free and fell back sticks
        after[:, at], end[at] = _finish(model, some, time + part, step - part, stop, onward, at_rest)

    if model.effects & _RESTLESS and (at := np.flatnonzero(direction == 0)).size:
        some, held = p.take(at), _select(balance, at)
        later = _balance(model, some, time + step, after[:, at])
        if (freed := np.flatnonzero(_direction_from_rest(later))).size:
            at, some, held, later = at[freed], some.take(freed), _select(held, freed), _select(later, freed)
            before, beyond = held[1] - np.abs(held[0]), np.abs(later[0]) - later[1]  # distance to slipping
            part = step * before / (before + beyond)
            slip, _ = _runge_kutta(model, some, time, part, state[:, at], direction[at], held)
            at_slip = _balance(model, some, time + part, slip)
            onward = np.sign(later[0])
            after[:, at], end[at] = _finish(model, some, time + part, step - part, slip, onward, at_slip)
    return after, end, direction, rate


# ------------------------------------------------------------------------------------------------- command and sensors


class _Clock:
    """Commands and measurements of all recordings of a batch that share a sampling rate.

    Args:
        columns: where these recordings are in the batch.
        every: inner steps per sample.
        commands: a command (N,) for each recording, replacing its excitation where not None.
        policy: decides all commands from the positions that are read, (B,) both.
    """

    def __init__(
        self,
        cases: Sequence[tuple[Plant, Experiment]],
        columns: NDArray[np.intp],
        every: int,
        commands: Sequence[Array | None],
        policy: Policy | None,
    ) -> None:
        self.columns, self.every, self.policy = columns, every, policy
        self.plants, self.experiments = zip(*cases, strict=True)
        count, longest = len(cases), max(experiment.samples for experiment in self.experiments)
        self.samples = longest
        shape = (longest, count)
        self.command, self.torque_noise, self.position_noise = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.reference = np.zeros(shape)
        self.closed = np.array([e.excitation in CLOSED_LOOP for e in self.experiments])
        for j, (experiment, command) in enumerate(zip(self.experiments, commands, strict=True)):
            n, time = experiment.samples, np.arange(experiment.samples) / experiment.rate
            rng, noise = (np.random.default_rng([experiment.seed, stream]) for stream in (0, 1))
            if command is not None:
                self.command[:n, j], self.closed[j] = command, False
            elif self.closed[j]:
                self.reference[:n, j] = CLOSED_LOOP[experiment.excitation](rng, time, experiment.scale)
                self.reference[n:, j] = self.reference[n - 1, j]
            else:
                self.command[:n, j] = OPEN_LOOP[experiment.excitation](rng, time, experiment.scale)
            self.torque_noise[:n, j] = experiment.torque_noise * noise.standard_normal(n)
            self.position_noise[:n, j] = experiment.position_noise * noise.standard_normal(n)
        parameters = [plant.parameters for plant in self.plants]
        self.eccentricity, self.phase = (np.array([p[name] for p in parameters]) for name in ("ecc_e", "ecc_ph"))
        self.delay = np.array([round(p["dead_n"] * every) for p in parameters])  # inner steps
        self.felt = np.array([e.noise_in_plant for e in self.experiments])
        self.count = np.array([2 * np.pi / (e.counts or np.inf) for e in self.experiments])  # rad
        self.shift = np.array([0.0 if e.truncate else 0.5 for e in self.experiments])
        self.gains, self.limit = (
            np.array([e.gains for e in self.experiments]).T,
            np.array([e.torque_limit for e in self.experiments]),
        )
        self.smoothing = 1 - np.exp(-2 * np.pi * 30 / self.experiments[0].rate)  # of the loop's velocity, 30 Hz
        self.row = np.array([2 * (plant.encoder_side == "motor") for plant in self.plants])
        self.speed, self.integral = np.zeros((2, count))
        self.control = np.array([e.control for e in self.experiments])
        goals = np.gradient(self.reference, axis=0) * self.experiments[0].rate
        self.goal = np.where(self.control == "speed", goals, self.reference)
        self.angle, self.rate, self.rate_change, self.position = (np.zeros(shape) for _ in range(4))
        self.follows = policy is not None or bool(self.closed.any())
        self.sliding = np.zeros(shape, bool)

    def due(self, i: int) -> bool:
        return i % self.every == 0 and i // self.every < self.samples

    def measure(self, i: int, state: Array, two_masses: bool) -> None:
        """Note the motion and, where the command depends on it, read the encoder and decide the command."""
        k, row = i // self.every, self.row if two_masses else 0
        self.angle[k], self.rate[k] = state[row, self.columns], state[row + 1, self.columns]
        if not self.follows:
            return
        self.position[k] = position = self.read(self.angle[k], self.position_noise[k])
        if self.closed.any():
            back = max(k - 1, 0)
            rate = self.experiments[0].rate
            self.speed += self.smoothing * ((position - self.position[back]) * rate - self.speed)
            error = self.reference[k] - position
            error_rate = (self.reference[k] - self.reference[back]) * rate - self.speed
            wanted = self.gains[0] * error + self.gains[1] * error_rate
            wanted = np.where(self.control == "servo", self.gains[0] * error - self.gains[1] * self.speed, wanted)
            slow = self.goal[k] - self.speed
            by_speed = self.gains[0] * slow + self.gains[1] * self.integral
            self.integral += np.where((np.abs(by_speed) > self.limit) & (by_speed * slow > 0), 0.0, slow / rate)
            torque = np.clip(np.where(self.control == "speed", by_speed, wanted), -self.limit, self.limit)
            self.command[k] = np.where(self.closed, torque, self.command[k])
        if self.policy is not None:
            self.command[k] = self.policy(position)

    def read(self, angle: Array, noise: Array) -> Array:
        """What the encoders say of angles (..., B)."""
        seen = angle + self.eccentricity * np.sin(angle + self.phase) + noise
        with np.errstate(invalid="ignore", divide="ignore"):
            counted = np.floor(seen / self.count + self.shift) * self.count
        return np.where(self.count > 0, counted, seen)

    def acting(self, i: int) -> Array:
        """The command that acts during inner step i, after its dead time."""
        if not self.delay.any():
            k = min(i // self.every, self.samples - 1)
            return self.command[k] + self.felt * self.torque_noise[k]
        k = np.minimum((i - self.delay) // self.every, self.samples - 1)
        at = np.maximum(k, 0), np.arange(len(k))
        return np.where(k >= 0, self.command[at] + self.felt * self.torque_noise[at], 0.0)

    def keep(self, i: int, rate: Array, direction: Array, two_masses: bool) -> None:
        """Note what is only known once the command is: acceleration, and whether the joint slides."""
        k, row = i // self.every, self.row if two_masses else 0
        self.rate_change[k], self.sliding[k] = rate[row + 1, self.columns], direction[self.columns] != 0

    def recordings(self) -> list[SimulatedRecording]:
        q, v, e = self.angle, self.rate, self.eccentricity
        exact, turned = q + e * np.sin(q + self.phase), 1 + e * np.cos(q + self.phase)
        velocity, acceleration = v * turned, self.rate_change * turned - e * v**2 * np.sin(q + self.phase)
        position = self.read(q, self.position_noise)
        recordings = []
        for j, (plant, experiment) in enumerate(zip(self.plants, self.experiments, strict=True)):
            n = experiment.samples
            torque = self.command[:n, j] + self.torque_noise[:n, j]
            if experiment.torque_step:
                torque = np.round(torque / experiment.torque_step) * experiment.torque_step
            kept = (self.command, exact, velocity, acceleration, self.sliding, self.goal)
            time = np.arange(n) / experiment.rate
            copies = (array[:n, j].copy() for array in kept)
            recordings.append(SimulatedRecording(plant, experiment, time, position[:n, j].copy(), torque, *copies))
        return recordings


def _pushes(plant: Plant, experiment: Experiment, seconds: float) -> Array:
    """Random disturbing torque at PUSH_RATE [N m]: knocks and wandering."""
    n = round(seconds * PUSH_RATE) + 1
    rng, p, push = np.random.default_rng([experiment.seed, 2]), plant.parameters, np.zeros(n)
    if p["knock_rate"]:
        pulse = np.sin(np.pi * (np.arange(round(p["knock_width"] * PUSH_RATE)) + 0.5) / (p["knock_width"] * PUSH_RATE))
        for begin in rng.uniform(0, seconds, rng.poisson(p["knock_rate"] * seconds)):
            at = int(begin * PUSH_RATE)
            push[at : at + len(pulse)] += p["knock_height"] * rng.choice([-1, 1]) * pulse[: n - at]
    if p["walk_rms"]:
        kept = np.exp(-1 / (p["walk_T"] * PUSH_RATE))
        steps = p["walk_rms"] * np.sqrt(1 - kept**2) * rng.standard_normal(n)
        walk = 0.0
        for k, w in enumerate(steps.tolist()):
            walk = kept * walk + w
            push[k] += walk
    return push


# --------------------------------------------------------------------------------------------------------- simulation


def _inner_steps(plant: Plant, experiment: Experiment) -> int:
    """Inner steps per sample."""
    longest = STIFF_STEP if _STIFF & plant.effects.keys() else MAX_STEP
    longest = CONTACT_STEP if _TRANSMISSION & plant.effects.keys() else longest
    return max(1, int(np.ceil(1 / (experiment.rate * longest) - 1e-9)))


def _simulate_batch(
    cases: Sequence[tuple[Plant, Experiment]], commands: Sequence[Array | None], policy: Policy | None = None
) -> list[Any]:
    """Recordings of plants that share an inner step and the side of friction, in the order given."""
    plants, experiments = zip(*cases, strict=True)
    model = _Model(frozenset().union(*(plant.effects for plant in plants)), plants[0].friction_side == "motor")
    if not model.two_masses:
        model = replace(model, motor_friction=False)
    p = _table(model, plants)

    step = 1 / (experiments[0].rate * _inner_steps(*cases[0]))
    every = np.array([round(1 / (experiment.rate * step)) for experiment in experiments])
    clocks = []
    for n in np.unique(every).tolist():
        columns = np.flatnonzero(every == n)
        members = columns.tolist()
        clocks.append(_Clock([cases[j] for j in members], columns, n, [commands[j] for j in members], policy))
    seconds = max(experiment.seconds for experiment in experiments)
    pushed = [j for j, plant in enumerate(plants) if {"knocks", "random_walk_torque"} & plant.effects.keys()]
    pushes = np.array([_pushes(plants[j], experiments[j], seconds) for j in pushed])
    loaded = {j: round(p.pay_t[j] / step) for j, plant in enumerate(plants) if "payload_change" in plant.effects}

    state = np.zeros((model.states, len(cases)))
    state[:2] = np.array([experiment.start for experiment in experiments]).T
    if model.two_masses:
        state[2:4] = state[:2]
    direction = np.sign(state[model.sliding])
    if "presliding" in model.effects:
        direction[p.dahl_sigma > 0] = 1.0  # never sticks
    for i in range(max(clock.every * clock.samples for clock in clocks)):
        time = i * step
        for j, begin in loaded.items():
            if i == begin:
                p.inertia[j] += p.pay_I[j]
                p.gravity[j] += p.pay_mgl[j]
        if pushed:
            p.push[pushed] = pushes[:, int(time * PUSH_RATE + 1e-6)]
        due = [clock for clock in clocks if clock.due(i)]
        for clock in due:
            clock.measure(i, state, model.two_masses)
        for clock in due if "dead_time" not in model.effects else clocks:
            p.command[clock.columns] = clock.acting(i)
        after, end, direction, rate = _step(model, p, time, step, state, direction)
        for clock in due:
            clock.keep(i, rate, direction, model.two_masses)
        state, direction = after, end

    done: list[Any] = [None] * len(cases)
    for clock in clocks:
        for j, recording in zip(clock.columns.tolist(), clock.recordings(), strict=True):
            done[j] = recording
    return done


def steer(cases: Sequence[tuple[Plant, Experiment]], policy: Policy) -> list[SimulatedRecording]:
    """Simulate plants of one inner step and rate under a policy that is asked once a sample."""
    recordings: list[SimulatedRecording] = _simulate_batch(cases, [None] * len(cases), policy)
    return recordings


def simulate(
    cases: Sequence[tuple[Plant, Experiment]], commands: Sequence[Array | None] | None = None, workers: int = 1
) -> list[SimulatedRecording]:
    """Simulate every (plant, experiment) and return the recordings in the same order.

    Recordings that can share an inner step run as one batch, whatever their effects, rates and lengths.

    Args:
        commands: a torque command (N,) [N m] per case, replacing its excitation where not None.
        workers: processes to spread the batches over.
    """
    commands = [None] * len(cases) if commands is None else list(commands)
    groups: dict[tuple[Any, ...], list[int]] = {}
    for j, (plant, experiment) in enumerate(cases):
        step = 1 / (experiment.rate * _inner_steps(plant, experiment))
        two = bool(_TRANSMISSION & plant.effects.keys())
        key = (round(step * 1e12), two, plant.friction_side if two else "")
        groups.setdefault(key, []).append(j)
    jobs = []
    for members in groups.values():  # alike effects together, so that a batch computes few laws
        members.sort(key=lambda j: sorted(cases[j][0].effects))
        pieces = workers if len(members) > 8 * workers else 1
        jobs += [part.tolist() for part in np.array_split(members, pieces)]
    jobs.sort(key=len, reverse=True)
    arguments = [([cases[j] for j in job], [commands[j] for j in job]) for job in jobs]
    if workers > 1 and len(jobs) > 1:
        with ProcessPoolExecutor(workers) as pool:
            batches = list(pool.map(_simulate_batch, *zip(*arguments, strict=True)))
    else:
        batches = [_simulate_batch(*argument) for argument in arguments]
    done: dict[int, SimulatedRecording] = {}
    for job, batch in zip(jobs, batches, strict=True):
        done.update(zip(job, batch, strict=True))
    return [done[j] for j in range(len(cases))]


@dataclass(frozen=True)
class EffectShare:
    """How much of the torque a base model of four terms misses, over the samples in motion, relative to RMS torque."""

    with_true_parameters: float  # the hidden effect itself
    after_refit: float  # what remains when inertia, gravity, viscous and Coulomb friction are fitted to hide it


def effect_share(recording: SimulatedRecording, slowest: float = 0.02) -> EffectShare:
    """Share of the hidden effect in the torque balance on the exact, noise-free motion faster than `slowest` [rad/s].

    The commanded torque is compared with I q'' + mgl sin q + b q' + fc sgn q' of the motion the encoder sees; without
    effects both shares are zero up to rounding.
    """
    use = recording.sliding & (np.abs(recording.velocity) > slowest)
    q, v, a = recording.exact_position[use], recording.velocity[use], recording.acceleration[use]
    tau, plant = recording.command[use], recording.plant
    if len(tau) < 10 or not np.any(tau):
        return EffectShare(0.0, 0.0)
    phi = np.column_stack([a, np.sin(q), v, np.sign(v)])  # (N, 4)
    true = np.array([plant.inertia, plant.gravity, plant.viscous, plant.coulomb])
    fitted = np.linalg.lstsq(phi, tau, rcond=None)[0]
    rms = np.sqrt(np.mean(tau**2))
    return EffectShare(*(float(np.sqrt(np.mean((tau - phi @ theta) ** 2)) / rms) for theta in (true, fitted)))


# --------------------------------------------------------------------------------------------------------- random cases


@dataclass(frozen=True)
class Case:
    """A random plant with one experiment to learn from and another to be judged on."""

    plant: Plant
    train: Experiment
    holdout: Experiment


def _around(rng: np.random.Generator, value: float) -> float:
    """Half to twice the value, evenly in the logarithm."""
    return float(value * 2 ** rng.uniform(-1, 1))


def _random_effect(
    rng: np.random.Generator, effect: str, base: dict[str, float], experiment: Experiment, variants: bool
) -> dict[str, float]:
    """Parameters of one effect: half to twice a typical size, random sign and phase where both make sense."""
    sign, angle = float(rng.choice([-1, 1])), rng.uniform(0, 2 * np.pi)
    either = bool(rng.integers(2)) and variants  # whether to take the less usual law

    def wave(sine: str, cosine: str, size: float) -> dict[str, float]:
        return {sine: float(size * np.sin(angle)), cosine: float(size * np.cos(angle))}

    match effect:
        case "torque_offset":
            return {"offset": sign * _around(rng, 0.2)}
        case "gravity_tilt":
            return {"tilt_cos": sign * _around(rng, 0.2)}
        case "coulomb_asymmetry":
            return {"asym_c": sign * _around(rng, 0.18)}
        case "viscous_asymmetry":
            return {"asym_v": sign * min(_around(rng, 0.07), 0.6 * base["viscous"])}
        case "stribeck":
            law = {"strib_p": 1.0} if either else {}
            return {"strib_d": _around(rng, 0.45), "strib_v": _around(rng, 0.6)} | law
        case "quadratic_drag":
            return {"drag": _around(rng, 0.035)}
        case "load_dependent_friction":
            law = {"load_w": base["gravity"]} if either else {}
            return {"load_mu": _around(rng, 0.1)} | law
        case "position_dependent_friction":
            return wave("pos_s", "pos_c", min(_around(rng, 0.28), 0.7 * base["coulomb"]))
        case "cogging":
            return {"cog_n": float(rng.integers(6, 25))} | wave("cog_s", "cog_c", _around(rng, 0.18))
        case "torque_ripple":
            return {"rip_n": float(rng.integers(3, 15))} | wave("rip_s", "rip_c", _around(rng, 0.08))
        case "spring":
            return {"spring_k": _around(rng, 0.25), "spring_q0": float(rng.uniform(-0.6, 0.6))}
        case "actuator_lag":
            return {"lag_T": _around(rng, 0.012)}
        case "dead_time":
            samples = max(1.0, _around(rng, 0.012) * experiment.rate)
            return {"dead_n": samples if either else float(round(samples))}
        case "torque_saturation":
            law = {"sat_law": float(rng.integers(1, 3))} if either else {}
            return {"sat": _around(rng, 7.0)} | law
        case "friction_drift":
            law = {"drift_b": 0.0} if either else {}
            return {"drift_a": _around(rng, 0.4), "drift_T": _around(rng, 8.0)} | law
        case "payload_change":
            less = -0.5 if either else 1.0
            return {
                "pay_t": round(experiment.seconds * rng.uniform(0.3, 0.7), 2),
                "pay_I": less * _around(rng, 0.02),
                "pay_mgl": less * _around(rng, 0.4),
            }
        case "periodic_disturbance":
            return {"dist_a": _around(rng, 0.2), "dist_w": _around(rng, 20.0), "dist_ph": angle}
        case "backlash":
            return {
                "Jm": min(_around(rng, 0.02), 0.5 * base["inertia"]),
                "bl_gap": _around(rng, 0.02),
                "bl_k": _around(rng, 400.0),
                "bl_d": _around(rng, 0.8),
            } | ({"bl_grip": 0.0} if either else {})
        case "joint_flexibility":
            return {
                "Jm": min(_around(rng, 0.03), 0.5 * base["inertia"]),
                "bl_k": _around(rng, 22.0),
                "bl_d": _around(rng, 0.05),
            }
        case "presliding":
            law = {"dahl_n": 2.0} if either else {}
            return {"dahl_sigma": _around(rng, 40.0)} | law
        case "encoder_eccentricity":
            return {"ecc_e": _around(rng, 0.02), "ecc_ph": angle}
        case "hard_stop":  # within reach of most excitations
            low, high = (0.25, 0.6) if experiment.excitation == "multisine" else (0.6, 1.3)
            walls = {"wall_lo": -float(rng.uniform(low, high)), "wall_hi": float(rng.uniform(low, high))}
            if rng.random() < 0.5:  # one of them alone
                del walls[str(rng.choice(list(walls)))]
            losses = {"wall_d": 0.3} if either else {"wall_c": float(rng.uniform(0.0, 0.1))}
            return walls | {"wall_k": _around(rng, 40.0)} | losses
        case "cubic_damping":
            return {"cubic": _around(rng, 0.004)}
        case "knocks":
            return {"knock_rate": _around(rng, 0.6), "knock_height": _around(rng, 3.0)}
        case "random_walk_torque":
            return {"walk_rms": _around(rng, 0.25)}
        case "friction_spot":
            return {"spot_f": _around(rng, 0.8), "spot_q": float(rng.uniform(-0.5, 0.5))}
        case "gain_falls_with_speed":
            return {"fall": _around(rng, 0.02)}
    _require(effect, EFFECTS, "effect")
    raise NotImplementedError(f"no typical size for '{effect}': add it beside the others")


def random_case(
    rng: np.random.Generator, effects: Sequence[str] = (), wide: bool = False, variants: bool = False, **overrides: Any
) -> Case:
    """A random plant with the given hidden effects and two experiments on it that differ in their seed.

    Args:
        wide: base parameters half to twice the usual ranges.
        variants: also laws that differ from the usual ones (Stribeck without the square, clipped torque, ...).
        overrides: fields of `Experiment`, for both experiments, or of `Plant`; its `effects` add to the random ones.
    """
    stretch = 2 ** rng.uniform(-1, 1, 4) if wide else np.ones(4)
    ranges = {"inertia": (0.06, 0.12), "gravity": (1.4, 2.6), "viscous": (0.25, 0.5), "coulomb": (0.65, 1.2)}
    base = {name: float(rng.uniform(*ends) * k) for (name, ends), k in zip(ranges.items(), stretch, strict=True)}
    fields: dict[str, Any] = base | {n: value for n, value in overrides.items() if n in Plant.__dataclass_fields__}
    seeds = rng.integers(2**31, size=2).tolist()
    excitation = str(rng.choice(EXCITATIONS, p=_WEIGHTS))
    scale = float(rng.uniform(0.8, 1.3))
    known = {name: value for name, value in overrides.items() if name in Experiment.__dataclass_fields__}
    for name in overrides.keys() - known.keys() - fields.keys():
        _require(name, [*Experiment.__dataclass_fields__, *Plant.__dataclass_fields__], "field")
    # A small motor cannot be asked to throw a pendulum twice as heavy: torque grows with gravity and friction.
    strength = 1.0 if not wide else max(1.0, (fields["gravity"] + fields["coulomb"]) / 3.2)
    scale = scale * strength if excitation in OPEN_LOOP and excitation != "two_tone" else strength
    train = Experiment(**({"excitation": excitation, "scale": scale, "seed": seeds[0]} | known))
    hidden = {effect: _random_effect(rng, effect, fields, train, variants) for effect in effects}
    hidden |= fields.pop("effects", {})
    return Case(Plant(effects=hidden, **fields), train, replace(train, seed=seeds[1]))


_WEIGHTS = np.array([4, 2, 4, 4, 1, 1.5, 1.5, 2, 0]) / 20  # of EXCITATIONS in a random case


def _write_csv(path: Path, recording: SimulatedRecording) -> None:
    columns = zip(recording.time.tolist(), recording.position.tolist(), recording.torque.tolist(), strict=True)
    digits = 4 if (1e4 / recording.experiment.rate).is_integer() else 7
    body = "\n".join(f"{t:.{digits}f},{q:.8g},{u:.5g}" for t, q, u in columns)
    with path.open("wb") as file, gzip.GzipFile("", "wb", 6, file, mtime=0) as packed:  # the same bytes on every run
        packed.write(f"time,position,torque\n{body}\n".encode())


def write_case(folder: str | Path, name: str, train: SimulatedRecording, holdout: SimulatedRecording) -> None:
    """Write NAME.train.csv.gz and NAME.holdout.csv.gz, and add NAME to the folder's truth.json."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    shares = {}
    for part, recording in (("train", train), ("holdout", holdout)):
        _write_csv(folder / f"{name}.{part}.csv.gz", recording)
        share = effect_share(recording)
        shares[part] = {"true": round(share.with_true_parameters, 5), "refit": round(share.after_refit, 5)}
    path = folder / "truth.json"
    truth = json.loads(path.read_text()) if path.exists() else {}
    experiment = train.experiment
    truth[name] = train.truth | {"excitation": experiment.excitation, "scale": experiment.scale, "effect_share": shares}
    path.write_text(json.dumps(truth, indent=1) + "\n")


def blind_set(
    rng: np.random.Generator,
    n: int = 60,
    nulls: int = 10,
    pairs: int = 8,
    outside: int = 0,
    misfits: int = 0,
    **options: Any,
) -> list[Case]:
    """`n` random cases: nothing hidden, pairs, effects outside the library, and every library effect in turn.

    Misfits have an effect of the library and one that it lacks.
    """
    couples = [pair for pair in combinations(LIBRARY, 2) if not _TRANSMISSION & set(pair)]
    couples.remove(("torque_offset", "coulomb_asymmetry"))  # the same set of torques: no data can tell them apart
    chosen = rng.permutation(len(couples))[:pairs].tolist()
    alone = n - nulls - pairs - outside - misfits
    if alone < 0:
        raise ValueError(f"n = {n} is less than nulls + pairs + outside + misfits = {n - alone}: raise n")
    hidden: list[Sequence[str]] = [() for _ in range(nulls)] + [couples[j] for j in chosen]
    hidden += [(OUTSIDE_LIBRARY[j % len(OUTSIDE_LIBRARY)],) for j in range(outside)]
    order = rng.permutation(len(LIBRARY)).tolist() if misfits else []
    hidden += [(LIBRARY[order[j % len(LIBRARY)]], OUTSIDE_LIBRARY[j % len(OUTSIDE_LIBRARY)]) for j in range(misfits)]
    hidden += [(LIBRARY[j % len(LIBRARY)],) for j in range(alone)]
    cases = []
    for effects in (hidden[j] for j in rng.permutation(len(hidden)).tolist()):
        sensors = {
            "rate": float(rng.choice([200, 500, 1000, 2000], p=[0.2, 0.2, 0.4, 0.2])),
            "counts": int(rng.choice([8192, 65536, 1_024_000], p=[0.25, 0.25, 0.5])),
            "torque_noise": float(rng.choice([0.02, 0.05, 0.1], p=[0.6, 0.2, 0.2])),
        }
        cases.append(random_case(rng, effects, **(sensors | options)))
    return cases


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.independent_plant", description=blind_set.__doc__)
    parser.add_argument("out", type=Path, help="folder for the recordings and truth.json")
    parser.add_argument("--n", type=int, default=60, help="cases in all (default 60)")
    parser.add_argument("--nulls", type=int, default=10, help="cases with nothing hidden (default 10)")
    parser.add_argument("--pairs", type=int, default=8, help="cases with two effects (default 8)")
    parser.add_argument("--outside", type=int, default=0, help="cases with an effect the library lacks (default 0)")
    parser.add_argument(
        "--misfits", type=int, default=0, help="cases with a library effect and one it lacks (default 0)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--wide", action="store_true", help="plants half to twice the usual ranges")
    parser.add_argument("--variants", action="store_true", help="also less usual laws of the same effects")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args(argv)
    rng = np.random.default_rng(args.seed)
    try:
        options = {"wide": args.wide, "variants": args.variants, "seconds": args.seconds}
        cases = blind_set(rng, args.n, args.nulls, args.pairs, args.outside, args.misfits, **options)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    runs = [(case.plant, experiment) for case in cases for experiment in (case.train, case.holdout)]
    recordings = simulate(runs, workers=args.workers)
    for j in range(len(cases)):
        write_case(args.out, f"case_{j:03d}", recordings[2 * j], recordings[2 * j + 1])
    print(f"{len(cases)} cases in {args.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
