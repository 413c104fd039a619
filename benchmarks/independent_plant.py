"""Recordings of pendulums with hidden effects, from a simulator that shares no code with the packages under test.

    I q'' + mgl sin q + b q' + fc Sgn q' + effects = tau          q = 0 hangs down, counter-clockwise positive, SI units

While the joint slides in one direction, the right-hand side is smooth, and a classical Runge-Kutta step is nearly
exact. Where the velocity would change sign inside a step, the step is cut at the zero. There the joint sticks if the
torque at rest is within the dry friction; otherwise it slides in the direction of the torque. Numba compiles the steps.
"""

from __future__ import annotations

import difflib
import gzip
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from benchmarks.draws import choose_pairs, make_generator, shuffle_keys
from benchmarks.excitation import CLOSED_LOOP, EXCITATIONS, OPEN_LOOP

Array = NDArray[np.float64]

MAX_STEP = 1e-3  # s, inner step of a rigid joint
STIFF_STEP = 0.5e-3  # s, inner step with walls or presliding
CONTACT_STEP = 0.2e-3  # s, inner step with two masses: a contact damper starts with a step of torque
PUSH_RATE = 1000  # Hz, at which random disturbing torques change
NEVER = 1e9  # inactive limit

# Parameters of each effect with neutral values (or, for exponents and the like, the default law). Signs: torques of
# the motor (offset, cogging) and the disturbance add to tau; tilt, spring, walls and friction are on the left.
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
    # the same without play; bl_b v is friction of the link, in addition to that of the motor
    "joint_flexibility": {"Jm": 0.0, "bl_k": 0.0, "bl_d": 0.0, "bl_b": 0.0},
    # Friction z' = dahl_sigma v (1 - sgn(v) z/f)^dahl_n with f the dry friction, plus dahl_d z'/dahl_sigma.
    "presliding": {"dahl_sigma": 0.0, "dahl_n": 1.0, "dahl_d": 0.0},
    "encoder_eccentricity": {"ecc_e": 0.0, "ecc_ph": 0.0},  # the encoder reads q + ecc_e sin(q + ecc_ph)
    # Pushes back by wall_k x (1 + wall_c x') + wall_d x' at a depth x beyond either wall, and never pulls.
    "hard_stop": {"wall_lo": -NEVER, "wall_hi": NEVER, "wall_k": 0.0, "wall_c": 0.0, "wall_d": 0.0},
    # Outside the library: a correct diagnosis reports an unexplained residual.
    "cubic_damping": {"cubic": 0.0},  # cubic v^3
    "knocks": {"knock_rate": 0.0, "knock_height": 0.0, "knock_width": 0.03},  # half-sine pulses at random times
    "random_walk_torque": {"walk_rms": 0.0, "walk_T": 4.0},  # wandering torque with correlation time walk_T
    "friction_spot": {"spot_f": 0.0, "spot_q": 0.0, "spot_w": 0.3},  # spot_f exp(-((q - spot_q) / spot_w)^2) sgn v
    "gain_falls_with_speed": {"fall": 0.0},  # tau (1 - fall |v|)
}
OUTSIDE_LIBRARY = ("cubic_damping", "knocks", "random_walk_torque", "friction_spot", "gain_falls_with_speed")
LIBRARY = tuple(effect for effect in EFFECTS if effect not in OUTSIDE_LIBRARY)
_TRANSMISSION = frozenset({"backlash", "joint_flexibility"})
# pairs that no data distinguish, or that no plant has
INSEPARABLE = {
    frozenset({"torque_offset", "coulomb_asymmetry"}),
    *(frozenset({id, other}) for id in _TRANSMISSION for other in LIBRARY),
}
_STIFF = frozenset({"presliding", "hard_stop"})
_NEUTRAL = {name: value for parameters in EFFECTS.values() for name, value in parameters.items()}


