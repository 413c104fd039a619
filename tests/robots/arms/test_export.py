"""An arm's model in other programs: MuJoCo feels the torques that the model says."""

from xml.etree import ElementTree

import numpy as np
import pytest

from benchmarks import six_joint
from benchmarks.two_link import TwoLink
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.joints import choose_coupling
from pendulum_env.physics.potential import Spring
from robots.arms import ArmModel, arm_base, place_effect, read_body
from tests import robot_files
from tests.workbench.exported import load_module
from workbench.cli import main
from workbench.export import Request, export

mujoco = pytest.importorskip("mujoco")


def model_of(path, text, *more, rotors=None):
    """A model with the file's links, friction that grows from joint to joint, and one of each effect."""
    path.write_text(text)
    body = read_body(path, rotors=rotors)
    terms = (*arm_base(body), *(kind(body)() for kind in more))
    standard = body.standard_values
    if rotors:
        standard[-len(body.joints) :] = six_joint.ROTORS[:6]
    theta = np.concatenate([body.combine @ standard, 0.2 + 0.1 * np.arange(sum(len(t.columns) for t in terms[1:]))])
    return ArmModel.build(terms, theta, 1e-4 * np.abs(theta) + 1e-6)


def torques(world, body, q, v, a):
    """What MuJoCo asks of the joints' motors; dry friction is left out, as its constraint is of the solver's."""
    world.dof_frictionloss[:] = 0.0
    if world.ntendon:
        world.tendon_frictionloss[:] = 0.0
    data, joints = mujoco.MjData(world), [int(world.joint(at).dofadr[0]) for at in body.joints]
    links = [int(world.joint(at).dofadr[0]) for at in body.links]
    found = []
    for here, speed, growth in zip(q, v, a, strict=True):
        data.qpos[links], data.qvel[links] = body.ratios @ here + body.offsets, body.ratios @ speed
        data.qacc[links] = body.ratios @ growth
        world.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        mujoco.mj_inverse(world, data)
        felt = np.array(data.qfrc_inverse)
        found.append(body.ratios.T @ felt[links])
    assert len(joints) == world.nu
    return np.array(found)


@pytest.fixture
def files(tmp_path):
    """Names of an arm's file, of a model, and of what is exported."""
    return tuple(str(tmp_path / name) for name in ("arm.urdf", "model.json", "new.xml"))


def told(model, q, v, a, beside=()):
    """The model's own torques without dry friction."""
    body = model.body
    viscous = np.array([model.estimates[f"viscous@{at}"].value for at in body.joints])
    links = body.torque(q, v, a) @ model.theta[: len(body.base)]
    return links + viscous * v + sum(beside, np.zeros_like(q))


@pytest.mark.parametrize("robot", ["six", "torso", "driven"])
def test_mujoco_feels_the_torque_of_the_model(tmp_path, files, robot):
    path, saved, xml = files
    more = ()
    if robot == "six":
        more = (lambda body: place_effect(Spring, "elbow"), lambda body: choose_coupling("pitch,flange", body))
    text = six_joint.urdf() if robot == "six" else robot_files.urdf(getattr(robot_files, robot.upper()))
    model = model_of(tmp_path / "arm.urdf", text, *more, rotors=robot == "six" or None)
    model.save(saved)
    assert main(["export", saved, "--robot", path, "--to", "mjcf", "-o", xml]) == 0
    body = model.body
    q, v, a = np.random.default_rng(0).uniform(-1, 1, (3, 20, len(body.joints)))
    beside = []
    if robot == "six":
        k, m, n = (body.joints.index(joint) for joint in ("elbow", "pitch", "flange"))
        spring, motor = np.zeros_like(q), np.zeros_like(q)
        stiffness, preload = (model.estimates[f"spring.{name}@elbow"].value for name in ("stiffness", "preload"))
        spring[:, k] = stiffness * q[:, k] + preload
        inertia, viscous = (model.estimates[f"coupling.{name}@pitch,flange"].value for name in ("inertia", "viscous"))
        motor[:, m] = motor[:, n] = inertia * (a[:, m] + a[:, n]) + viscous * (v[:, m] + v[:, n])
        beside = [spring, motor]
    world = mujoco.MjModel.from_xml_path(xml)
    dry = [world.dof_frictionloss[world.joint(at).dofadr[0]] for at in body.joints]
    assert dry == pytest.approx([model.estimates[f"coulomb@{at}"].value for at in body.joints])
    if robot == "six":
        assert world.tendon_frictionloss == pytest.approx([model.estimates["coupling.coulomb@pitch,flange"].value])
    felt = torques(world, body, q, v, a)
    expected = told(model, q, v, a, beside)
    assert np.abs(felt - expected).max() < 1e-4 * np.abs(expected).max()


