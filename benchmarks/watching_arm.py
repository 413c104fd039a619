"""An arm of two links that changes while it is watched: how soon that is told, as what, and at which joint.

    python -m benchmarks.watching_arm [RUNS]

The plant is the textbook's two-link arm, integrated by Runge and Kutta's fourth order with friction that rises over
4 mrad/s: it shares no code with what it checks. Torque is a multisine at each joint, logged with noise of 0.02 N m;
encoders have 65,536 counts, and samples come at 500 Hz. The change is at 10 s, ten seconds more are watched.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.two_link import GRAVITY, Multisine, TwoLink
from estimators.online import Verdict, Watch
from estimators.signals.measurements import Smoothing
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.joints import arm_base

RATE, SUBSTEPS, CHANGE, SECONDS, COUNTS, NOISE = 500.0, 8, 10.0, 20.0, 65_536, 0.02
UPPER = 0.45  # [m], length of the upper arm
PLANT = {"m1": 1.2, "m2": 0.8, "c1": 0.2, "c2": 0.15, "i1": 0.02, "i2": 0.008}
PLANT |= {"b1": 0.3638, "b2": 0.3638, "f1": 0.9163, "f2": 0.9163}
PLANT |= dict.fromkeys(("cog1", "cog2", "drag2", "stribeck2", "spring2", "load2"), 0.0)
CHANGES: dict[str, Mapping[str, float]] = {
    "nothing": {},
    "payload": {"m2": 1.0, "c2": 0.18},
    "viscous@elbow": {"b2": 0.5},
    "coulomb@shoulder": {"f1": 1.2},
    "cogging@elbow": {"cog2": 0.3},
    "cogging@shoulder": {"cog1": 0.3},
    "quadratic_drag@elbow": {"drag2": 0.03},
    "stribeck@elbow": {"stribeck2": 0.5},
    "spring@elbow": {"spring2": 0.3},
    "load_dependent_friction@elbow": {"load2": 0.3},
}


def accelerations(p: Mapping[str, np.ndarray], q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Of both joints of B arms (2, B), under torques u (2, B)."""
    coupled = p["m2"] * UPPER * p["c2"]
    m22 = p["m2"] * p["c2"] ** 2 + p["i2"]
    m12 = m22 + coupled * np.cos(q[1])
    m11 = p["m1"] * p["c1"] ** 2 + p["i1"] + p["m2"] * UPPER**2 + m12 + coupled * np.cos(q[1])
    h = coupled * np.sin(q[1])
    g2 = p["m2"] * p["c2"] * GRAVITY * np.sin(q[0] + q[1])
    g1 = (p["m1"] * p["c1"] + p["m2"] * UPPER) * GRAVITY * np.sin(q[0]) + g2
    direction = np.tanh(v / 0.004)
    dry = p["f2"] + p["stribeck2"] * np.exp(-((v[1] / 0.5) ** 2)) + p["load2"] * np.abs(u[1])
    r1 = u[0] - g1 + h * (2 * v[0] + v[1]) * v[1] - p["b1"] * v[0] - p["f1"] * direction[0]
    r1 -= p["cog1"] * np.sin(12 * q[0])
    r2 = u[1] - g2 - h * v[0] ** 2 - p["b2"] * v[1] - dry * direction[1] - p["cog2"] * np.sin(12 * q[1])
    r2 -= p["drag2"] * np.abs(v[1]) * v[1] + p["spring2"] * q[1]
    det = m11 * m22 - m12**2
    return np.array([(m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det])


def simulate(cases: Sequence[tuple[str, int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (N,), positions and torques (N, 2, B) of B arms, each with what changes and a seed of its torque."""
    before = {name: np.full(len(cases), value) for name, value in PLANT.items()}
    after = {name: np.array([{**PLANT, **CHANGES[id]}[name] for id, _ in cases]) for name in PLANT}
    time = np.arange(0, SECONDS, 1 / RATE)
    torque = np.stack([Multisine.paper(seed, (5.0, 2.5)).held(time, 1 / RATE) for _, seed in cases], axis=2)
    q = v = np.zeros((2, len(cases)))
    h, positions = 1 / RATE / SUBSTEPS, np.empty(torque.shape)
    for k, t in enumerate(time):
        positions[k], p, u = q, before if t < CHANGE else after, torque[k]
        for _ in range(SUBSTEPS):
            a1 = accelerations(p, q, v, u)
            a2 = accelerations(p, q + h / 2 * v, v + h / 2 * a1, u)
            a3 = accelerations(p, q + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2, u)
            a4 = accelerations(p, q + h * v + h * h / 2 * a2, v + h * a3, u)
            q, v = q + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    step = 2 * np.pi / COUNTS
    return time, np.round(positions / step) * step, torque


def watched(body: Body, time: np.ndarray, position: np.ndarray, torque: np.ndarray) -> tuple[float | None, Verdict]:
    """Time of the first alarm [s] and the last verdict on one arm: positions (N, 2), torques held from then on."""
    terms, smoothing = arm_base(body), Smoothing.of_encoder(COUNTS, RATE)
    watch, alarm = Watch(RATE, terms, smoothing=smoothing), None
    for k in range(len(time)):
        applied = torque[max(0, k - 1)][None]
        (said,) = watch.take(time[k : k + 1], position[k : k + 1], applied)
        alarm = float(time[k]) if alarm is None and said.alarms else alarm
    return alarm, said


def main(arguments: Sequence[str] = ()) -> int:
    runs = int(arguments[0]) if arguments else 4
    cases = [(id, seed) for id in CHANGES for seed in range(runs)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "two.urdf"
        path.write_text(TwoLink().urdf())
        body = read_body(path)
    time, positions, torques = simulate(cases)
    torques = torques + NOISE * np.random.default_rng(0).normal(size=torques.shape)
    for id in CHANGES:
        own = [watched(body, time, positions[..., b], torques[..., b]) for b, (one, _) in enumerate(cases) if one == id]
        alarms = [alarm - CHANGE for alarm, _ in own if alarm is not None]
        late = f"{np.median(alarms):.1f} s after" if alarms else "no alarm"
        told = [f"{said.kind} {', '.join(said.changes if said.kind == 'value' else said.where)}" for _, said in own]
        print(f"{id:30} {len(alarms)} of {runs}, {late}: {'; '.join(dict.fromkeys(told))}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
