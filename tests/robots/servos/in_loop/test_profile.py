"""Parameters with many local minima in the loop: several starts, and intervals of the profile likelihood."""

import math

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.data.regression_data import RegressionData
from estimators.search_hints import make_grid
from estimators.weak_form.point import Point
from pendulum_env.physics import BASE
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.physics.transmission import Backlash
from pendulum_env.recording import Recording
from robots.servos import ServoDrive
from robots.servos.drive import Shaft
from robots.servos.in_loop.linearisation import linearise_errors
from robots.servos.in_loop.profile import fit_parabola
from robots.servos.in_loop.rollout_rows import RolloutRows
from robots.servos.in_loop.rollouts import Rollouts
from tests import slow

TERMS = (*BASE, GravityTilt())
CASES = [
    {"gap": 8.7e-3, "stiffness": 800.0, "damping": 0.5, "link": 0.012, "rate": 100},
    {"gap": 3.0e-3, "stiffness": 800.0, "damping": 0.3, "link": 0.010, "rate": 100},
    {"gap": 2.0e-2, "stiffness": 400.0, "damping": 0.3, "link": 0.020, "rate": 200},
    {"gap": 5.0e-3, "stiffness": 1500.0, "damping": 1.0, "link": 0.008, "rate": 50},
]


def record_play(gap: float, stiffness: float, damping: float, link: float, rate: int) -> tuple[Recording, ...]:
    """Goals and positions of a servo with play behind its motor of 0.004 kg m^2, by an independent simulator."""
    transmission = {"Jm": 0.004, "bl_gap": gap, "bl_k": stiffness, "bl_d": damping}
    plant = Plant(link + 0.004, 0.736, 0.30, 0.09, {"backlash": transmission})
    told = {"counts": 4096, "control": "servo", "gains": (12.0, 0.0), "torque_limit": 3.0}
    runs = simulate([(plant, Experiment(1000.0, 8.0, "pd_loop", 0.5, seed, **told)) for seed in (1, 2)])
    drive, found = ServoDrive(kp=4.0, supply=12.0, gain=0.25, rate=1000.0, goal="ramp"), []
    for k, run in enumerate(runs):
        time, position, goal = (series[:: 1000 // rate] for series in (run.time, run.position, run.goal))
        found.append(Recording(time, position, 12.0 * (goal - position), reference=goal, drive=drive, name=f"{k}"))
    return tuple(found)


@pytest.mark.parametrize("case", slow.but_first(CASES))
def test_gap_comes_back_within_its_profile_interval(case):
    recordings = record_play(**case)
    rows = RolloutRows(Rollouts(recordings), RegressionData.from_recordings(recordings).torque)
    x = rows.torque.data.samples
    found = rows.search_basins(TERMS, make_grid(Backlash, x, x.torque)[::3])
    profile = rows.fits.fit_by_profile(found.terms)
    assert profile is not None
    gap, std = profile.point.named_values[profile.name], np.sqrt(profile.variance)
    assert abs(gap - case["gap"]) < 3 * std < (0.3 if case["rate"] > 50 else 0.75) * case["gap"]
    values = profile.point.named_values  # all dry friction is that of the motor
    assert values.get("backlash.friction", 0.0) * values["backlash"] < 0.1 * values["coulomb"]


def test_slopes_by_the_inertia_beside_a_play_are_those_of_a_motor_that_has_inertia():
    """Where the torque turns a viscous joint, the typical inertia is many times that of the joint."""
    rollouts = Rollouts(record_play(**CASES[0]))
    play = Backlash(gap=8.7e-3, resonance=258.0, damping=42.0, gravity=61.0)
    point = Point.from_parameters((*TERMS, play), np.array([0.016, 0.736, 0.30, 0.09, 0.0, 0.012]))
    least, most = (linearise_errors(rollouts, point, size * np.ones(6), True).slopes for size in (1e-6, 0.2))
    assert np.linalg.norm(most[:, 0] - least[:, 0]) < 0.1 * np.linalg.norm(least[:, 0])


def test_terms_without_local_minima_have_no_profile():
    recordings = record_play(**CASES[0])
    rows = RolloutRows(Rollouts(recordings), RegressionData.from_recordings(recordings).torque)
    assert rows.fits.fit_by_profile(BASE) is None


def test_parabola_has_the_variance_of_a_likelihood_and_scatter_adds_to_it():
    x, std = np.linspace(-0.3, 0.4, 8), 0.1
    height = 50.0 - (x - 0.07) ** 2 / (2 * std**2)
    value, variance = fit_parabola(x, height)
    assert value == pytest.approx(0.07) and variance == pytest.approx(std**2)
    assert fit_parabola(x, height, 4.0)[1] == pytest.approx(4 * std**2)
    rng = np.random.default_rng(0)
    trials = [fit_parabola(x, height + rng.standard_normal(8)) for _ in range(400)]
    scatter = np.var([value for value, _ in trials])
    assert np.mean([variance for _, variance in trials]) == pytest.approx(std**2 + scatter, rel=0.3)


def test_maxima_that_bend_upwards_leave_half_their_range():
    x = np.linspace(0.0, 1.0, 5)
    assert fit_parabola(x, (x - 0.4) ** 2) == (1.0, 0.25)


def record_link_friction(share: float, friction: float, viscous: float, encoder: Shaft) -> tuple[Recording, ...]:
    """Goals and positions of a servo whose link has shares of dry and viscous friction, semi-implicit steps of 50 us.

    Gravity of 0.736 N m hangs on a link of 0.0113 kg m^2 behind a play of 8.73 mrad. Log and controller read one shaft.
    """
    motor, link, gap, stiffness, damping, h = 0.006, 0.0113, 8.73e-3, 570.0, 0.56, 5e-5
    rng, found = np.random.default_rng(63), []
    time = np.arange(1000) / 100
    for kp, pace in ((4.0, 0.2), (4.0, 0.35), (8.0, 0.5)):
        goal = 0.6 * np.sin(2 * np.pi * pace * time) + 0.4 * np.sin(2 * np.pi * 2.6 * pace * time)
        q = v = ql = vl = 0.0
        path = np.empty(len(time))
        for k, wanted in enumerate(goal.tolist()):
            path[k] = ql if encoder == "output" else q
            for _ in range(10):
                command = 3.0 * max(-1.0, min(1.0, kp * (wanted - (ql if encoder == "output" else q))))
                for _ in range(20):
                    twist = q - ql
                    stretch = twist - max(-gap, min(gap, twist))
                    torque = stiffness * stretch + damping * (v - vl) if stretch else 0.0
                    v += h * (command - torque - 0.3 * (1 - viscous) * v) / motor
                    v -= max(-h * (1 - share) * friction / motor, min(h * (1 - share) * friction / motor, v))
                    vl += h * (torque - 0.736 * math.sin(ql) - 0.3 * viscous * vl) / link
                    vl -= max(-h * share * friction / link, min(h * share * friction / link, vl))
                    q, ql = q + h * v, ql + h * vl
        count = 2 * np.pi / 4096
        position = np.round((path + rng.normal(0.0, 3e-4, len(path))) / count) * count
        drive = ServoDrive(kp=kp, supply=12.0, gain=0.25, rate=1000.0, goal="held", encoder=encoder)
        found.append(
            Recording(
                time,
                position,
                3 * kp * (goal - position),
                name=f"{kp:g}, {pace:g}",
                reference=goal,
                drive=drive,
            )
        )
    return tuple(found)


@pytest.mark.parametrize(
    ("encoder", "viscous"),
    slow.but([("output", 0.05)], [("motor", 0.0), ("motor", 0.05), ("output", 0.05)]),
)
def test_friction_of_the_link_is_told_from_friction_of_the_motor_and_leaves_the_gap_right(encoder, viscous):
    recordings = record_link_friction(0.12, 0.09, viscous, encoder)
    rows = RolloutRows(Rollouts(recordings), RegressionData.from_recordings(recordings).torque)
    x = rows.torque.data.samples
    profile = rows.fits.fit_by_profile(rows.search_basins(TERMS, make_grid(Backlash, x, x.torque)[::3]).terms)
    assert profile is not None
    values, std = profile.point.named_values, np.sqrt(profile.variance)
    assert abs(values["backlash.gap"] - 8.73e-3) < 3 * std < 2.6e-3
    by_gap = values["backlash"] * std * abs(profile.slopes[[*values].index("backlash.friction")])  # [N m]
    assert abs(values["backlash.friction"] * values["backlash"] - 0.12 * 0.09) < 3 * by_gap < 0.012
    assert values.get("backlash.viscous", 0.0) * values["backlash"] == pytest.approx(0.3 * viscous, abs=0.005)
    assert values["coulomb"] == pytest.approx(0.09, rel=0.03)
    weight = values["backlash.gravity"] * values["backlash"]
    assert weight <= values["gravity"] * (1 + 1e-12)  # of a balanced rotor; the product is rounded
