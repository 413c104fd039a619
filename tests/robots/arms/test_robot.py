"""Which joints of a robot move: against files in which the others are fixed, energies and Hamilton's equation."""

import mujoco
import numpy as np
import pytest

from benchmarks.two_link import TwoLink
from pendulum_env.physics.joints import (
    Links,
    find_kind,
    list_couplings,
    list_joint_effects,
    parse_effect,
    place_effects,
)
from pendulum_env.physics.table import Extent
from robots.arms import friction
from robots.arms.body import BodyError, read_body
from tests import robot_files
from tests.options import options as options
from tests.robot_files import ANGULAR, DRIVEN, PARALLEL, TORSO, urdf
from tests.robots.arms.test_body import chain, written

HELD = {"PARALLEL": (PARALLEL, 0.02), "ANGULAR": (ANGULAR, 0.3), "TORSO": (TORSO, 0.01)}


def moving(joints):
    return tuple(own.name for own in joints if own.sweep)


@pytest.mark.parametrize("robot", HELD)
def test_joints_that_are_held_are_as_if_the_file_had_them_fixed(tmp_path, robot):
    joints, opened = HELD[robot]
    body = read_body(written(tmp_path, urdf(joints)), joints=moving(joints), held={"left": opened})
    assert body.joints == moving(joints)
    assert body.held == pytest.approx(robot_files.positions(joints, {"left": opened}))
    fixed = read_body(written(tmp_path, urdf(joints, body.held), "fixed.urdf"))
    assert fixed.held == {} and fixed.names == body.names
    q, v, a = np.random.default_rng(0).uniform(-2, 2, (3, 50, len(body.joints)))
    assert np.abs(body.torque(q, v, a) - fixed.torque(q, v, a)).max() < 1e-9
    assert np.abs(body.exchange(q, v) - fixed.exchange(q, v)).max() < 1e-6
    assert body.values == pytest.approx(fixed.values, abs=1e-12)


@pytest.mark.parametrize("joints", [PARALLEL, ANGULAR, DRIVEN, TORSO], ids=["parallel", "angular", "driven", "torso"])
def test_energy_grows_by_what_the_torque_supplies_where_joints_follow_and_slide(tmp_path, joints):
    body, h = read_body(written(tmp_path, urdf(joints))), 1e-5
    followers = {own.name for own in joints if own.mimics is not None}
    assert set(body.links) - set(body.joints) == followers and body.held == {}
    q, v, a = np.random.default_rng(0).uniform(-2, 2, (3, 50, len(body.joints)))
    power = (body.energy(q + h * v, v + h * a) - body.energy(q - h * v, v - h * a)) / (2 * h)
    supplied = np.einsum("ni,nip->np", v, body.torque(q, v, a))
    assert np.abs(power - supplied).max() < 1e-5
    p_dot = (body.momentum(q + h * v, v + h * a) - body.momentum(q - h * v, v - h * a)) / (2 * h)
    assert np.abs(p_dot + body.exchange(q, v) - body.torque(q, v, a)).max() < 1e-5


def test_a_finger_that_follows_loads_the_one_that_leads(tmp_path):
    body = read_body(written(tmp_path, urdf(DRIVEN)))
    alone = read_body(written(tmp_path, urdf(DRIVEN, {"other": -0.4}), "fixed.urdf"))
    a = np.array([[0.0, 1.0]])
    inertia = [(one.momentum(0 * a, a) @ one.values)[0, 1] for one in (body, alone)]
    own = DRIVEN[2].inertia[1] + DRIVEN[2].mass * (0.02**2 + 0.1**2)
    assert inertia[0] - inertia[1] == pytest.approx(1.2**2 * own)


