"""Accuracy of arm parameters by motion, at equal limits: python -m benchmarks.arm_excitation two-link | robots FOLDER.

Two-link arms within 30 % of the file are simulated by pymunk, which shares no code with the design of the motions.
The result is the relative error of all parameters, estimated online. Published robots are read from a folder of the
package example-robot-data; their result is the information of the motion.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents import load
from agents.comparison import compute_bootstrap_interval, compute_gain
from estimators.online import OnlineEstimator, stream_recording
from estimators.schemes.six import scheme
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array
from robots.arms import arm_base
from robots.arms.body import Body, parse_body, read_body
from robots.arms.design_env import TORQUE, plan_motion
from robots.arms.env import PlanarArm
from robots.arms.excitation import (
    INFORMATION_PRIOR,
    compute_parameter_scales,
    design_excitation,
    make_information_rows,
)
from robots.arms.following import follow
from robots.arms.limits import find_limits
from robots.arms.planar import TWO_LINK, Link
from robots.arms.reference import TICK, compute_condition_number, make_torque_rows

RATE = 1000.0  # [Hz]
NOISE = 0.1  # of each torque sample [N m], some per cent as from currents
MOMENTS = (2.0, 5.0)  # times of the comparison [s]
SPREAD = 0.3
TRIES = 600
BASE = "fourier, random"
Motion = Callable[[Array], tuple[Array, Array, Array]]
ROBOTS = {
    "UR5": "ur_description/urdf/ur5_robot.urdf",
    "Panda": "panda_description/urdf/panda.urdf",
    "Kinova j2s6": "kinova_description/robots/kinova.urdf",
    "xArm7": "xarm_description/urdf/xarm7.urdf",
    "Unitree Z1": "z1_description/urdf/z1.urdf",
    "SO-101": "so_arm_description/urdf/so101.urdf",
}


@dataclass(frozen=True, eq=False)
class Series:
    """Fourier series of n joints: middle (n,) [rad], sines and cosines (K, n) [rad], and period [s]."""

    body: Body
    middle: Array
    sines: Array
    cosines: Array
    period: float

    def __call__(self, time: Array) -> tuple[Array, Array, Array]:
        """Return the position, velocity and acceleration of the joints (N, n) at N instants [s]."""
        w = 2 * np.pi / self.period * np.arange(1, len(self.sines) + 1)
        s, c = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
        a, b = self.sines, self.cosines
        return self.middle + s @ a + c @ b, (c * w) @ a - (s * w) @ b, -(s * w**2) @ a - (c * w**2) @ b


def torque_of(motion: Any, time: Array) -> Array:
    """Return the torque of the file's body along a motion, without friction (N, n) [N m]."""
    return np.asarray(motion.body.torque(*motion(time)) @ motion.body.values)


def scale_series(body: Body, period: float, waves: Array, share: float = 0.9, **limits: float) -> Series | None:
    """Return a Fourier series about the middle angles, with waves (2, K, n) scaled to a share of the limits.

    Accelerations stay below 25 rad/s^2 for five waves in 5 s at 4 rad/s. Return None if the torque limit is exceeded.
    """
    low, high, speed, torque, _ = find_limits(body, **limits)
    time, middle = np.linspace(0, period, 200, endpoint=False), 0.5 * (low + high)
    q, v, _ = Series(body, 0 * middle, *waves, period)(time)
    scale = share * np.minimum(0.5 * (high - low) / np.abs(q).max(axis=0), speed / np.abs(v).max(axis=0))
    motion = Series(body, middle, *(waves * scale), period)
    return motion if (np.abs(torque_of(motion, time)) <= torque).all() else None


def sinusoids(body: Body, seconds: float, rng: np.random.Generator, **limits: float) -> Motion:
    """Return the paper's two tones with random phases at each joint."""
    period = 2 * np.pi / 2.25  # of the slow tone [s]; the fast tone, 12.07 rad/s, is near its fifth harmonic
    for _ in range(100):
        phases = rng.uniform(0, 2 * np.pi, (2, len(body.joints)))
        waves = np.zeros((2, 5, len(body.joints)))
        waves[:, 0], waves[:, 4] = (
            (np.sin(phases[0]), np.cos(phases[0])),
            (np.sin(phases[1]) / 5, np.cos(phases[1]) / 5),
        )
        if (motion := scale_series(body, period, waves, **limits)) is not None:
            return motion
    raise ValueError("no phases keep the torque")


