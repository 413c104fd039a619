"""Stops that show at rest or in few impacts: what presses on them is named, and dry friction at rest is not."""

import mujoco
import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from benchmarks.two_link import TwoLink
from estimators import diagnose
from estimators.data.regression_data import RegressionData
from estimators.data.split import make_contact_finder, split_at_contacts
from estimators.data.standard_errors import StiffStop
from estimators.diagnosis.contacts import Contact
from estimators.diagnosis.untested import UntestedRange
from estimators.weak_form.contacts import count_contacts
from pendulum_env.physics import BASE
from pendulum_env.recording import Recording
from robots.arms import arm_base
from robots.arms.body import read_body
from robots.arms.recording import ArmRecording
from tests import slow
from tests.cases import diagnosed, recorded
from tests.two_link import JOINTS

INERTIA, GRAVITY, VISCOUS = 0.05, 1.2, 0.05
ARM = {"inertia": INERTIA, "gravity": GRAVITY, "viscous": VISCOUS}
RATE, SECONDS, MOVES = 250.0, 30.0, 11.0
STOP = 0.7  # [rad]
FEW = ["hard_stop", "stribeck", "payload_change", "spring"]


def tones(time: np.ndarray, seed: int, fastest: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    frequencies, phases = rng.uniform(0.3, fastest, 4), rng.uniform(0, 2 * np.pi, 4)
    return np.asarray(np.sin(2 * np.pi * time[:, None] * frequencies + phases).sum(axis=1) / 2)


def then_at_rest(moving: float, seed: int, resting: float, coulomb: float, stiffness: float = 0.0) -> Recording:
    """An arm that moves for 11 s under tones of a size, and rests for 18 s under a torque [N m]."""
    time = np.arange(round(RATE * SECONDS)) / RATE
    share = np.clip(time - MOVES, 0, 1)
    command = moving * tones(time, seed, 2.0) * (1 - share) + resting * share
    hidden = {"hard_stop": {"wall_hi": STOP, "wall_k": stiffness, "wall_d": stiffness / 200}} if stiffness else {}
    experiment = Experiment(RATE, SECONDS, seed=5, counts=16_384, torque_noise=0.01)
    return recorded(Plant(**ARM, coulomb=coulomb, effects=hidden), experiment, commands=[command])[0]


def on_the_stop(stiffness: float) -> Recording:
    """It stands on its stop under sixteen times its dry friction, and met it nowhere else."""
    return then_at_rest(0.45, 1, 16 * 0.15 + GRAVITY * np.sin(STOP), 0.15, stiffness)


@pytest.mark.parametrize("stiffness", [4000.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_an_arm_that_stands_on_its_stop_has_one_where_it_rests(stiffness):
    found = diagnosed([on_the_stop(stiffness)], only=FEW)
    assert found.selected == ("hard_stop",)
    estimates = found.model.estimates
    assert estimates["hard_stop.upper"].value == pytest.approx(STOP, abs=0.005)
    if stiffness < 100:  # else it yields less than the encoder resolves
        assert estimates["hard_stop.stiffness"].value == pytest.approx(stiffness, rel=0.1)
    else:
        assert estimates["hard_stop.stiffness"].is_unknown
        assert [own.effect for own in found.findings if isinstance(own, StiffStop)] == ["hard_stop"]
    assert estimates["inertia"].value == pytest.approx(INERTIA, rel=0.04)


def test_an_arm_that_stands_on_its_stop_before_it_moves_has_no_payload_change():
    time = np.arange(round(RATE * SECONDS)) / RATE
    share = np.clip((time - 14.0) / 3.0, 0, 1)
    pressed = -(8 * 0.15 + GRAVITY * np.sin(STOP))
    command = (1 - share) * pressed + share * (0.45 * tones(time, 4, 2.0))
    wall = {"hard_stop": {"wall_lo": -STOP, "wall_k": 3000.0, "wall_d": 15.0}}
    experiment = Experiment(RATE, SECONDS, seed=5, start=(-STOP, 0.0), counts=16_384, torque_noise=0.01)
    run = recorded(Plant(**ARM, coulomb=0.15, effects=wall), experiment, commands=[command])[0]
    found = diagnosed([run], only=FEW)
    assert set(found.selected) <= {"hard_stop"} and found.ambiguous == () and found.unexplained == ()
    place = {type(own): own.angle.value for own in found.findings if isinstance(own, Contact | StiffStop)}
    assert place.get(Contact, place.get(StiffStop)) == pytest.approx(-STOP, abs=0.01)
    for name, value in (ARM | {"coulomb": 0.15}).items():
        own = found.model.estimates[name]
        assert abs(own.value - value) < max(4 * own.std, 0.01 * value), name


@pytest.mark.parametrize(
    ("moving", "resting", "coulomb"),
    [(1.8, 0.3, 0.6), (1.8, -0.55, 0.6), (0.8, 0.0, 0.15)],
    ids=["held by friction", "held the other way", "hanging"],
)
def test_an_arm_at_rest_within_its_friction_has_no_stop(moving, resting, coulomb):
    held = then_at_rest(moving, 3, resting, coulomb)
    assert np.ptp(held.position[-3000:]) < 0.01
    prepared = RegressionData.from_recordings([held])
    assert count_contacts(make_contact_finder((prepared, prepared), BASE)(prepared).data) == 0
    found = diagnosed([held], only=FEW)
    assert found.selected == () and found.unexplained == ()


def limited(lower: float, upper: float, seed: int, rate: float = 250.0, seconds: float = 20.0) -> Recording:
    """A pendulum of MuJoCo with limits of its joint, of the default `solref`, which are damped critically."""
    length = 0.5 * INERTIA * 9.81 / GRAVITY
    mass = GRAVITY / 9.81 / length
    own = INERTIA - mass * length**2
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="0.0005" integrator="implicitfast"/><worldbody><body>'
        f'<joint axis="0 1 0" damping="{VISCOUS}" frictionloss="0.1" range="{lower} {upper}" limited="true"/>'
        f'<inertial pos="0 0 {-length}" mass="{mass}" diaginertia="{own} {own} {own}"/>'
        f"</body></worldbody></mujoco>"
    )
    data, time = mujoco.MjData(model), np.arange(round(rate * seconds)) / rate
    torque, position, count = 0.8 * tones(time, seed, 1.5), np.zeros(len(time)), round(2000 / rate)
    for k in range(len(time)):
        position[k], data.qfrc_applied[0] = data.qpos[0], torque[k]
        mujoco.mj_step(model, data, count)
    grain = 2 * np.pi / 16_384
    noise = 0.01 * np.random.default_rng(seed).standard_normal(len(time))
    return Recording(time, np.round(position / grain) * grain, torque + noise, name="limited")


@pytest.mark.parametrize(
    ("lower", "upper", "seed", "met"),
    [(-1.3, 0.7, 8, 2), pytest.param(-1.2, 0.9, 3, 8, marks=pytest.mark.slow)],
)
def test_limits_that_are_met_twice_within_two_radians_are_found(lower, upper, seed, met):
    run = limited(lower, upper, seed)
    beyond = (run.position > upper) | (run.position < lower)
    assert np.sum(np.diff(beyond.astype(int)) == 1) <= met + 2 and np.ptp(run.position) < 2.2
    found = diagnosed([run], only=FEW)
    assert found.selected == ("hard_stop",)
    end = found.model.estimates["hard_stop.upper"]
    assert abs(end.value - upper) < 3 * end.std < 0.2


@pytest.mark.parametrize("turns", slow.but([-1191], [0, -1191]))
def test_a_stop_that_a_staircase_presses_is_found_about_any_zero(turns):
    """Half of the log stands on the stop; the way beyond is a thousand times the depth of the contact."""
    wall = {"hard_stop": {"wall_hi": 0.6, "wall_k": 51.4, "wall_c": 0.05}}
    truth = {"inertia": 0.0446, "gravity": 0.424, "viscous": 0.095, "coulomb": 0.158}
    levels = np.r_[0:6, 6, 6:0:-1, 0:-6:-1, -6, -6:0, 0] / 6
    time = np.arange(24_500) / 1000.0
    command = 0.858 * levels[np.minimum((time / 24.5 * len(levels)).astype(int), len(levels) - 1)]
    experiment = Experiment(1000.0, 24.5, seed=3, counts=16_384, torque_noise=0.003)
    (run,) = recorded(Plant(**truth, effects=wall), experiment, commands=[command])
    shifted = Recording(run.time, run.position + 2 * np.pi * turns, run.torque)
    found = diagnose(shifted, only=FEW)
    assert found.selected == ("hard_stop",) and not found.unexplained
    truth |= {"hard_stop.upper": 0.6 + 2 * np.pi * turns, "hard_stop.stiffness": 51.4}
    for name, value in truth.items():
        estimate = found.model.estimates[name]
        assert abs(estimate.value - value) < 4 * estimate.std, name


@pytest.mark.parametrize(("upper", "seed"), [(0.892, 28), (1.717, 34)], ids=["fitted", "held out"])
def test_a_limit_that_is_met_once_is_a_contact_and_no_effect(upper, seed):
    """A single contact may be a blow; without the limit, the same torque shows no contact."""
    run, free = limited(-9.0, upper, seed), limited(-9.0, 9.0, seed)
    (met,) = np.flatnonzero(np.diff((run.position > upper).astype(int)) == 1)
    found = diagnosed([run], only=FEW)
    assert found.selected == () and found.model.estimates["inertia"].value == pytest.approx(INERTIA, rel=0.01)
    (contact,) = [own for own in found.findings if isinstance(own, Contact)]
    assert contact.angle.value == pytest.approx(upper, abs=0.05) and contact.count == 1
    assert contact.time.value == pytest.approx(run.time[met], abs=0.2)
    without = diagnosed([free], only=FEW)
    assert without.selected == () and not any(isinstance(own, Contact) for own in without.findings)


LINK = TwoLink(viscous=(0.3, 0.1), coulomb=(0.4, 0.15))


def two_links(seed: int, goal: float, limits: str = "") -> ArmRecording:
    """Two links in MuJoCo that follow tones, while the elbow is held at a goal from 12 to 25 s."""
    links = [
        f'<body pos="0 0 {-LINK.length * k}"><joint axis="0 -1 0" damping="{LINK.viscous[k]}" frictionloss='
        f'"{LINK.coulomb[k]}" {limits if k else ""}/><inertial pos="0 0 {-LINK.center[k]}" mass="{LINK.mass[k]}" '
        f'diaginertia="{LINK.inertia[k]} {LINK.inertia[k]} {0.1 * LINK.inertia[k]}"/>'
        for k in range(2)
    ]
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><option timestep="0.0005" integrator="implicitfast"/><worldbody>'
        f"{''.join(links)}</body></body></worldbody></mujoco>"
    )
    data, time = mujoco.MjData(model), np.arange(10_000) / 250.0
    goals = np.column_stack([0.7 * tones(time, seed, 1.0), 0.4 * tones(time, seed + 1, 1.0)])
    share = np.clip(np.minimum(time - 12.0, 25.0 - time) / 2.0, 0, 1)
    goals[:, 1] += share * (goal - goals[:, 1])
    position, torque = np.zeros_like(goals), np.zeros_like(goals)
    for k, row in enumerate(goals):
        position[k] = data.qpos
        torque[k] = np.array([30.0, 6.0]) * (row - data.qpos) - np.array([2.0, 0.4]) * data.qvel
        data.qfrc_applied[:] = torque[k]
        mujoco.mj_step(model, data, 8)
    grain, noise = 2 * np.pi / 65_536, np.random.default_rng(seed).normal(size=torque.shape)
    return ArmRecording.from_arrays("arm", JOINTS, time, np.round(position / grain) * grain, torque + 0.01 * noise)


@pytest.mark.parametrize(("goal", "limits"), [(1.6, 'range="-2 1.0" limited="true"'), (1.0, "")], ids=["stop", "held"])
def test_a_joint_of_an_arm_that_stands_on_its_stop_is_a_contact(tmp_path, goal, limits):
    (tmp_path / "arm.urdf").write_text(LINK.urdf())
    base = arm_base(read_body(tmp_path / "arm.urdf"))
    found = diagnose(two_links(2, goal, limits), (), base, only=["hard_stop", "spring"])
    contacts = [own for own in found.findings if isinstance(own, Contact)]
    assert (
        found.selected == ()
        and not found.joint_residuals
        and [own.joint for own in contacts] == ["elbow"] * bool(limits)
    )
    reasons = {own.effect: type(own.reason) for own in found.candidates}
    assert reasons["hard_stop@shoulder"] is UntestedRange
    assert reasons["hard_stop@elbow"] is (Contact if limits else UntestedRange)
    for own in contacts:
        assert own.angle.value == pytest.approx(1.0, abs=0.02)
        assert own.torque.value > 2 * LINK.coulomb[1] and 12 < own.time.value < 25
        assert 8 <= own.count <= 14  # once a second
    for name in ("viscous@elbow", "coulomb@elbow", "coulomb@shoulder"):
        own, values = found.model.estimates[name], {"viscous": LINK.viscous, "coulomb": LINK.coulomb}
        assert own.value == pytest.approx(values[name.split("@")[0]][JOINTS.index(name.split("@")[1])], rel=0.05)


def test_fitted_and_held_out_parts_both_have_contacts():
    late, early = np.array([0.8, 0.9]), np.linspace(0.05, 0.3, 10)
    motion = np.linspace(0.0, 1.0, 100)
    (begin, share), (_, end) = split_at_contacts(motion, late)
    assert (begin, end) == (0.0, 1.0) and 0.8 < share < 0.9
    (fitted, _), (_, held_out) = split_at_contacts(np.linspace(0.3, 1.0, 100), early)  # the motion comes late
    assert fitted == held_out and 0.05 < fitted < 0.3
    assert split_at_contacts(motion, late[:1]) is None


@pytest.mark.slow
def test_a_cable_that_pulls_beyond_an_angle_is_a_soft_stop():
    """The largest torque would press it in by more than the range between its ends, the motion does not."""
    cable = {"wall_lo": -0.8, "wall_hi": 1.0, "wall_k": 0.9}
    time = np.arange(10_000) / 500.0
    commands = [size * tones(time, seed, 2.0) for size, seed in ((1.1, 3), (1.2, 4))]
    experiments = [Experiment(500.0, 20.0, seed=seed, counts=65_536, torque_noise=0.005) for seed in (7, 8)]
    plant = Plant(**ARM, coulomb=0.15, effects={"hard_stop": cable})
    fitted, held_out = recorded(plant, *experiments, commands=commands)
    found = diagnose([fitted], [held_out], only=[*FEW, "cogging", "gravity_tilt"])
    assert found.selected == ("hard_stop",) and not found.unexplained
    truth = ARM | {"hard_stop.lower": -0.8, "hard_stop.upper": 1.0, "hard_stop.stiffness": 0.9}
    for name, value in truth.items():
        estimate = found.model.estimates[name]
        assert abs(estimate.value - value) < 3 * estimate.std < 0.1 * abs(value), name
