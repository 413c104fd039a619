"""Parameters as text for other programs, and the torque that compensates a joint: both are those of the model."""

import ctypes
import json
import re
import sys
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from pendulum_env.physics import Model, Samples
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.plant import hide, paper_plant
from pendulum_env.recording import read_recording
from pendulum_env.units import JointUnits
from robots.servos import ServoDrive
from tests.workbench.exported import compile_library, load_module, needs_compiler
from workbench.export import Request, export
from workbench.export.check import check_feedforward

PLANT = {"inertia": 0.012, "gravity": 0.9, "viscous": 0.05, "coulomb": 0.08}
LOADED = "load_dependent_friction:load_dependent_friction=0.3,output=0.2,weight=0.9"
STRIBECK = "stribeck:stribeck=0.04,stribeck_velocity=0.3"
DRIVE = ServoDrive(output="duty", kp=1.2, kd=0.02, supply=9.0, gain=0.5)
FUNCTIONS = [  # effects whose torque follows from angle, speed and motor torque
    "torque_offset", "gravity_tilt", "coulomb_asymmetry", "viscous_asymmetry", STRIBECK, "quadratic_drag", LOADED,
    "position_dependent_friction", "cogging", "torque_ripple", "spring", "back-EMF",
]  # fmt: skip
OTHERS = [
    "backlash",
    "joint_flexibility",
    "presliding",
    "hard_stop",
    "periodic_disturbance",
    "dead_time",
    "actuator_lag",
]
rng = np.random.default_rng(87)
Q, V = rng.uniform(-7.0, 7.0, 300), rng.uniform(-4.0, 4.0, 300)


def joint(*hidden: str) -> Model:
    model = paper_plant(PLANT)
    for text in hidden:
        model = model.add(BackEmf(), [0.05]) if text == "back-EMF" else hide(model, text)
    return model


def section(text: str, title: str) -> str:
    """The lines below the title of a section."""
    return text.split(f"== {title}")[1].split("==\n", 1)[1].split("\n\n")[0]


@pytest.mark.parametrize("effect", FUNCTIONS)
def test_the_feedforward_is_the_torque_of_the_model_at_constant_speed(effect):
    model = joint(effect)
    program = load_module(export(model, "feedforward", Request(language="python")).content)
    torque = program.feedforward(Q, V, np.sign(V))
    x = Samples(np.zeros_like(Q), Q, V, torque, {BackEmf.id: (np.ones(()),)})
    np.testing.assert_allclose(torque, model.torque(x, 0.0), atol=1e-12)
    bare = model.torque(Samples(0 * Q, Q, 0 * V, 0 * Q), 0.0)
    assert np.ptp(torque - bare) > 1e-3


@needs_compiler
def test_c_and_python_give_the_same_torque_and_tables(tmp_path):
    model = joint(*FUNCTIONS[:-4], "cogging", "back-EMF", *OTHERS[:1])
    written, program = (
        export(model, "feedforward"),
        load_module(export(model, "feedforward", Request(language="python")).content),
    )
    compiled = compile_library(written.content, tmp_path)
    for name, count in (("feedforward", 3), ("feedforward_weight", 1)):
        getattr(compiled, name).restype, getattr(compiled, name).argtypes = ctypes.c_double, [ctypes.c_double] * count
    found = [compiled.feedforward(q, v, np.sign(v)) for q, v in zip(Q, V, strict=True)]
    np.testing.assert_allclose(found, program.feedforward(Q, V, np.sign(V)), atol=1e-12)
    table = np.array((ctypes.c_float * 768).in_dll(compiled, "feedforward_by_angle")).reshape(256, 3)
    for column, way in ((1, 1.0), (2, -1.0)):
        alone = [compiled.feedforward(q, 0.0, way) - compiled.feedforward_weight(q) for q in table[:, 0]]
        np.testing.assert_allclose(table[:, column], alone, atol=1e-5)
    np.testing.assert_allclose(np.array(program.feedforward_by_angle), table, atol=1e-6)
    assert len(written.notes) == 1 and "backlash" in written.notes[0]


@pytest.mark.parametrize("effect", OTHERS)
def test_other_effects_are_named_as_not_compensated(effect):
    model = joint(effect)
    written = export(model, "feedforward", Request(language="python"))
    assert len(written.notes) == 1 and effect in written.notes[0] and effect in written.content
    known = load_module(export(joint(), "feedforward", Request(language="python")).content)
    np.testing.assert_allclose(load_module(written.content).feedforward(Q, V, 1.0), known.feedforward(Q, V, 1.0))