@dataclass(frozen=True)
class Plant:
    """Pendulum: base parameters and, by effect, parameters of `EFFECTS` (others have neutral values)."""

    inertia: float = 0.09  # kg m^2, motor and link together
    gravity: float = 2.0  # N m
    viscous: float = 0.35  # N m s/rad
    coulomb: float = 0.8  # N m
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    friction_side: str = "motor"  # where friction acts with backlash or flexibility: motor or link
    encoder_side: str = "motor"  # body of the encoder with backlash or flexibility: motor or link

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
        """Return every parameter of the simulation by name, neutral where the plant lacks the effect."""
        base = {name: getattr(self, name) for name in ("inertia", "gravity", "viscous", "coulomb")}
        return base | _NEUTRAL | {name: value for chosen in self.effects.values() for name, value in chosen.items()}


@dataclass(frozen=True)
class Experiment:
    """Excitation and measurement of a plant. Time-varying effects restart with each recording."""

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
    noise_in_plant: bool = False  # whether the torque noise acts on the plant
    gains: tuple[float, float] = (12.0, 1.2)  # N m/rad, N m s/rad of the closed loop
    torque_limit: float = 8.0  # N m of the closed loop
    control: str = "pd"  # of the closed loop: pd, by the error's rate; servo, by the joint's speed; or speed, with PI
    goal_hold: int = 1  # number of samples between changes of the closed loop's reference

    def __post_init__(self) -> None:
        _require(self.excitation, (*OPEN_LOOP, *CLOSED_LOOP), "excitation")

    @property
    def samples(self) -> int:
        return round(self.rate * self.seconds)


@dataclass(frozen=True)
class SimulatedRecording:
    """Recording with its true motion and plant."""

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
        """Return the hidden effects in the layout of truth.json."""
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
    """Raise ValueError for an unknown name, with the nearest and all known names."""
    known = list(known)
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ValueError(f"unknown {what} '{name}': {hint}Known: {', '.join(known)}")


# ---------------------------------------------------------------------------------------------------------- physics

_DERIVED = ("two_masses", "motor_friction", "motor_encoder", "dead_steps", "payload_step")  # three switches, two counts
_PARAMETERS = np.dtype([(name, float) for name in ("inertia", "gravity", "viscous", "coulomb", *_NEUTRAL, *_DERIVED)])

_Function = TypeVar("_Function", bound=Callable[..., Any])
# angle and speed of the link, the same of the motor (equal where they are one), lagged torque, bristle torque
State = tuple[float, float, float, float, float, float]


def _compiled(function: _Function) -> _Function:
    """Compile a function of numbers, arrays and records by Numba, with a cache on disk."""
    return numba.njit(cache=True, error_model="numpy")(function)  # type: ignore[no-any-return]


@_compiled
def _motor_torque(p: Any, command: float, x: State) -> float:
    """Return the motor torque for a (delayed) command."""
    tau = x[4] if p.lag_T > 0 else command
    if p.sat < NEVER:
        if p.sat_law == 0:
            tau = p.sat * np.tanh(tau / p.sat)
        elif p.sat_law == 1:
            tau = min(max(tau, -p.sat), p.sat)
        else:
            tau = tau / np.hypot(1.0, tau / p.sat)
    if p.rip_n:
        tau *= 1 + p.rip_s * np.sin(p.rip_n * x[2]) + p.rip_c * np.cos(p.rip_n * x[2])
    return tau * max(1 - p.fall * abs(x[3]), 0.0)


@_compiled
def _link_load(p: Any, q: float, v: float) -> float:
    """Return the torque of gravity, springs and walls against the motion of the link."""
    load = p.gravity * np.sin(q) + p.tilt_cos * np.cos(q) + p.spring_k * (q - p.spring_q0)
    for side, depth in ((1, q - p.wall_hi), (-1, p.wall_lo - q)):
        if depth > 0:
            load += side * max(p.wall_k * depth * (1 + p.wall_c * side * v) + p.wall_d * side * v, 0.0)
    return load