def test_what_mujoco_does_not_have_is_named_with_its_joint(tmp_path, files, run_refused):
    path, saved, new = files
    text = robot_files.urdf(robot_files.TORSO)
    model_of(tmp_path / "arm.urdf", text, lambda body: place_effect(Stribeck, "elbow")).save(saved)
    asked = ["export", saved, "--robot", path, "--to", "mjcf", "-o", new]
    assert "mjcf cannot hold stribeck" in (said := run_refused(*asked)) and "(at elbow)" in said
    assert main([*asked, "--approximate"]) == 0
    assert "cannot hold stribeck" in (tmp_path / "new.xml").read_text()
    assert "an arm is exported to mjcf, snippet or feedforward, not to c" in run_refused(
        "export", saved, "--robot", path, "--to", "c"
    )
    assert "--robot" in run_refused("export", saved, "--to", "mjcf")


def test_links_that_no_body_has_are_exported_only_as_the_nearest(tmp_path, files, run_refused):
    path, saved, new = files
    model = model_of(tmp_path / "arm.urdf", TwoLink().urdf())
    k = model.body.names.index("Iyy@elbow")
    theta = np.where(np.arange(len(model.theta)) == k, -model.theta, model.theta)
    ArmModel.build(model.terms, theta, 1e-4 * np.abs(theta) + 1e-6).save(saved)
    asked = ["export", saved, "--robot", path, "--to", "mjcf", "-o", new]
    said = run_refused(*asked)
    assert "no body has these parameters: the nearest is" in said and said.count("\n") == 1
    assert main([*asked, "--approximate"]) == 0
    assert "no body has these parameters" in (tmp_path / "new.xml").read_text()


def test_joints_of_an_arm_have_their_friction_and_rotors_as_text(tmp_path):
    model = model_of(tmp_path / "arm.urdf", six_joint.urdf(), lambda body: place_effect(Stribeck, "elbow"), rotors=True)
    value = {name: estimate.value for name, estimate in model.estimates.items()}
    text = export(model, "snippet").content
    world = mujoco.MjModel.from_xml_string(export(model, "mjcf", Request(approximate=True)).content)
    for joint in model.body.joints:
        part = text.split(f'<default class="{joint}">')[1].split("</default>")[0]
        joint_text = ElementTree.fromstring(part.split("<!--")[0]).attrib
        armature = world.dof_armature[world.joint(joint).dofadr[0]]  # MuJoCo writes six digits
        assert float(joint_text["armature"]) == pytest.approx(armature, rel=1e-5)
        if joint != "elbow":
            friction = (value[f"viscous@{joint}"], value[f"coulomb@{joint}"])
            assert (float(joint_text["damping"]), float(joint_text["frictionloss"])) == pytest.approx(friction)
    program = load_module(export(model, "feedforward", Request(language="python")).content)
    v = np.array([-2.0, -0.1, 0.1, 0.5])
    stribeck = value["stribeck@elbow"] * np.exp(-((v / model.terms[-1].stribeck_velocity) ** 2))
    expected = value["viscous@elbow"] * v + (value["coulomb@elbow"] + stribeck) * np.sign(v)
    np.testing.assert_allclose(program.elbow_feedforward(0.3, v, np.sign(v)), expected)