def random_fourier(body: Body, seconds: float, rng: np.random.Generator, **limits: float) -> Motion:
    """Draw the best of many random series by the determinant of the information (Swevers et al. 1997)."""
    alike = 1.0 / np.sqrt(np.arange(1, 6))[:, None]
    drawn = (
        scale_series(body, seconds, rng.normal(size=(2, 5, len(body.joints))) * alike, **limits) for _ in range(TRIES)
    )
    return max((motion for motion in drawn if motion is not None), key=partial(log_det, seconds=seconds))


def cma_fourier(body: Body, seconds: float, rng: np.random.Generator, **limits: float) -> Motion:
    """Optimise a series by CMA-ES, with ten times as many series."""
    import cma

    shape = (2, 5, len(body.joints))

    def loss(x: Array) -> float:
        motion = scale_series(body, seconds, np.reshape(x, shape), **limits)
        return 1e3 if motion is None else -log_det(motion, seconds)

    options = {"seed": int(rng.integers(1, 2**31)), "maxfevals": 10 * TRIES, "verbose": -9}
    search = cma.CMAEvolutionStrategy(rng.normal(size=np.prod(shape)), 0.5, options).optimize(loss)
    motion = scale_series(body, seconds, np.reshape(search.best.x, shape), **limits)
    assert motion is not None
    return motion


def information(body: Body, motion: Motion, seconds: float) -> Array:
    """Return the information on relative parameters (P, P), for unit noise of a tick."""
    q, v, a = motion(np.arange(TICK / 2, seconds, TICK))
    own = compute_parameter_scales(body)
    rows = make_information_rows(body, own, q, v, a).reshape(-1, len(own))
    return INFORMATION_PRIOR * np.eye(len(own)) + rows.T @ rows


def log_det(motion: Any, seconds: float) -> float:
    """Return log det of the information [nat]."""
    return float(np.linalg.slogdet(information(motion.body, motion, seconds)).logabsdet)


def deviation(motion: Any, seconds: float) -> float:
    """Return the RMS of the relative standard errors, for unit noise of a tick."""
    return float(np.sqrt(np.linalg.inv(information(motion.body, motion, seconds)).diagonal().mean()))


def agent(body: Body, seconds: float, rng: np.random.Generator, **limits: float) -> Motion:
    """Plan the motion by the shipped policy."""
    return plan_motion(load("arm"), body, find_limits(body, **limits), seconds)


def by_knots(body: Body, seconds: float, rng: np.random.Generator, **limits: float) -> Motion:
    """Design the default motion of `record`."""
    return design_excitation(body, seconds, rng=rng, **limits)


CONTENDERS: dict[str, Callable[..., Motion]] = {
    BASE: random_fourier,
    "with full limits": partial(random_fourier, share=1.0),
    "two tones": sinusoids,
    "fourier, CMA-ES": cma_fourier,
    "knot by knot": by_knots,
    "agent": agent,
}


def draw_links(rng: np.random.Generator) -> tuple[Link, ...]:
    """Draw links within 30 % of the default ones, with equal lengths."""
    names = ("mass", "center", "inertia", "viscous", "coulomb")
    return tuple(
        replace(link, **{name: getattr(link, name) * rng.uniform(1 - SPREAD, 1 + SPREAD) for name in names})
        for link in TWO_LINK
    )


def errors(file: Body, links: tuple[Link, ...], motion: Any, rng: np.random.Generator) -> tuple[list[float], Array]:
    """Return the RMS relative error of all parameters at `MOMENTS`, and the largest angles and speeds (2, n)."""
    arm = PlanarArm(links, rate=RATE, torque_noise=NOISE, max_torque=TORQUE)
    truth = parse_body(arm.unwrapped.urdf)
    recording = follow(arm, motion, round(MOMENTS[-1] * RATE), TORQUE, rng=rng)
    smoothing = Smoothing.from_encoder(arm.counts, RATE)
    estimator = OnlineEstimator(RATE, arm_base(file), [scheme("filtered_dynamic")], smoothing=smoothing)
    own = np.concatenate([truth.values, *np.array([(link.viscous, link.coulomb) for link in links]).T])
    names = [*file.names, *(f"{kind}@{joint}" for kind in ("viscous", "coulomb") for joint in file.joints)]
    places = [estimator.names.index(name) for name in names]
    found, relative = [], compute_parameter_scales(truth)
    for time, now in zip(recording.time, stream_recording(estimator, recording), strict=True):
        if len(found) < len(MOMENTS) and time >= MOMENTS[len(found)] - 1.5 / RATE:
            found.append(float(np.sqrt(np.mean(((now.theta[0, 0, places] - own) / relative) ** 2))))
    most = np.abs(recording.position).max(axis=0), np.abs(np.diff(recording.position, axis=0)).max(axis=0) * RATE
    return found, np.array(most)