@_compiled
def _friction(p: Any, time: float, q: float, v: float, tau: float) -> tuple[float, float]:  # fluid, dry
    """Return the fluid friction, and the bound of the dry friction, which is set-valued at rest."""
    fluid = p.viscous * v + p.asym_v * abs(v) + p.drag * v * abs(v) + p.cubic * v**3
    dry = p.coulomb + p.load_mu * abs(tau + p.load_w * np.sin(q)) + p.load_out * abs(np.sin(q))
    if p.strib_d:
        dry += p.strib_d * np.exp(-(abs(v / p.strib_v) ** p.strib_p))
    dry = max(dry + p.pos_s * np.sin(q) + p.pos_c * np.cos(q), 0.0)
    if p.spot_f:
        dry += p.spot_f * np.exp(-(((q - p.spot_q) / p.spot_w) ** 2))
    warm = p.drift_a * np.exp(-time / p.drift_T)
    # asymmetric bounds [-(fc - a), fc + a]: [-fc, fc] shifted by a
    return fluid * (1 + p.drift_b * warm) + p.asym_c * (1 + warm), dry * (1 + warm)


@_compiled
def _balance(p: Any, command: float, push: float, time: float, x: State) -> tuple[float, float, float, float]:
    """Return torque without dry friction, its bound, inertia of the body with friction, and the other body's q''."""
    q, v, angle, speed = x[:4]
    tau = _motor_torque(p, command, x)
    load = _link_load(p, q, v) - p.dist_a * np.sin(p.dist_w * time + p.dist_ph) - push
    fluid, dry = _friction(p, time, angle, speed, tau) if p.motor_friction else _friction(p, time, q, v, tau)
    tau += p.offset + p.cog_s * np.sin(p.cog_n * angle) + p.cog_c * np.cos(p.cog_n * angle)
    if not p.two_masses:
        return tau - load - fluid, dry, p.inertia, 0.0
    twist = angle - q
    stretch = twist - min(max(twist, -p.bl_gap), p.bl_gap)
    coupling = p.bl_k * stretch + p.bl_d * (speed - v) if stretch else 0.0
    if not p.bl_grip and coupling * stretch < 0:
        coupling = 0.0
    load += p.bl_b * v
    if p.motor_friction:
        return tau - coupling - fluid, dry, p.Jm, (coupling - load) / (p.inertia - p.Jm)
    return coupling - load - fluid, dry, p.inertia - p.Jm, (tau - coupling) / p.Jm


@_compiled
def _rubbing(p: Any, x: State) -> float:
    """Return the velocity of the body with friction from a state, or its acceleration from a derivative."""
    return x[3] if p.motor_friction else x[1]


@_compiled
def _stopped(p: Any, x: State) -> State:
    """Return the state with the body with friction at rest."""
    q, v, angle, speed, lagged, bristle = x
    if p.motor_friction or not p.two_masses:
        speed = 0.0
    if not p.motor_friction or not p.two_masses:
        v = 0.0
    return q, v, angle, speed, lagged, bristle


@_compiled
def _rate(p: Any, command: float, push: float, time: float, x: State, direction: float) -> State:
    """Return the derivative of the state for a constant `direction` of sliding (-1, 1, or 0 for stick)."""
    drive, dry, inertia, other = _balance(p, command, push, time, x)
    friction, bristle = direction * dry, 0.0
    if p.dahl_sigma > 0:
        v = _rubbing(p, x)
        room = 1 - np.sign(v) * x[5] / dry
        bristle = p.dahl_sigma * v * np.sign(room) * abs(room) ** p.dahl_n
        friction = x[5] + p.dahl_d * bristle / p.dahl_sigma
    own = (drive - friction) / inertia if direction else 0.0
    lagged = (command - x[4]) / p.lag_T if p.lag_T > 0 else 0.0
    link, motor = own, own
    if p.two_masses:
        link, motor = (other, own) if p.motor_friction else (own, other)
    return x[1], link, x[3], motor, lagged, bristle


@_compiled
def _moved(x: State, rate: State, time: float) -> State:
    """Return x + time rate."""
    return (
        x[0] + time * rate[0],
        x[1] + time * rate[1],
        x[2] + time * rate[2],
        x[3] + time * rate[3],
        x[4] + time * rate[4],
        x[5] + time * rate[5],
    )