def test_mjcf_says_the_same_by_an_equality(tmp_path):
    spec = mujoco.MjSpec.from_string(urdf(DRIVEN))
    tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1="other", name2="jaw")
    tie.data[:5] = 0.2, -1.2, 0, 0, 0
    spec.compile()
    body = read_body(written(tmp_path, urdf(DRIVEN)))
    other = read_body(written(tmp_path, spec.to_xml(), "arm.xml"))
    assert other.joints == body.joints and other.names == body.names
    q, v, a = np.random.default_rng(0).uniform(-2, 2, (3, 50, 2))
    told = body.torque(q, v, a) @ body.values
    assert np.abs(other.torque(q, v, a) @ other.values - told).max() < 1e-6 * np.abs(told).max()


AXIS = """<robot name="axis"><link name="base"/><link name="carriage"><inertial><mass value="95"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="screw" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="500" velocity="1"/></joint></robot>"""


def test_gravity_of_mjcf_is_that_of_the_file(tmp_path):
    spec = mujoco.MjSpec.from_string(urdf(TORSO[:3]))
    spec.option.gravity = [0.5, 3.0, -9.0]
    model = spec.compile()
    body, data = read_body(written(tmp_path, spec.to_xml(), "arm.xml")), mujoco.MjData(model)
    data.qpos[:] = q = np.linspace(-0.4, 0.5, model.nq)
    mujoco.mj_forward(model, data)
    still = np.zeros((1, len(body.joints)))
    assert body.torque(q[None], still, still)[0] @ body.values == pytest.approx(data.qfrc_bias, abs=1e-4)
    with pytest.raises(BodyError, match=r"gravity of <option> '0\.5 3': give 3 numbers"):
        read_body(written(tmp_path, spec.to_xml().replace("0.5 3 -9", "0.5 3"), "arm.xml"))


def test_a_joint_that_slides_is_said_in_metres_and_newtons(tmp_path):
    body = read_body(written(tmp_path, urdf(TORSO)), joints=moving(TORSO), rotors=True)
    assert body.is_prismatic == (True, False, False)
    assert body.get_unit("rotor@torso") == "kg"
    units = {column.name: column.unit for term in friction(body) for column in term.columns}
    assert units["viscous@torso"] == "N s/m" and units["coulomb@torso"] == "N"
    assert units["viscous@elbow"] == "N m s/rad" and units["coulomb@elbow"] == "N m"
    total = sum(own.mass for own in TORSO)
    assert body.mass_matrix(np.zeros((1, 3)), body.values)[0, 0, 0] == pytest.approx(total)


def test_what_comes_again_with_each_turn_is_not_offered_where_a_joint_slides(tmp_path):
    body = read_body(written(tmp_path, urdf(TORSO)), joints=moving(TORSO))
    offered = {kind.id for kind in place_effects(list_joint_effects().values(), body)}
    assert {"spring@torso", "stribeck@torso", "cogging@elbow"} <= offered
    assert not {"cogging@torso", "torque_ripple@torso", "position_dependent_friction@torso"} & offered
    assert {kind.at for kind in list_couplings(body)} == {"shoulder,elbow", "shoulder,-elbow"}
    assert {kind.id for kind in list_couplings(body)} <= offered
    assert {id for id in offered if id.startswith("rotor")} == {"rotor@torso", "rotor@elbow"}  # others are the links'
    links = Links(body)
    assert [links.list_angle_functions(joint) for joint in body.joints] == [("one",), ("sine", "cosine"), ()]
    table = (
        find_kind("torque_by_angle@torso", body).with_extent(Extent(-0.3, 0.3, 6))().without_known_functions([links])
    )
    assert {column.unit for column in table.columns} == {"N"}
    curve = table.curve(np.arange(1.0, 7.0))
    assert np.trapezoid(curve.value, curve.x) == pytest.approx(0.0, abs=1e-3)  # a weight is the links'
    for text in ("cogging@torso", "coupling@torso,shoulder"):
        with pytest.raises(ValueError, match="is of joints that turn: it cannot be at 'torso', which slides"):
            find_kind(text, body)
    with pytest.raises(ValueError, match="should name two joints, such as coupling@torso,elbow"):
        find_kind("coupling@-shoulder,elbow", body)
    with pytest.raises(ValueError, match="coupling is nothing that the simulator here has: leave it out"):
        parse_effect("coupling@shoulder,elbow", body.joints)
    with pytest.raises(ValueError, match="rotor at 'shoulder' is part of the link parameters"):
        find_kind("rotor@shoulder", body)
    units = {shape.name: shape.unit for shape in find_kind("stribeck@torso", body).nonlinear_parameters}
    assert units["stribeck_velocity"] == "m/s"


