from dataclasses import replace

import numpy as np
import pytest

from benchmarks import six_joint
from benchmarks.two_link import TwoLink
from estimators import identify
from estimators.regression.least_squares import IdentificationError
from estimators.weak_form.links import prepare_arm
from robots.arms import arm_base
from robots.arms.payload import detect_payloads, find_payload
from robots.arms.recording import ArmRecording
from robots.arms.standard import find_nearest_link, make_pseudo_inertia
from tests.two_link import record_arm

EMPTY = TwoLink()
MASS, PLACE, INERTIA = 0.5, 0.3, 0.004  # [kg], [m] down the forearm, [kg m^2] about its centre
RATE = 500.0


def carrying(arm):
    """The arm with a body at its forearm, by the parallel axis theorem."""
    m, c, i = arm.mass[1], arm.center[1], arm.inertia[1]
    whole = m + MASS
    center = (m * c + MASS * PLACE) / whole
    inertia = i + m * (c - center) ** 2 + INERTIA + MASS * (PLACE - center) ** 2
    return replace(
        arm, mass=(arm.mass[0], whole), center=(arm.center[0], center), inertia=(arm.inertia[0], inertia),
        viscous=(0.4, 0.3),  # another day
    )  # fmt: skip


def run(seed, is_loaded):
    return record_arm(carrying(EMPTY) if is_loaded else EMPTY, seed, rate=RATE, scale=(6.0, 3.5))


@pytest.fixture(scope="module")
def model(body):
    return identify(run(0, False), arm_base(body), "filtered_dynamic")["filtered_dynamic"].model


@pytest.mark.parametrize("known", ["model", "recording"])
def test_a_payload_is_weighed_and_what_the_plane_hides_is_said(model, known):
    found = find_payload(model, [run(1, True)], [run(0, False)] if known == "recording" else [])
    truth = {"m": MASS, "mx": 0.0, "mz": -MASS * PLACE, "Iyy": INERTIA + MASS * PLACE**2}
    assert set(found.estimates) == set(truth) and "my" in found.hidden and "Ixx" in found.hidden
    for name, value in truth.items():
        assert found.estimates[name].value == pytest.approx(value, rel=0.005, abs=3e-4), name
    assert set(found.center) == {"x", "z"} and found.exists is None  # not all ten are shown
    assert found.center["z"].value == pytest.approx(-PLACE, rel=0.005)
    assert all(after < 0.02 < 0.5 < before for before, after in found.torque_rms.values())  # [N m]; noise: 0.02


def test_an_empty_arm_carries_nothing(model):
    found = find_payload(model, [run(5, False)])
    assert abs(found.estimates["m"].value) < 0.01 and not found.is_significant
    assert find_payload(model, [run(1, True)]).is_significant


def test_a_joint_that_is_not_there_and_an_arm_at_rest_are_refused(model, body):
    with pytest.raises(ValueError, match="unknown joint 'wrist'"):
        find_payload(model, [run(1, True)], joint="wrist")
    still = ArmRecording.from_arrays(
        "still", body.joints, np.arange(0, 3, 1 / RATE), np.zeros((1500, 2)), np.zeros((1500, 2))
    )
    with pytest.raises(IdentificationError, match=r"still: .*motion"):
        find_payload(model, [still])


@pytest.mark.parametrize("shown", [np.arange(1, 10), np.arange(4, 10), []], ids=["no mass", "inertia alone", "nothing"])
def test_what_the_motion_does_not_show_of_a_body_stays_of_its_size(shown):
    free = np.array([2.0, 0.2, 0.0, -0.1, 0.004, 0.0, 0.023, 0.01, 0.0, 0.019])  # less inertia than a point has
    columns = np.zeros((50, 10))
    columns[:, shown] = np.random.default_rng(0).normal(size=(50, len(shown)))
    found = find_nearest_link(free, columns)
    assert np.linalg.eigvalsh(make_pseudo_inertia(found)).min() > 0
    assert found[0] < 20.0


def test_moments_that_no_body_has_give_way_to_the_best_of_a_body():
    point = np.array([2.0, 0.2, 0.0, -0.1, 0.005, 0.0, 0.025, 0.01, 0.0, 0.02])  # of 2 kg at (0.1, 0, -0.05) m
    free = point - [0, 0, 0, 0, 0.001, 0, 0.002, 0, 0, 0.001]  # less inertia than a point has
    columns = np.random.default_rng(0).normal(size=(50, 10))
    found = find_nearest_link(free, columns)
    assert np.linalg.eigvalsh(make_pseudo_inertia(found))[0] > -1e-9 > np.linalg.eigvalsh(make_pseudo_inertia(free))[0]
    assert np.linalg.norm(columns @ (found - free)) < np.linalg.norm(columns @ (point - free))
    real = point + np.array([0, 0, 0, 0, 0.002, 0, 0.002, 0, 0, 0.002])
    assert np.array_equal(find_nearest_link(real, columns), real)