@_compiled
def _runge_kutta(p: Any, command: float, push: float, time: float, step: float, x: State, direction: float) -> State:
    """Return the state after one classical fourth-order step without a change of direction."""
    k1 = _rate(p, command, push, time, x, direction)
    k2 = _rate(p, command, push, time + step / 2, _moved(x, k1, step / 2), direction)
    k3 = _rate(p, command, push, time + step / 2, _moved(x, k2, step / 2), direction)
    k4 = _rate(p, command, push, time + step, _moved(x, k3, step), direction)
    mean = _moved(_moved(k1, k4, 1.0), _moved(k2, k3, 1.0), 2.0)  # six times
    return _moved(x, mean, step / 6)


@_compiled
def _direction_from_rest(drive: float, dry: float) -> float:
    """Return the direction in which a joint at rest starts to slide; 0 if dry friction holds it."""
    return np.sign(drive) if abs(drive) > dry else 0.0


@_compiled
def _first_zero(before: float, rate: float, after: float) -> float:
    """Return the share of a step at which the parabola through both velocities and the rate first changes sign."""
    if before == 0:
        return 0.0
    curve = after - before - rate
    root = np.sqrt(max(rate**2 - 4 * curve * before, 0.0))
    r = -0.5 * (rate - root if rate < 0 else rate + root)
    one, two = r / curve, before / r
    return min(max(one if 0 < one <= 1 else two, 0.0), 1.0)


@_compiled
def _finish(
    p: Any, command: float, push: float, time: float, step: float, x: State, direction: float
) -> tuple[State, float]:
    """Return state and direction after the remaining step; a second change of direction ends in stick."""
    after = _runge_kutta(p, command, push, time, step, x, direction)
    if direction * _rubbing(p, after) < 0:
        return _stopped(p, after), 0.0
    return after, direction


@_compiled
def _step(
    p: Any, command: float, push: float, time: float, step: float, x: State, direction: float
) -> tuple[State, float]:
    """Return state and direction after one inner step, which is cut where sliding ends or begins."""
    after = _runge_kutta(p, command, push, time, step, x, direction)
    before, then = _rubbing(p, x), _rubbing(p, after)
    if direction * then < 0 and p.dahl_sigma == 0:  # friction with a state is smooth through zero
        rate = _rate(p, command, push, time, x, direction)
        part = step * _first_zero(before, step * _rubbing(p, rate), then)
        stop = _stopped(p, _runge_kutta(p, command, push, time, part, x, direction))
        drive, dry = _balance(p, command, push, time + part, stop)[:2]
        onward = _direction_from_rest(drive, dry) if before else 0.0  # a joint that slid for less than a step sticks
        return _finish(p, command, push, time + part, step - part, stop, onward)
    if direction == 0:
        drive, dry = _balance(p, command, push, time + step, after)[:2]
        if abs(drive) > dry:
            held, bound = _balance(p, command, push, time, x)[:2]
            inside, beyond = bound - abs(held), abs(drive) - dry  # distances to slipping
            part = step * inside / (inside + beyond)
            slip = _runge_kutta(p, command, push, time, part, x, direction)
            return _finish(p, command, push, time + part, step - part, slip, np.sign(drive))
    return after, direction


# ------------------------------------------------------------------------------------------------- command and sensors

_CONTROLS = ("pd", "servo", "speed")
_SERVO, _SPEED = _CONTROLS.index("servo"), _CONTROLS.index("speed")
_LOOP = np.dtype([(name, float) for name in ("closed", "control", "stiffness", "damping", "limit", "smoothing")])
_SENSORS = np.dtype([(name, float) for name in ("rate", "step", "every", "count", "shift", "felt")])
_NOW = np.dtype([("x", float, 6), *((name, float) for name in ("direction", "speed", "integral"))])
_SAMPLE = np.dtype(
    [(name, float) for name in ("command", "torque_noise", "position_noise", "reference", "goal", "position")]
    + [(name, float) for name in ("angle", "rate", "rate_change", "sliding")]  # of the body with the encoder
)


