"""The independent simulator against DOP853 with event detection, and against identities of physics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.independent_plant import Experiment, Plant, simulate
from tests.runge_kutta import simulate_stick_slip

EXACT = {"counts": None, "torque_noise": 0.0}
SIZES = {
    "stribeck": {"strib_d": 0.45, "strib_v": 0.5},
    "quadratic_drag": {"drag": 0.05},
    "cogging": {"cog_n": 14.0, "cog_s": 0.15, "cog_c": 0.1},
    "torque_offset": {"offset": -0.2},
    "gravity_tilt": {"tilt_cos": 0.2},
    "load_dependent_friction": {"load_mu": 0.1, "load_w": 1.5},
    "periodic_disturbance": {"dist_a": 0.2, "dist_w": 20.0, "dist_ph": 1.0},
    "coulomb_asymmetry": {"asym_c": 0.2},
}


def shooting(plant: Plant, rate: float, command: np.ndarray) -> np.ndarray:
    """Position by DOP853: every sample restarts it, an event ends it where the sliding stops; rigid joint only."""
    p = plant.parameters

    def dry(t: float, q: float, v: float, u: float) -> float:
        rubs = p["coulomb"] + p["strib_d"] * np.exp(-((v / p["strib_v"]) ** 2))
        return rubs + p["load_mu"] * abs(u + p["load_w"] * np.sin(q))

    def net(t: float, q: float, v: float, u: float) -> float:
        motor = u + p["offset"] + p["cog_s"] * np.sin(p["cog_n"] * q) + p["cog_c"] * np.cos(p["cog_n"] * q)
        motor += p["dist_a"] * np.sin(p["dist_w"] * t + p["dist_ph"])
        weight = p["gravity"] * np.sin(q) + p["tilt_cos"] * np.cos(q)
        return motor - weight - p["viscous"] * v - p["drag"] * v * abs(v) - p["asym_c"]

    return simulate_stick_slip(net, dry, p["inertia"], command.tolist(), 1 / rate)[0][:-1]


@pytest.mark.parametrize(
    "effects",
    [
        (),
        ("stribeck", "quadratic_drag"),
        ("cogging", "torque_offset", "gravity_tilt"),
        ("load_dependent_friction", "coulomb_asymmetry"),
        ("periodic_disturbance",),
    ],
    ids="+".join,
)
def test_position_agrees_with_dop853_through_stops_and_sticks(effects: tuple[str, ...]) -> None:
    plant = Plant(effects={effect: SIZES[effect] for effect in effects})
    (run,) = simulate([(plant, Experiment(rate=200, seconds=3, scale=0.7, seed=3, **EXACT))])
    assert 0.001 < np.mean(~run.sliding) < 0.3
    np.testing.assert_allclose(run.position, shooting(plant, 200, run.command), atol=1e-5, rtol=0)


@pytest.mark.parametrize("friction_side", ["motor", "link"])
def test_two_masses_with_play_agree_with_dop853(friction_side: str) -> None:
    play = {"Jm": 0.02, "bl_gap": 0.02, "bl_k": 400.0, "bl_d": 0.0}  # undamped: the torque is continuous
    plant = Plant(coulomb=0.0, effects={"backlash": play}, friction_side=friction_side, encoder_side="link")
    (run,) = simulate([(plant, Experiment(rate=200, seconds=0.6, seed=3, **EXACT))])  # later it is chaotic

    def rate(t: float, y: np.ndarray) -> list[float]:
        q, v, angle, speed = y
        torque = play["bl_k"] * np.sign(angle - q) * max(abs(angle - q) - play["bl_gap"], 0)
        drag = 0.35 * (speed if friction_side == "motor" else v)
        u = run.command[min(int(t * 200 + 1e-9), len(run.command) - 1)]
        on_motor, on_link = (drag, 0.0) if friction_side == "motor" else (0.0, drag)
        return [v, (torque - 2 * np.sin(q) - on_link) / 0.07, speed, (u - torque - on_motor) / 0.02]

    y, path = np.zeros(4), []
    for t in run.time:
        path.append(y[0])
        y = solve_ivp(rate, (t + 1e-12, t + 1 / 200 - 1e-12), y, "DOP853", rtol=1e-8, atol=1e-10, max_step=2e-3).y[
            :, -1
        ]
    np.testing.assert_allclose(run.position, path, atol=1e-5, rtol=0)


def test_energy_is_kept_without_friction_and_else_lost_to_its_work() -> None:
    spring = {"spring": {"spring_k": 0.3, "spring_q0": 0.2}}
    free, damped = Plant(viscous=0.0, coulomb=0.0, effects=spring), Plant(viscous=0.1, coulomb=0.2, effects=spring)
    experiment = Experiment(rate=1000, seconds=5, start=(2.5, 1.0), **EXACT)
    runs = simulate([(free, experiment), (damped, experiment)], 2 * [np.zeros(5000)])
    for plant, run in zip((free, damped), runs, strict=True):
        q, v = run.position, run.velocity
        energy = 0.5 * plant.inertia * v**2 - plant.gravity * np.cos(q) + 0.15 * (q - 0.2) ** 2
        work = np.trapezoid(plant.viscous * v**2 + plant.coulomb * np.abs(v), run.time)
        assert energy[0] - energy[-1] == pytest.approx(work, rel=1e-4, abs=1e-7)
    assert not run.sliding[-1]


def test_joint_sticks_until_the_torque_exceeds_dry_friction() -> None:
    plant = Plant(coulomb=0.8, effects={"stribeck": {"strib_d": 0.4, "strib_v": 0.5}})
    ramp = np.arange(2000) / 1000  # N m
    (run,) = simulate([(plant, Experiment(seconds=2, **EXACT))], [ramp])
    freed = int(np.argmax(run.sliding))
    assert ramp[freed] == pytest.approx(1.2, abs=2e-3)  # fc + strib_d
    assert np.all(run.position[: freed + 1] == 0) and run.position[-1] > 0.5
    (run,) = simulate([(Plant(), Experiment(seconds=2, start=(0.3, 0.0), **EXACT))], [np.full(2000, 0.1)])
    assert np.ptp(run.position) == 0 and not run.sliding.any()  # held by friction, it does not creep