def test_the_remaining_error_is_that_of_draws_from_the_covariance():
    terms, theta = joint("cogging").terms, joint("cogging").theta
    std = np.array([0.001, 0.03, 0.004, 0.01, 0.02, 0.015])
    covariance = np.diag(std**2)
    covariance[1, 3] = covariance[3, 1] = 0.8 * std[1] * std[3]
    model = Model.build(terms, theta, std)
    names = [column.name for column in model.columns]
    model = model.with_covariance(names, covariance)
    text = export(model, "feedforward").content
    told = float(re.search(r"- ([\d.]+) N m RMS", text)[1])
    q, v = np.random.default_rng(1).uniform(-np.pi, np.pi, 400), np.random.default_rng(2).uniform(-5, 5, 400)
    x = Samples(0 * q, q, v, 0 * q)
    draws = np.random.default_rng(3).multivariate_normal(theta, covariance, 400)
    errors = [Model.build(terms, draw).torque(x, 0.0) - model.torque(x, 0.0) for draw in draws]
    assert told == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=0.1)


def test_text_for_mujoco_is_read_by_mujoco():
    mujoco = pytest.importorskip("mujoco")
    mjcf = section(export(joint(), "snippet", Request(drive=DRIVE)).content, "MJCF")
    world = mujoco.MjModel.from_xml_string(
        f"<mujoco><default>{mjcf}</default><worldbody><body childclass='joint'><inertial pos='0 0 0' mass='1' "
        "diaginertia='1 1 1'/><joint name='it'/></body></worldbody>"
        "<actuator><position joint='it' class='joint'/></actuator></mujoco>"
    )
    read = (world.dof_armature[0], world.dof_damping[0], world.dof_frictionloss[0])
    np.testing.assert_allclose(read, (0.012, 0.05, 0.08), rtol=1e-8)
    stiffness, damping = 1.2 * 9.0 * 0.5, 0.02 * 9.0 * 0.5
    assert world.actuator_gainprm[0][0] == pytest.approx(stiffness, rel=1e-8)
    np.testing.assert_allclose(world.actuator_biasprm[0][:3], (0.0, -stiffness, -damping), rtol=1e-8)
    np.testing.assert_allclose(world.actuator_forcerange[0], (-4.5, 4.5), rtol=1e-8)


def test_urdf_and_configurations_have_the_same_numbers(monkeypatch):
    text = export(joint("stribeck"), "snippet", Request(drive=DRIVE, armature=0.004)).content
    urdf = ElementTree.fromstring(section(text, "URDF").split("<!--")[0]).attrib
    viscous, dry = (float(urdf[name]) for name in ("damping", "friction"))
    assert dry > 0.08  # Stribeck friction is in it, as far as possible
    servo = {"stiffness": 5.4, "damping": 0.09, "armature": 0.004}
    expected = {
        "mjlab": servo | {"effort_limit": 4.5, "frictionloss": dry, "viscous_damping": viscous},
        "isaaclab": servo
        | {"effort_limit_sim": 4.5, "friction": dry, "dynamic_friction": dry, "viscous_friction": viscous},
    }
    for name, kind in (("mjlab", "BuiltinPositionActuatorCfg"), ("isaaclab", "ImplicitActuatorCfg")):
        module = f"{name}.actuator" + "s" * (name == "isaaclab")
        monkeypatch.setitem(sys.modules, name, SimpleNamespace())
        monkeypatch.setitem(sys.modules, module, SimpleNamespace(**{kind: dict}))
        settings = load_module(section(text, "mjlab" if name == "mjlab" else "Isaac Lab 2")).ACTUATOR
        assert {key: settings[key] for key in expected[name]} == pytest.approx(expected[name], rel=1e-8)


def test_a_motor_of_mjlab_has_the_limit_that_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "mjlab", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "mjlab.actuator", SimpleNamespace(BuiltinMotorActuatorCfg=dict))
    text = export(joint(), "snippet").content
    assert load_module(section(text, "mjlab")).ACTUATOR["effort_limit"] > 1e3


