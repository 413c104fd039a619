"""Diagnoses of servos: torque constants from known loads, and effects in closed loops.

    python -m benchmarks.servos benches --n 40       # friction-dominated, back-driven, with and without load friction
    python -m benchmarks.servos loops --n 30         # position and speed loops, most without effect or with cogging
    python -m benchmarks.servos goals --n 50         # known controllers; logs of goals and positions only

A bench logs the voltage of a position loop at 100 Hz and an encoder of 12 bits, as hobby servos do. Each load is a
separate plant of the simulator, which shares no code with the packages under test.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np

from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, simulate
from estimators import diagnose
from pendulum_env.recording import Load, Recording
from robots.servos import ServoDrive

Draw = np.random.Generator
CONSTANT = "torque constant"
GRAVITY = 9.81  # [m/s^2]
SUPPLY = 12.0  # [V]
FASTEST = 6.0  # largest speed of a speed loop [rad/s]
GAINS = (1.3, 2.6, 5.2)  # share of the supply per radian of error; the last is held out
WEIGHTS = [(mass, length) for length in (0.1, 0.15) for mass in (0.5, 0.75, 1.0, 1.2)]  # [kg], [m]
FRICTION = ("none", "output", "none", "output", "motor")
LOOPS = ("none", "cogging", "none", "cogging", "load_out", "actuator_lag", "torque_saturation")


class Case(NamedTuple):
    """Servo with hidden effects, its experiments, and the conversion of runs to recordings."""

    name: str
    hidden: tuple[str, ...]
    runs: list[tuple[Plant, Experiment]]
    recorded: Callable[[int, SimulatedRecording], Recording]  # from the number of a run, and the run
    held_out: int  # number of held-out runs, the last ones
    truth: dict[str, float]  # parameters with counted intervals


def bench(seed: int) -> Case:
    """Make a bench with eight known loads, three gains and random friction; every fourth is back-driven."""
    rng = np.random.default_rng([seed, 0])
    law, is_back_driven = FRICTION[seed % len(FRICTION)], seed % 4 == 3
    constant, inertia = float(rng.uniform(0.25, 0.6)), float(rng.uniform(0.005, 0.02))
    fluid = rng.uniform(0.3, 0.75) * (0.15 if is_back_driven else 1.0)  # back-EMF included
    coulomb, own = rng.uniform(0.08, 0.3) * (0.3 if is_back_driven else 1.0), rng.choice([0.0, rng.uniform(0.05, 0.3)])
    share = {"none": 0.0, "output": rng.uniform(0.15, 0.4), "motor": rng.uniform(0.05, 0.15)}[law]
    stribeck = {"strib_d": rng.uniform(0.0, 0.04), "strib_v": 0.3}
    cases = []
    for number, (gain, (mass, length)) in enumerate((gain, weight) for gain in GAINS for weight in WEIGHTS):
        gravity = own + GRAVITY * mass * length
        pressed = {"load_out": share * gravity} if law == "output" else {"load_mu": share}
        plant = Plant(
            inertia + mass * length**2,
            gravity,
            fluid,
            coulomb,
            {"stribeck": stribeck} | ({"load_dependent_friction": pressed} if share else {}),
        )
        experiment = Experiment(
            100.0,
            6.0,
            "pd_loop",
            float(rng.uniform(0.4, 0.8)),
            1000 * seed + number,
            counts=4096,
            torque_noise=0.002,
            gains=(gain * SUPPLY * constant, 0.0),
            torque_limit=SUPPLY * constant,
        )
        cases.append((plant, experiment))

    def recorded(number: int, run: SimulatedRecording, constant: float = constant) -> Recording:
        mass, length = WEIGHTS[number % len(WEIGHTS)]
        load = Load(mass * length**2, GRAVITY * mass * length)
        return Recording(run.time, run.position, run.torque / constant, load=load, torque_unit="V", name=f"{number}")

    is_told = law == "output" or (law == "motor" and is_back_driven)  # else the constant includes the motor's share
    hidden = ("load_dependent_friction",) if is_told else ()
    if law == "motor" and not is_back_driven:
        constant *= 1.0 - share  # not separable if the motor always drives
    name = f"{law}{' back-driven' if is_back_driven else ''}"
    return Case(name, hidden, cases, recorded, len(WEIGHTS), {CONSTANT: constant})


def loop(seed: int) -> Case:
    """Make a joint with large friction and a random effect in a position or speed loop."""
    rng = np.random.default_rng([seed, 2])
    hidden, kind = LOOPS[seed % len(LOOPS)], ("pd_loop", "speed_loop")[seed // len(LOOPS) % 2]
    gravity = float(rng.uniform(0.5, 2.0)) if kind == "pd_loop" or hidden == "load_out" else 0.0
    inertia, coulomb = float(rng.uniform(0.01, 0.05)), float(rng.uniform(0.2, 0.8))
    effects = {
        "none": {},
        "cogging": {"cogging": {"cog_n": float(rng.integers(6, 40)), "cog_s": float(rng.uniform(0.1, 0.3))}},
        "load_out": {"load_dependent_friction": {"load_out": float(rng.uniform(0.2, 0.4)) * gravity}},
        "actuator_lag": {"actuator_lag": {"lag_T": float(rng.uniform(0.01, 0.03))}},
        "torque_saturation": {"torque_saturation": {"sat": float(rng.uniform(1.2, 1.6))}},
    }[hidden]
    viscous = float(rng.uniform(0.02, 0.2))
    working = gravity + coulomb
    if hidden == "torque_saturation":  # a drive that cannot follow is always saturated, and shows no law
        working += FASTEST * viscous if kind == "speed_loop" else 0.0
        effects[hidden]["sat"] *= working
    plant = Plant(inertia, gravity, viscous, coulomb, effects)
    stiff = float(rng.uniform(15.0, 40.0))
    settings = dict(
        rate=500.0,
        seconds=20.0,
        excitation=kind,
        counts=16_384,
        torque_noise=0.005,
        gains=(stiff, stiff * float(rng.uniform(0.03, 0.1))),
        torque_limit=4 * working,
    )
    cases = [(plant, Experiment(seed=10 * seed + k, **settings)) for k in range(2)]
    named = {"none": (), "load_out": ("load_dependent_friction",)}.get(hidden, (hidden,))
    return Case(f"{hidden} {kind}", named, cases, make_recording, 1, get_counted_parameters(plant))


def get_counted_parameters(plant: Plant) -> dict[str, float]:
    """Return the counted parameters of a plant; parameters of zero have no relative error."""
    return {name: value for name in ("inertia", "gravity") if (value := getattr(plant, name))}


def make_recording(number: int, run: SimulatedRecording) -> Recording:
    """Return the recording of a run with its torque."""
    return Recording(run.time, run.position, run.torque, name=f"{number}")


SHOWN: dict[str, Callable[[Draw, float, float], dict[str, float]]] = {  # by gravity and Coulomb friction [N m]
    "load_dependent_friction": lambda rng, g, c: {"load_out": rng.uniform(0.2, 0.4) * g},
    "stribeck": lambda rng, g, c: {"strib_d": rng.uniform(1.0, 2.0) * c, "strib_v": rng.uniform(0.1, 0.3)},
    "quadratic_drag": lambda rng, g, c: {"drag": rng.uniform(0.05, 0.1) * g},
    "viscous_asymmetry": lambda rng, g, c: {"asym_v": rng.uniform(0.02, 0.03) * g},
    "coulomb_asymmetry": lambda rng, g, c: {"asym_c": rng.uniform(0.4, 0.7) * c},
    "position_dependent_friction": lambda rng, g, c: {"pos_c": rng.uniform(0.5, 0.8) * c},
    "cogging": lambda rng, g, c: {"cog_n": float(rng.integers(5, 14)), "cog_s": rng.uniform(0.15, 0.3) * g},
    "spring": lambda rng, g, c: {"spring_k": rng.uniform(0.3, 0.8) * g},
    "dead_time": lambda rng, g, c: {"dead_n": float(rng.integers(5, 16))},
    "torque_saturation": lambda rng, g, c: {"sat": rng.uniform(0.9, 1.2) * (g + c)},
}
CONTROLS = ("servo", "damped", "speed")


def goal(seed: int) -> Case:
    """Make a servo under a known controller with logged goals and positions; every fifth has no effect."""
    rng = np.random.default_rng([seed, 3])
    hidden = "" if seed % 5 == 4 else list(SHOWN)[(seed - seed // 5) % len(SHOWN)]
    control = CONTROLS[seed % len(CONTROLS)]
    if hidden in ("spring", "stribeck") and control == "speed":
        control = "servo"  # a spring prevents full turns, and Stribeck friction needs slow motion
    gravity, inertia = float(rng.uniform(0.3, 2.0)), float(rng.uniform(0.003, 0.02))
    coulomb, constant = float(rng.uniform(0.05, 0.15)) * gravity, float(rng.uniform(0.2, 0.6))
    effects = {hidden: SHOWN[hidden](rng, gravity, coulomb)} if hidden else {}
    plant = Plant(inertia, gravity, float(rng.uniform(0.03, 0.08)) * gravity, coulomb, effects)
    log, limit = float(rng.choice([100.0, 125.0, 200.0, 250.0])), SUPPLY * constant
    stiff = np.array([2.0, 4.0, 6.0, 8.0]) * gravity
    cases = []
    for k, gain in enumerate(stiff.tolist()):
        gains = {"servo": (gain, 0.0), "damped": (gain, 0.03 * gain), "speed": (0.15 * gain, gain)}[control]
        settings = {"control": "speed" if control == "speed" else "servo", "gains": gains, "torque_limit": limit}
        kind = "speed_loop" if control == "speed" else "pd_loop"
        scale = float(rng.uniform(0.3, 0.6))
        cases.append((plant, Experiment(1000.0, 8.0, kind, scale, 100 * seed + k, counts=4096, **settings)))

    def recorded(number: int, run: SimulatedRecording) -> Recording:
        names = ("kp", "ki") if control == "speed" else ("kp", "kd")
        settings = dict(zip(names, (own / limit for own in run.experiment.gains), strict=True))
        drive = ServoDrive(
            "velocity" if control == "speed" else "position",
            supply=SUPPLY,
            gain=constant,
            rate=1000.0,
            cutoff=30.0,
            **settings,
        )
        each = slice(None, None, round(1000.0 / log))
        time, position, wanted = run.time[each], run.position[each], run.goal[each]
        speed, ones = np.gradient(position, time), np.ones(len(time))
        torque = drive.torque(wanted, position, speed, SUPPLY * ones, ones)
        return Recording(time, position, torque, reference=wanted, drive=drive, name=f"{number}")

    return Case(
        f"{hidden or 'nothing'} {control}",
        (hidden,) if hidden else (),
        cases,
        recorded,
        1,
        get_counted_parameters(plant),
    )


class CaseResult(NamedTuple):
    """Result of one case.

    Attributes:
        line: text of the result.
        is_right: whether exactly the hidden effects are named.
        deviations: estimate minus truth [standard errors] by parameter, without biased ones.
    """

    line: str
    is_right: bool
    deviations: dict[str, float]


def score_case(seed: int, case: Case, recordings: Sequence[Recording]) -> CaseResult:
    """Diagnose the recordings of a case."""
    begin = time.process_time()
    found = diagnose(recordings[: -case.held_out], recordings[-case.held_out :])
    named = [group for group in found.effects if group[0] != "stribeck" or group[0] in case.hidden]
    is_right = len(named) == len(case.hidden) and all(id in group for id, group in zip(case.hidden, named, strict=True))
    parts, deviations = [f"{seed:4d} {case.name:24}"], {}
    for name, truth in case.truth.items():
        own = found.model.torque_constant if name == CONSTANT else found.model.estimates[name]
        if own is None or own.is_biased or not own.std > 0:  # or at its bound
            parts.append(f"no {name}")
            continue
        deviations[name] = (own.value - truth) / own.std
        off, error = 100 * (own.value / truth - 1), 100 * own.std / truth
        parts.append(f"{name} {off:+6.2f} % {deviations[name]:+5.1f} std of {error:.2g} %")
    text = ", ".join("/".join(group) for group in found.effects)
    parts += [text or "nothing", f"+{len(found.unexplained)} regions" if found.unexplained else ""]
    parts += [f"{len(found.disagreements)} disagree" if found.disagreements else ""]
    parts += [f"{time.process_time() - begin:.0f} s", "" if is_right else "WRONG"]
    return CaseResult("  ".join(filter(None, parts)), is_right, deviations)


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line for each case, and totals."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.servos")
    parser.add_argument("what", choices=("benches", "loops", "goals"))
    parser.add_argument("--n", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="seed of the first case")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args(argv)
    make = {"benches": bench, "loops": loop, "goals": goal}[args.what]
    seeds = range(args.first, args.first + args.n)
    cases = [make(seed) for seed in seeds]
    runs = iter(simulate([run for case in cases for run in case.runs]))
    recordings = [[case.recorded(k, next(runs)) for k in range(len(case.runs))] for case in cases]
    with ProcessPoolExecutor(args.workers) as pool:
        results = []
        for result in pool.map(
            score_case, seeds, [case._replace(recorded=make_recording) for case in cases], recordings
        ):
            print(result.line, flush=True)
            results.append(result)
    print(f"named what hides and nothing else: {sum(result.is_right for result in results)} of {args.n}")
    for name in dict.fromkeys(name for case in cases for name in case.truth):
        deviations = [result.deviations[name] for result in results if name in result.deviations]
        held = sum(abs(one) < 1.96 for one in deviations)
        print(f"{name}: told {len(deviations)} times, within its 95 % interval {held}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