def test_noise_in_the_place_of_a_payload_gives_way_to_a_light_body_without_a_warning():
    """Of a gram, known to parts of it: long steps in the logarithms overflow."""
    rng = np.random.default_rng(0)
    noise = 1e-3 * np.append(1.0, rng.normal(size=9))
    columns = rng.normal(size=(50, 10)) * np.geomspace(1, 30, 10)
    found = find_nearest_link(noise, columns)
    assert np.linalg.eigvalsh(make_pseudo_inertia(found))[0] > -1e-12 and found[0] > 0
    assert np.linalg.norm(columns @ (found - noise)) < np.linalg.norm(columns @ noise)


def test_a_body_at_the_flange_of_a_robot_in_mujoco_is_told_whole():
    pytest.importorskip("mujoco")
    load = six_joint.Load(1.4, (0.05, -0.03, 0.04), (0.004, 0.003, 0.0035))
    arm = six_joint.body()
    empty, full = six_joint.simulate(1, seconds=8.0), six_joint.simulate(2, seconds=8.0, load=load)
    model = identify(empty, arm_base(arm), "filtered_dynamic")["filtered_dynamic"].model
    found = find_payload(model, [full], [empty])
    assert found.estimates["m"].value == pytest.approx(1.4, rel=0.02)
    assert [one.value for one in found.center.values()] == pytest.approx(load.center, abs=1e-3)
    about = np.diag(load.inertia) + 1.4 * (np.dot(load.center, load.center) * np.eye(3) - np.outer(*2 * [load.center]))
    for name, value in (("Ixx", about[0, 0]), ("Iyy", about[1, 1]), ("Izz", about[2, 2])):
        assert found.estimates[name].value == pytest.approx(value, rel=0.1), name
    assert found.exists and found.is_significant and not found.hidden


def test_standard_errors_hold_what_is_carried(model):
    """Of the recordings without it as well, where these are given."""
    for seed in range(1, 5):
        found = find_payload(model, [run(seed, True)], [run(0, False)])
        mass = found.estimates["m"]
        assert abs(mass.value - MASS) < 4 * mass.std and mass.std < 0.002 * MASS


def test_a_body_whose_mass_the_motion_hardly_shows_is_found_by_its_first_moments(monkeypatch):
    """Of three joints, the last turns the load about its own axis: mass and distance along the axis are nearly one."""
    pytest.importorskip("mujoco")
    monkeypatch.setattr(six_joint, "AXES", ("0 0 1", "0 1 0", "1 0 0"))
    arm, load = six_joint.body(six_joint.JOINTS[:3]), six_joint.Load(0.6, (-0.06, -0.09, 0.02), (0.001, 0.001, 0.001))
    empty, full = (
        six_joint.simulate(seed, seconds=8.0, load=body, rubs=(1.0,) * 3) for seed, body in ((1, None), (2, load))
    )
    found = find_payload(identify(empty, arm_base(arm), "filtered_dynamic")["filtered_dynamic"].model, [full], [empty])
    assert found.estimates["m"].std > found.estimates["m"].value / 5 and found.is_significant
    for moment, center in zip(("mx", "my", "mz"), load.center, strict=True):
        estimate = found.estimates[moment]
        assert estimate.value == pytest.approx(0.6 * center, abs=3 * estimate.std), moment
    parts = [prepare_arm([recording], arm_base(arm)) for recording in (empty, full)]
    assert [recordings for _, recordings in detect_payloads(parts, arm_base(arm))] == [(1,)]


def test_the_possible_body_nearest_to_an_impossible_one_is_the_least_of_a_convex_problem():
    """No possible body is nearer, also where a mass and its distance are nearly one."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        columns = rng.normal(size=(60, 10))
        columns[:, 0] = 0.3 * columns[:, 1] + 1e-3 * columns[:, 0]
        columns *= 10.0 ** rng.uniform(1, 3, 10)
        center, factor = rng.normal(0, 0.1, 3), rng.normal(0, 0.03, (3, 3))
        spread = factor @ factor.T  # second moments about the centre
        second = spread + np.outer(center, center)
        about = np.trace(second) * np.eye(3) - second
        body = np.array([1.0, *center, about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]])
        free = body + np.linalg.lstsq(columns, rng.normal(size=60), rcond=None)[0]
        found = find_nearest_link(free, columns)
        assert np.linalg.eigvalsh(make_pseudo_inertia(found))[0] > -1e-12
        assert np.linalg.norm(columns @ (found - free)) <= np.linalg.norm(columns @ (body - free))