@_compiled
def _read(p: Any, sensors: Any, angle: float, noise: float) -> float:
    """Return the reading of the encoder at an angle."""
    seen = angle + p.ecc_e * np.sin(angle + p.ecc_ph) + noise
    if sensors.count == 0:
        return seen
    return np.floor(seen / sensors.count + sensors.shift) * sensors.count


@_compiled
def _controlled(loop: Any, rate: float, now: Any, sample: Any, before: Any) -> float:
    """Return the torque command of a closed loop at a sample."""
    now.speed += loop.smoothing * ((sample.position - before.position) * rate - now.speed)
    error = sample.reference - sample.position
    if loop.control == _SPEED:
        slow = sample.goal - now.speed
        torque = loop.stiffness * slow + loop.damping * now.integral
        if abs(torque) <= loop.limit or torque * slow <= 0:
            now.integral += slow / rate
    elif loop.control == _SERVO:
        torque = loop.stiffness * error - loop.damping * now.speed
    else:
        torque = loop.stiffness * error
        torque += loop.damping * ((sample.reference - before.reference) * rate - now.speed)
    return min(max(torque, -loop.limit), loop.limit)


@_compiled
def _advance(p: Any, loop: Any, sensors: Any, now: Any, samples: Any, pushes: Array) -> None:
    """Simulate all samples: store the motion, compute the command of a closed loop, and take the inner steps."""
    seen, every = 2 * int(p.motor_encoder), int(sensors.every)
    direction = now.direction
    x = (now.x[0], now.x[1], now.x[2], now.x[3], now.x[4], now.x[5])
    for k in range(len(samples)):
        sample = samples[k]
        sample.angle, sample.rate = x[seen], x[seen + 1]
        sample.position = _read(p, sensors, sample.angle, sample.position_noise)
        if loop.closed:
            sample.command = _controlled(loop, sensors.rate, now, sample, samples[max(k - 1, 0)])
        for i in range(k * every, (k + 1) * every):
            time = i * sensors.step
            if i == p.payload_step:
                p.inertia += p.pay_I
                p.gravity += p.pay_mgl
            push = pushes[int(time * PUSH_RATE + 1e-6)] if len(pushes) else 0.0
            asked = int(np.floor((i - p.dead_steps) / every))
            command = samples[asked].command + sensors.felt * samples[asked].torque_noise if asked >= 0 else 0.0
            if direction == 0:
                drive, dry = _balance(p, command, push, time, x)[:2]
                direction = _direction_from_rest(drive, dry)
            if i == k * every:  # depends on the command
                sample.rate_change = _rate(p, command, push, time, x, direction)[seen + 1]
                sample.sliding = abs(direction)
            x, direction = _step(p, command, push, time, sensors.step, x, direction)


def _record(kind: np.dtype[Any], values: dict[str, Any]) -> Any:
    """Make a record of numbers by name for compiled functions."""
    record = np.recarray(1, kind)[0]
    for name in kind.names or ():
        record[name] = values[name]
    return record


