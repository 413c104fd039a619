"""Recordings whose truth is known, from a simulator that shares no model code, and their diagnoses, made once."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import cos, sin
from typing import Any

import numpy as np

from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, simulate
from estimators import Diagnosis, diagnose
from pendulum_env.physics import BASE, Model
from pendulum_env.recording import Recording
from tests import slow
from tests.once import once

PLANT = Plant()  # inertia 0.09, gravity 2, viscous 0.35, coulomb 0.8
THETA = {"inertia": 0.09, "gravity": 2.0, "viscous": 0.35, "coulomb": 0.8}
TRUTH = np.array(list(THETA.values()))


def make_recording(run: SimulatedRecording, name: str = "run") -> Recording:
    """What a user has of a simulated run."""
    return Recording(run.time, run.position, run.torque, name=name)


def recorded(
    plant: Plant, *experiments: Experiment, commands: Sequence[np.ndarray | None] | None = None
) -> list[Recording]:
    """Recordings of a plant, one of each experiment; a command [N m] takes the place of its excitation."""
    runs = simulate([(plant, experiment) for experiment in experiments], commands)
    return [make_recording(run, f"run {k}") for k, run in enumerate(runs, 1)]


@dataclass(frozen=True)
class Case:
    """A hidden effect in the plant's words, its parameters in the library's, and what else may be said of it."""

    hidden: dict[str, dict[str, float]] = field(default_factory=dict)
    found: dict[str, float] = field(default_factory=dict)
    experiment: Experiment = field(default_factory=Experiment)
    plant: Plant = PLANT
    command: np.ndarray | None = None  # [N m], in place of the excitation


def run(seed: int, seconds: float = 9.0, rate: float = 500.0, **experiment: object) -> Experiment:
    return Experiment(seed=seed, seconds=seconds, rate=rate, **experiment)  # type: ignore[arg-type]


NULLS = {
    "paper's encoder": Case(experiment=run(1, 8.0, 1000.0)),
    "200 Hz": Case(experiment=run(2, 12.0, 200.0, counts=65_536)),
    "coarse and noisy": Case(experiment=run(3, counts=8192, torque_noise=0.1)),
    "filtered noise": Case(experiment=run(4, excitation="filtered_noise"), plant=Plant(0.06, 2.5, 0.45, 0.5)),
    "steps": Case(experiment=run(5, excitation="steps"), plant=Plant(0.12, 1.2, 0.2, 1.0)),
    "weak": Case(experiment=run(6, 12.0, scale=0.6)),
    "exact": Case(experiment=run(7, counts=None, torque_noise=0.0)),
    "position control": Case(experiment=run(8, 12.0, 200.0, excitation="pd_loop", counts=65_536)),
}
COGS = {"cog_n": 9, "cog_s": 0.15, "cog_c": -0.1}
PICKED_UP = {"pay_t": 4.0, "pay_I": 0.02, "pay_mgl": 0.4}
BUMPERS = {"wall_lo": -1.1, "wall_hi": 0.9, "wall_k": 40.0, "wall_c": 0.05}
TOLD = {  # an experiment, a hidden effect in the plant's words, and in the library's
    "stribeck": (run(11), {"strib_d": 0.45, "strib_v": 0.6}, {"": 0.45, "stribeck_velocity": 0.6}),
    "quadratic_drag": (run(12), {"drag": 0.04}, {"": 0.04}),
    "load_dependent_friction": (run(13), {"load_mu": 0.1}, {"": 0.1}),
    "cogging": (run(14, counts=65_536), COGS, {"sin": -0.15, "cos": 0.1, "order": 9}),
    "payload_change": (run(15), PICKED_UP, {"inertia": 0.02, "gravity": 0.4, "moment": 4.0}),
    "friction_drift": (run(16), {"drift_a": 0.6, "drift_T": 3.0}, {"viscous": 0.21, "coulomb": 0.48, "warm_up": 3.0}),
    "actuator_lag": (run(17), {"lag_T": 0.015}, {"time_constant": 0.015}),
    "dead_time": (run(18), {"dead_n": 4}, {"dead_time": 0.008}),
    "presliding": (run(19), {"dahl_sigma": 30.0}, {"": 0.8, "displacement": 0.8 / 30}),
    "encoder_eccentricity": (run(20), {"ecc_e": 0.03, "ecc_ph": 0.7}, {"sin": 0.03 * cos(0.7), "cos": 0.03 * sin(0.7)}),
    "torque_saturation": (run(21), {"sat": 7.0}, {"limit": 7.0}),
    "gravity_tilt": (run(23), {"tilt_cos": 0.25}, {"": 0.25}),
    "spring": (run(24), {"spring_k": 0.3, "spring_q0": 0.4}, {"stiffness": 0.3, "preload": -0.12}),
    "viscous_asymmetry": (run(25), {"asym_v": 0.1}, {"": 0.1}),
    "position_dependent_friction": (run(26), {"pos_s": 0.25, "pos_c": -0.2}, {"sin": 0.25, "cos": -0.2}),
    "torque_ripple": (run(27), {"rip_n": 6, "rip_s": 0.08, "rip_c": -0.05}, {"sin": -0.08, "cos": 0.05, "order": 6}),
    "periodic_disturbance": (run(28), {"dist_a": 0.25, "dist_w": 19.0}, {"sin": -0.25, "frequency": 19.0}),
    "hard_stop": (run(22), BUMPERS, {"stiffness": 40.0, "lower": -1.1, "upper": 0.9, "hysteresis": 0.05}),
}
SINGLES = {
    id: Case({id: hidden}, {f"{id}.{name}".rstrip("."): value for name, value in found.items()}, experiment)
    for id, (experiment, hidden, found) in TOLD.items()
}
TRANSMISSIONS = {
    "joint_flexibility": Case({"joint_flexibility": {"Jm": 0.03, "bl_k": 22.0, "bl_d": 0.05}}, experiment=run(29)),
    "backlash": Case({"backlash": {"Jm": 0.02, "bl_gap": 0.03, "bl_k": 400.0, "bl_d": 0.8}}, experiment=run(30)),
}
TWINS = {  # no data tell these two apart
    "torque_offset": Case({"torque_offset": {"offset": 0.2}}, experiment=run(31)),
    "coulomb_asymmetry": Case({"coulomb_asymmetry": {"asym_c": 0.2}}, experiment=run(32)),
}
PAIR = {
    "stribeck and tilt": Case(
        {"stribeck": {"strib_d": 0.45, "strib_v": 0.6}, "gravity_tilt": {"tilt_cos": 0.25}},
        {"stribeck": 0.45, "gravity_tilt": 0.25},
        run(33),
    )
}
SHORT = {"short lag": Case({"actuator_lag": {"lag_T": 0.002}}, experiment=run(36))}
OUTSIDE = {
    "knocks": Case({"knocks": {"knock_rate": 2.0, "knock_height": 1.5, "knock_width": 0.04}}, experiment=run(34)),
    "cubic_damping": Case({"cubic_damping": {"cubic": 0.01}}, experiment=run(35)),
}


def draw_jumps() -> np.ndarray:
    """A random binary command beside a slow one, 12 s at 250 Hz; its differences dwarf the noise of 0.02 N m."""
    return 3 * np.sin(9 * np.arange(3000) / 250) + np.random.default_rng(5).choice([-2.0, 2.0], 3000)


def draw_random_torque() -> np.ndarray:
    """The first thing that an agent does: a new torque every millisecond, for 8 s, which hardly moves the arm."""
    return np.random.default_rng(0).uniform(-15.0, 15.0, 8000)


def make_swing_torque() -> np.ndarray:
    """Two tones, 12 s at 500 Hz, that a pendulum follows at up to 10 rad/s."""
    time = np.arange(6000) / 500
    return 5 * np.sin(4 * time) + 2 * np.sin(11 * time)


def make_creep_torque() -> np.ndarray:
    """Two tones that hardly overcome friction, 16 s at 500 Hz."""
    time = np.arange(8000) / 500
    return 0.85 * (np.sin(12.07 * time) + np.sin(2.25 * time))


def draw_two_levels() -> np.ndarray:
    """A torque of one size, forwards or backwards for 0.2 s, 12 s at 1 kHz."""
    return 3.5 * np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 60), 200)


ONE_STOP = {"wall_k": 60.0, "wall_d": 0.3}
JUMPY = run(9, 12.0, 250.0, counts=None)
SPRING = {"spring": {"spring_k": 0.4, "spring_q0": 0.5}}
DRAG_AND_TILT = {"quadratic_drag": {"drag": 0.05}, "gravity_tilt": {"tilt_cos": 0.3}}
BLOW = np.where(np.arange(6000) // 5 == 526, -185.0, 0.0)  # [N m] for 10 ms, once, as it moves at 10 rad/s
BRISTLES = Plant(0.063, 2.43, 0.458, 1.055, {"presliding": {"dahl_sigma": 79.4}})
GEARS = {"load_dependent_friction": {"load_mu": 0.1, "load_out": 0.2}, "stribeck": {"strib_d": 0.4, "strib_v": 0.6}}
CREEPING = Plant(0.09, 2.0, 0.36, 0.92, {"spring": {"spring_k": 0.3, "spring_q0": 0.3}})
OF_THE_PAPER = Plant(0.0895, 2.01, 0.3638, 0.9163)
WALLS = (-4.17, 5.0)  # [rad]
STOPS = {"wall_lo": WALLS[0], "wall_hi": WALLS[1], "wall_k": 230.0, "wall_d": 2.1}
SPECIAL = {  # of one test each
    "jumpy": Case(experiment=JUMPY, command=draw_jumps()),
    "jumpy, drag and tilt": Case(DRAG_AND_TILT, experiment=JUMPY, command=draw_jumps()),
    "lower stop": Case({"hard_stop": {"wall_lo": -0.9, **ONE_STOP}}, experiment=run(70, 12.0)),
    "random": Case(experiment=run(0, 8.0, 1000.0), command=draw_random_torque()),
    "scale 0.7": Case(SPRING, experiment=run(50, 12.0, excitation="multisine", scale=0.7)),
    "scale 0.35": Case(SPRING, experiment=run(50, 12.0, excitation="multisine", scale=0.35)),
    "wide": Case(SPRING, experiment=run(51, 9.0, scale=0.8)),
    "struck": Case(experiment=run(71, 12.0), command=make_swing_torque() + BLOW),
    **{f"bristles {seed}": Case(plant=BRISTLES, experiment=run(seed, 10.0, 1000.0, counts=65_536)) for seed in (1, 2)},
    **{f"gears {seed}": Case(GEARS, experiment=run(seed, 9.0, 200.0, excitation="pd_loop")) for seed in (41, 42, 43)},
    "creep": Case(plant=CREEPING, experiment=run(3, 16.0), command=make_creep_torque()),
    "two levels": Case(
        experiment=run(0, 12.0, 1000.0, torque_noise=0.02), plant=OF_THE_PAPER, command=draw_two_levels()
    ),
    "short": Case(experiment=run(31, 0.5, 250.0)),
    "brief": Case(experiment=run(31, 3.0, 250.0)),
    "bouncing": Case(
        plant=Plant(0.03, 2.25, 0.0136, 0.05, {"hard_stop": STOPS}),
        experiment=run(1, 15.0, excitation="steps", counts=16_384, torque_noise=0.03),
    ),
    "moving": Case(experiment=run(31, 12.0, 500.0)),
}
CASES = NULLS | SINGLES | TRANSMISSIONS | TWINS | PAIR | SHORT | OUTSIDE | SPECIAL

QUICK_NULLS = ("paper's encoder", "steps", "position control")
QUICK_SINGLES = ("stribeck", "cogging", "payload_change", "actuator_lag")
NULLS_TRIED, SINGLES_TRIED = slow.but(QUICK_NULLS, NULLS), slow.but(QUICK_SINGLES, SINGLES)


@functools.cache
def recording(name: str) -> Recording:
    """The recording of a case."""
    case = CASES[name]
    plant = replace(case.plant, effects=case.plant.effects | case.hidden)
    return replace(recorded(plant, case.experiment, commands=[case.command])[0], name=name)


Some = str | Recording | Sequence[str | Recording]


def diagnosed(train: Some, holdout: Some = (), **options: Any) -> Diagnosis:
    """What `diagnose` says of recordings, or of cases of the catalogue, with the effects of the library; made once."""
    return _diagnosed(_list_recordings(train), _list_recordings(holdout), **options)


@once("pendulum_env", "estimators")
def _diagnosed(train: list[Recording], holdout: list[Recording], **options: Any) -> Diagnosis:
    return diagnose(train, holdout, **options)


def _list_recordings(some: Some) -> list[Recording]:
    several = [some] if isinstance(some, str | Recording) else some
    return [recording(one) if isinstance(one, str) else one for one in several]


def make_plain_model() -> Model:
    """The plant of the catalogue, with nothing hidden."""
    return Model.build(BASE, TRUTH)