def test_bam_has_the_friction_and_the_motor_of_the_model():
    model = joint(STRIBECK, LOADED, "back-EMF")
    bam = SimpleNamespace(**json.loads(section(export(model, "snippet", Request(drive=DRIVE)).content, "BAM")))
    assert (bam.model, bam.kt / bam.R, bam.kt**2 / bam.R) == ("m5", pytest.approx(0.5), pytest.approx(0.05))
    speed, motor = np.abs(V) + 0.01, 0.9 * np.sin(Q)  # the motor holds the load
    near_rest = np.exp(-((speed / bam.dtheta_stribeck) ** bam.alpha))
    load = np.abs(-motor * bam.load_friction_external - motor * bam.load_friction_motor)
    friction = bam.friction_base + load + near_rest * bam.friction_stribeck + bam.friction_viscous * speed
    x = Samples(0 * Q, Q, speed, motor, {BackEmf.id: (np.zeros(()),)})
    weight = joint().estimates["gravity"].value * np.sin(Q)
    np.testing.assert_allclose(friction, model.torque(x, 0.0) - weight, atol=1e-12)


def test_losses_tell_their_size():
    model = joint("cogging:order=12,sin=0.03,cos=0.04", LOADED, "backlash")
    text = export(model, "snippet").content
    lost = text.split("== URDF")[0]
    assert re.search(r"cogging .*up to 0\.05 N m", lost) and "backlash.gap" in lost
    assert re.search(r"load_dependent_friction .*up to 0\.45 N m", lost)  # (0.3 + 0.2) of the weight
    assert "load_dependent_friction" in text and "cogging" in text.split("Lost in BAM")[1]
    error = re.search(r"stribeck .*within ([\d.]+) N m", export(joint(STRIBECK), "snippet").content)
    assert 0 < float(error[1]) < 0.04


def test_the_check_tells_the_torque_that_the_feedforward_leaves(tmp_path, run_command):
    run_command("record", "--effect", "cogging:order=12,sin=0.3,cos=0.4", "--seconds", "10", "-o", tmp_path / "run.csv")
    recordings = [read_recording(tmp_path / "run.csv")]
    for model, low, high in (
        (paper_plant(), 0.3, 0.5),
        (hide(paper_plant(), "cogging:order=12,sin=0.3,cos=0.4"), 0, 0.02),
    ):
        before, after = check_feedforward(model, recordings).errors.values()
        assert low <= after <= high < before  # cogging has 0.35 N m RMS


@needs_compiler
def test_a_saturated_motor_has_a_limit_where_it_cannot_hold_the_weight(tmp_path):
    model, limit = joint("torque_saturation:limit=0.8"), 0.8
    written, other = (export(model, "feedforward", Request(language=kind)) for kind in ("python", "c"))
    compiled = compile_library(other.content, tmp_path).feedforward
    compiled.restype, compiled.argtypes = ctypes.c_double, [ctypes.c_double] * 3
    torque = load_module(written.content).feedforward(Q, 0.0 * Q, 1.0 + 0.0 * Q)
    np.testing.assert_allclose([compiled(q, 0.0, 1.0) for q in Q], torque, atol=1e-12)
    needed = 0.9 * np.sin(Q) + 0.08
    assert np.abs(torque).max() < 3.0 * limit  # where no torque is enough
    is_easy = np.abs(needed) < 0.8 * limit
    np.testing.assert_allclose(limit * np.tanh(torque[is_easy] / limit), needed[is_easy], atol=1e-3)
    low, high = map(float, re.search(r", ([\d.]+) to ([\d.]+) rad", written.notes[0]).groups())
    assert 0.5 < low < np.arcsin(0.8) and np.pi / 2 < high < np.pi
    strong = export(joint("torque_saturation:limit=3"), "feedforward", Request(language="python"))
    assert not strong.notes and abs(load_module(strong.content).feedforward(1.0, 500.0, 1.0)) < 9.0


@pytest.mark.parametrize("format_name", ["snippet", "feedforward"])
def test_units_are_those_of_the_joint(format_name):
    for units, expected, foreign in (
        (JointUnits(is_prismatic=True), " m/s" if format_name == "feedforward" else " N s/m,", "rad"),
        (JointUnits("A"), " A", "N m"),
    ):
        model = joint("stribeck").convert_units(units)
        text = export(model, format_name).content.split("== mjlab")[0]
        words = [line for line in text.splitlines() if not re.search("BAM|[Ll]inks", line)]
        assert expected in text and not [line for line in words if re.search(rf"\b{foreign}\b", line)]