class _Run:
    """Simulation of a plant in an experiment.

    Args:
        command: torque (N,) [N m] that replaces the excitation; None: excitation.
        goal: reference (N,) [rad] that replaces the one of a closed loop; None: excitation.
    """

    def __init__(
        self, plant: Plant, experiment: Experiment, command: Array | None = None, goal: Array | None = None
    ) -> None:
        self.plant, self.experiment = plant, experiment
        every, rate, excitation = _inner_steps(plant, experiment), experiment.rate, experiment.excitation
        step, two_masses, values = 1 / (rate * every), bool(_TRANSMISSION & plant.effects.keys()), plant.parameters
        closed = command is None and excitation in CLOSED_LOOP
        self.p = _record(
            _PARAMETERS,
            values
            | {"two_masses": two_masses, "dead_steps": round(values["dead_n"] * every)}
            | {"motor_friction": two_masses and plant.friction_side == "motor"}
            | {"motor_encoder": two_masses and plant.encoder_side == "motor"}
            | {"payload_step": round(values["pay_t"] / step)},
        )
        stiffness, damping = experiment.gains
        self.loop = _record(
            _LOOP,
            {"closed": closed, "control": _CONTROLS.index(experiment.control), "limit": experiment.torque_limit}
            | {"stiffness": stiffness, "damping": damping, "smoothing": 1 - np.exp(-2 * np.pi * 30 / rate)},  # 30 Hz
        )
        self.sensors = _record(
            _SENSORS,
            {"rate": rate, "step": step, "every": every, "count": 2 * np.pi / (experiment.counts or np.inf)}
            | {"shift": 0.0 if experiment.truncate else 0.5, "felt": experiment.noise_in_plant},
        )
        angle, speed = experiment.start
        direction = 1.0 if values["dahl_sigma"] > 0 else np.sign(speed)  # friction with a state never sticks
        start = (angle, speed, angle, speed, 0.0, 0.0)
        self.now = _record(_NOW, {"x": start, "direction": direction, "speed": 0.0, "integral": 0.0})

        n = experiment.samples
        self.time = time = np.arange(n) / rate
        rng, noise = (np.random.default_rng([experiment.seed, stream]) for stream in (0, 1))
        self.samples = np.zeros(n, _SAMPLE).view(np.recarray)
        if closed:
            reference = CLOSED_LOOP[excitation](rng, time, experiment.scale) if goal is None else goal
            self.samples.reference = reference = reference[np.arange(n) // experiment.goal_hold * experiment.goal_hold]
            self.samples.goal = np.gradient(reference) * rate if experiment.control == "speed" else reference
        else:
            self.samples.command = OPEN_LOOP[excitation](rng, time, experiment.scale) if command is None else command
        self.samples.torque_noise = experiment.torque_noise * noise.standard_normal(n)
        self.samples.position_noise = experiment.position_noise * noise.standard_normal(n)
        self.pushes = _pushes(plant, experiment)

    def advance(self) -> None:
        """Simulate all samples."""
        _advance(self.p, self.loop, self.sensors, self.now, self.samples, self.pushes)

    def recording(self) -> SimulatedRecording:
        """Return the recording with its truth."""
        s, experiment = self.samples, self.experiment
        q, v, e, phase = s.angle, s.rate, self.p.ecc_e, self.p.ecc_ph
        exact, turned = q + e * np.sin(q + phase), 1 + e * np.cos(q + phase)
        acceleration = s.rate_change * turned - e * v**2 * np.sin(q + phase)
        torque = s.command + s.torque_noise
        if experiment.torque_step:
            torque = np.round(torque / experiment.torque_step) * experiment.torque_step
        return SimulatedRecording(
            self.plant,
            experiment,
            self.time,
            s.position.copy(),
            torque,
            s.command.copy(),
            exact,
            v * turned,
            acceleration,
            s.sliding > 0,
            s.goal.copy(),
        )


def _pushes(plant: Plant, experiment: Experiment) -> Array:
    """Return the random disturbance torque at PUSH_RATE [N m], knocks and random walk; empty without them."""
    p = plant.parameters
    if not (p["knock_rate"] or p["walk_rms"]):
        return np.zeros(0)
    n = round(experiment.seconds * PUSH_RATE) + 1
    rng, push = np.random.default_rng([experiment.seed, 2]), np.zeros(n)
    if p["knock_rate"]:
        pulse = np.sin(np.pi * (np.arange(round(p["knock_width"] * PUSH_RATE)) + 0.5) / (p["knock_width"] * PUSH_RATE))
        for begin in rng.uniform(0, experiment.seconds, rng.poisson(p["knock_rate"] * experiment.seconds)):
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
    """Return the inner steps per sample."""
    longest = STIFF_STEP if _STIFF & plant.effects.keys() else MAX_STEP
    longest = CONTACT_STEP if _TRANSMISSION & plant.effects.keys() else longest
    return max(1, int(np.ceil(1 / (experiment.rate * longest) - 1e-9)))


def simulate(
    cases: Sequence[tuple[Plant, Experiment]],
    commands: Sequence[Array | None] | None = None,
    goals: Sequence[Array | None] | None = None,
) -> list[SimulatedRecording]:
    """Simulate every (plant, experiment) and return the recordings in the same order.

    Args:
        commands: a torque command (N,) [N m] per case, replacing its excitation where not None.
        goals: a reference (N,) [rad] per case, replacing that of its closed loop where not None.
    """
    done, none = [], [None] * len(cases)
    for (plant, experiment), command, goal in zip(cases, commands or none, goals or none, strict=True):
        run = _Run(plant, experiment, command, goal)
        run.advance()
        done.append(run.recording())
    return done


@dataclass(frozen=True)
class EffectShare:
    """RMS residual of the base model in motion, relative to the RMS torque."""

    with_true_parameters: float  # share of the hidden effect
    after_refit: float  # share of the residual after a refit of the four base parameters


def effect_share(recording: SimulatedRecording, slowest: float = 0.02) -> EffectShare:
    """Return the share of the hidden effect in the torque, on exact motion faster than `slowest` [rad/s].

    The commanded torque is compared with I q'' + mgl sin q + b q' + fc sgn q' of the body with the encoder. Without
    effects, both shares are zero up to rounding.
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
    """Random plant with one experiment to fit and one held out."""

    plant: Plant
    train: Experiment
    holdout: Experiment


def _around(rng: np.random.Generator, value: float) -> float:
    """Draw from half to twice the value, uniformly in the logarithm."""
    return float(value * 2 ** rng.uniform(-1, 1))


def _random_effect(
    rng: np.random.Generator, effect: str, base: dict[str, float], experiment: Experiment, variants: bool
) -> dict[str, float]:
    """Draw the parameters of one effect: half to twice a typical size, with random sign and phase where possible."""
    sign, angle = float(rng.choice([-1, 1])), rng.uniform(0, 2 * np.pi)
    either = bool(rng.integers(2)) and variants  # whether to use the variant of the law

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
    """Draw a random plant with the given hidden effects and two experiments on it that differ in their seed.

    Args:
        wide: whether base parameters are half to twice the default ranges.
        variants: whether laws may differ from the library's (Stribeck without the square, clipped torque, ...).
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
    # The torque grows with gravity and friction: heavy pendulums swing, too.
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
    with path.open("wb") as file, gzip.GzipFile("", "wb", 6, file, mtime=0) as packed:  # mtime=0: reproducible bytes
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
    seed: int,
    n: int = 60,
    nulls: int = 10,
    pairs: int = 8,
    outside: int = 0,
    misfits: int = 0,
    **options: Any,
) -> list[Case]:
    """Return `n` random cases: without effects, with pairs, with effects outside the library, and with single effects.

    Misfits have an effect of the library and one that it lacks. Draws are keyed by effect: see `benchmarks.draws`.
    """
    alone = n - nulls - pairs - outside - misfits
    if alone < 0:
        raise ValueError(f"n = {n} is less than nulls + pairs + outside + misfits = {n - alone}: raise n")
    lacking = [OUTSIDE_LIBRARY[j % len(OUTSIDE_LIBRARY)] for j in range(max(outside, misfits))]
    own = [str(id) for (id,) in shuffle_keys(seed, ((id,) for id in LIBRARY))]
    hidden: list[tuple[str, ...]] = [()] * nulls + choose_pairs(seed, LIBRARY, INSEPARABLE)[:pairs]
    hidden += [(id,) for id in lacking[:outside]]
    hidden += [(own[j % len(own)], id) for j, id in enumerate(lacking[:misfits])]
    hidden += [(LIBRARY[j % len(LIBRARY)],) for j in range(alone)]
    counted = [(hidden[:j].count(effects), *effects) for j, effects in enumerate(hidden)]
    cases = []
    for key in shuffle_keys(seed, counted):
        rng = make_generator(seed, *key)
        sensors = {
            "rate": float(rng.choice([200, 500, 1000, 2000], p=[0.2, 0.2, 0.4, 0.2])),
            "counts": int(rng.choice([8192, 65536, 1_024_000], p=[0.25, 0.25, 0.5])),
            "torque_noise": float(rng.choice([0.02, 0.05, 0.1], p=[0.6, 0.2, 0.2])),
        }
        cases.append(random_case(rng, [str(id) for id in key[1:]], **(sensors | options)))
    return cases