def test_a_single_axis_that_slides_is_a_mass(tmp_path):
    body = read_body(written(tmp_path, AXIS))
    q, v, a = np.random.default_rng(0).normal(size=(3, 20, 1))
    assert body.joints == ("screw",) and [own.unit for own in body.base] == ["kg"]
    assert body.torque(q, v, a) @ body.values == pytest.approx(95 * a)
    assert body.mass_matrix(q, body.values) == pytest.approx(np.full((20, 1, 1), 95.0))


TWO = TwoLink().urdf()


def floating(text):
    return text.replace('type="revolute"', 'type="floating"', 1)


@pytest.mark.parametrize(
    ("text", "asked", "told"),
    [
        (urdf(PARALLEL), {"joints": ["shoulder", "elbo"]}, "unknown joint 'elbo': did you mean elbow"),
        (urdf(PARALLEL), {"joints": ["shoulder", "right"]}, "'right' mimics 'left': name that one"),
        (urdf(PARALLEL).replace('joint="left" m', 'joint="right" m'), {}, "'right' mimics itself in a loop"),
        (urdf(PARALLEL).replace('joint="left" m', 'joint="none" m'), {}, "'right' mimics 'none', which is no joint"),
        (urdf(PARALLEL).replace('multiplier="1.0"', 'multiplier="one"'), {}, "mimics another by 'one 0.0': give 2 num"),
        (floating(urdf(PARALLEL)), {}, "'shoulder' lets the base float: give --bolted"),
        ("<mujoco><include file='arm.xml'/></mujoco>", {}, "<include>, which is not followed: write all of it"),
        ("<mujoco><worldbody><body name='a'><replicate><body/></replicate></body></worldbody></mujoco>", {}, "<replic"),
        ("<?xml version='1.0' encoding='UTF-7'?><robot/>", {}, "is no XML .*encodings are not supported"),
        ("<mujoco><asset><hfield/></asset><worldbody/></mujoco>", {}, "read it: hfields are not supported yet$"),
        (urdf(PARALLEL).replace('type="revolute"', 'type="planar"', 1), {}, "'shoulder' is Planar: .*--joints A,B,C"),
        (TWO.replace('child link="upper"', 'child link="fore"'), {}, "'fore' hangs on two joints: closed"),
        (TWO.replace('name="elbow"', 'name="el,bow"'), {}, "joint 'el,bow': rename it"),
        (TWO.replace("robot", "car"), {}, "holds <car>, neither"),
        (TWO.replace('type="continuous"', 'type="fixed"'), {}, "has no joint that moves"),
        (chain(2, "1e200 0 0"), {}, r"holds a number beyond 1e\+09"),
        (chain(2).replace('"0 0.02 -0.3"', '"0 nan 0"'), {}, "holds a number beyond|cannot read it"),
        (chain(2).replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'), {}, "has a joint without an axis"),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence_and_nothing_else(tmp_path, capfd, text, asked, told):
    with pytest.raises(BodyError, match=f"arm.urdf: .*{told}") as error:
        read_body(written(tmp_path, text), **asked)
    assert "\n" not in str(error.value) and capfd.readouterr() == ("", "")


def test_a_base_that_is_bolted_down_is_held_and_so_is_one_that_is_no_joint_of_ours(tmp_path):
    text = urdf(PARALLEL)
    body = read_body(written(tmp_path, floating(text)), bolted=True)
    assert body.joints == ("elbow", "left") and body.held == {"shoulder": 0.0}
    body = read_body(written(tmp_path, text.replace('type="revolute"', 'type="planar"', 1)), joints=["elbow"])
    assert body.joints == ("elbow",) and body.held == {"shoulder": 0.0, "left": 0.0, "right": 0.0}