def two_link(bodies: int, seed: int, limits: dict[str, float]) -> None:
    """Print the errors of every contender on the same bodies, also relative to the first contender."""
    file, results = parse_body(PlanarArm().urdf), {}
    print(f"{bodies} bodies within 30 %, noise {NOISE:g} N m, limits {limits}")
    for name, contender in CONTENDERS.items():
        made, most, own = [], [], []
        fixed = (
            contender(file, MOMENTS[-1], np.random.default_rng(0), **limits)
            if name in ("agent", "fourier, CMA-ES")
            else None
        )
        for k in range(bodies):
            rng = np.random.default_rng([k, seed])
            links = draw_links(rng)
            motion = fixed or contender(file, MOMENTS[-1], rng, **limits)
            found, reached = errors(file, links, motion, rng)
            made.append(found)
            most.append(reached)
            own.append(deviation(motion, MOMENTS[-1]))
        results[name] = np.array(made).T
        gains = []
        for found, base in zip(results[name], results[BASE], strict=True):
            low, high = compute_bootstrap_interval(compute_gain, found, base)
            gains.append(f"{1 / compute_gain(found, base):.2f} ({1 / high:.2f} to {1 / low:.2f})")
        (angle, speed) = np.max(most, axis=0)
        middle = ", ".join(f"{100 * np.median(found):.3f}" for found in results[name])
        print(
            f"{name:18} error {middle} %  share of the first {'  '.join(gains)}  planned {np.median(own):.4f}  "
            f"angle {angle.round(2)} speed {speed.round(1)}",
            flush=True,
        )


def robots(folder: Path, seconds: float = 10.0) -> None:
    """Print the standard errors and condition numbers of motions of published robots."""
    print("robot, motion: RMS standard error as a share of random Fourier series, geometric mean, condition")
    for name, file in ROBOTS.items():
        motions = [f"panda_joint{k}" for k in range(1, 8)] if name == "Panda" else None
        body = read_body(folder / file, joints=motions)
        first: Any = None
        for own in (BASE, "fourier, CMA-ES", "knot by knot"):
            motion: Any = CONTENDERS[own](body, seconds, np.random.default_rng(0))
            first = first or motion
            shares = deviation(motion, seconds) / deviation(first, seconds)
            both = (log_det(one, seconds) for one in (first, motion))
            mean = np.exp(0.5 * -np.diff([*both])[0] / len(compute_parameter_scales(body)))
            time = np.arange(0.0, seconds, TICK)
            q, v, a = motion(time)
            condition = compute_condition_number(make_torque_rows(body, q, v, a))
            torque = (np.abs(torque_of(motion, time)).max(axis=0) / body.torque_limits).max()
            print(
                f"{name:12} {own:18} {shares:.2f} {mean:.2f} {condition:5.0f}  torque {torque:.2f}, "
                f"acceleration {np.abs(a).max():.1f}",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("two-link", "robots"))
    parser.add_argument("folder", nargs="?", type=Path, help="robots of example-robot-data")
    parser.add_argument("--bodies", type=int, default=40)
    parser.add_argument("--seed", type=int, default=7, help="of the bodies")
    parser.add_argument("--max-angle", type=float)
    parser.add_argument("--max-speed", type=float)
    parser.add_argument("--max-acceleration", type=float, default=40.0, help="of two links; no series needs more")
    arguments = parser.parse_args()
    if arguments.what == "robots":
        robots(arguments.folder)
    else:
        asked = {name: getattr(arguments, name) for name in ("max_angle", "max_speed", "max_acceleration")}
        two_link(
            arguments.bodies,
            arguments.seed,
            {name: v for name, v in asked.items() if v is not None} | {"max_torque": TORQUE},
        )
    sys.exit()
