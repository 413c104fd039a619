"""A play without a gap is an elastic joint: the simpler law takes its place, from its fit."""

import math

import numpy as np
import pytest

from estimators import diagnose
from estimators.data.regression_data import RegressionData
from estimators.weak_form.point import Point
from pendulum_env.physics import BASE
from pendulum_env.physics.actuation import DeadTime
from pendulum_env.physics.transmission import Backlash, JointFlexibility
from pendulum_env.recording import Recording
from robots.servos import ServoDrive
from robots.servos.in_loop.likelihood import compute_log_likelihood
from robots.servos.in_loop.rollout_rows import RolloutRows
from robots.servos.in_loop.rollouts import Rollouts

MOTOR, LINK, WEIGHT, VISCOUS, COULOMB = 0.0053, 0.0127, 0.75, 0.28, 0.07
STIFFNESS, DAMPING = 15.0, 0.06  # N m/rad, N m s/rad of the joint


def record_elastic(paces: list[tuple[float, float]], seconds: float) -> list[Recording]:
    """Goals and positions of a servo with an elastic joint and its encoder at the output, steps of 25 us."""
    found, h, count = [], 2.5e-5, 2 * math.pi / 4096
    for kp, pace in paces:
        time = np.arange(round(100 * seconds)) / 100
        goal = 0.6 * np.sin(2 * np.pi * pace * time) + 0.4 * np.sin(2 * np.pi * 2.6 * pace * time + 1.0)
        q = v = ql = vl = 0.0
        positions = np.empty(len(time))
        for k, wanted in enumerate(goal.tolist()):
            for tick in range(10):
                measured = round(ql / count) * count
                positions[k] = measured if tick == 0 else positions[k]
                command = 3.0 * max(-1.0, min(1.0, kp * (wanted - measured)))
                for _ in range(40):
                    torque = STIFFNESS * (q - ql) + DAMPING * (v - vl)
                    v += h * (command - torque - VISCOUS * v) / MOTOR
                    v -= max(-h * COULOMB / MOTOR, min(h * COULOMB / MOTOR, v))
                    vl += h * (torque - WEIGHT * math.sin(ql)) / LINK
                    q, ql = q + h * v, ql + h * vl
        drive = ServoDrive(kp=kp, supply=12.0, gain=0.25, rate=1000.0, goal="held", encoder="output")
        told = {"reference": goal, "drive": drive, "name": f"kp {kp:g}, {pace:g} Hz"}
        found.append(Recording(time, positions, 3 * kp * (goal - positions), **told))
    return found


def test_a_play_reduces_to_an_elastic_joint_with_its_other_parameters():
    (joint,) = Backlash(0.02, 40.0, 5.0, 55.0).reductions
    assert joint == JointFlexibility(40.0, 5.0, 55.0) and joint.reductions == ()


def test_an_elastic_joint_starts_from_the_fit_of_a_play_in_its_place():
    recordings = record_elastic([(4.0, 0.35)], 4.0)
    rows = RolloutRows(Rollouts(tuple(recordings)), RegressionData.from_recordings(recordings).torque)
    play = Backlash(1e-4, math.sqrt(STIFFNESS / LINK), DAMPING / LINK, WEIGHT / LINK)
    theta = np.array([MOTOR + LINK, WEIGHT, VISCOUS, COULOMB, LINK])
    for terms in (BASE, (*BASE, DeadTime(0.005))):  # an effect without linear parameters is no link
        rows.fits.linearise(terms)
    rows.fits.set_start(Point.from_parameters((*BASE, play), theta))
    linears = [rows.fits.linearise((*BASE, link)) for link in (play, *play.reductions)]
    heights = [compute_log_likelihood(rows.rollouts, linear.error) for linear in linears]
    assert heights[1] > heights[0] - 10 > compute_log_likelihood(rows.rollouts, rows.fits.linearise(BASE).error)
    assert linears[1].point.named_values["joint_flexibility"] == pytest.approx(LINK, rel=0.05)


@pytest.mark.slow
def test_an_elastic_joint_before_an_encoder_at_the_output_is_no_play():
    *fitted, held_out = record_elastic([(4.0, 0.2), (4.0, 0.35), (8.0, 0.5)], 10.0)
    found = diagnose(fitted, held_out, only=["backlash", "joint_flexibility"])
    assert found.selected == ("joint_flexibility",)
    estimates = found.model.estimates
    truth = {"joint_flexibility": LINK, "joint_flexibility.resonance": math.sqrt(STIFFNESS / LINK), "coulomb": COULOMB}
    for name, value in truth.items():
        assert abs(estimates[name].value - value) < 4 * estimates[name].std < value, name
