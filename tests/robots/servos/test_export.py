"""A servo that is exported moves as the model does in the loop: as a program, and in MuJoCo."""

from dataclasses import replace

import numpy as np
import pytest

from pendulum_env.physics import Estimate, KnownLoad, Model
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.plant import hide, paper_plant
from robots.servos import ServoDrive
from robots.servos.loop import Servos, simulate_servos
from tests.workbench.exported import compute_error, load_module, simulate_in_mujoco
from workbench.export import ExportError, Request, export

STEP, COUNT = 1e-3, 3000
TIME = STEP * np.arange(COUNT)
GOAL = 0.8 * np.sin(2.0 * TIME) + 0.6 * np.sin(4.7 * TIME)
ON = np.where((TIME > 1.2) & (TIME < 1.5), 0.0, 1.0)
PLANT = {"inertia": 0.012, "gravity": 0.9, "viscous": 0.05, "coulomb": 0.08}
DRIVES = {
    "position": ServoDrive(output="torque", kp=6.0, limit=4.0),
    "damped, at a rate": ServoDrive(output="torque", kp=2.5, kd=0.03, limit=4.0, rate=300.0),
    "derivative of the error, at a rate": ServoDrive(
        output="torque", kp=2.5, kd=0.03, limit=4.0, rate=300.0, cutoff=40.0, derivative="error"
    ),
    "derivative of the error": ServoDrive(output="torque", kp=2.5, kd=0.03, limit=4.0, derivative="error"),
    "duty, late": ServoDrive(output="duty", kp=1.2, supply=9.0, gain=0.5, delay=0.0034),
    "voltage, integral": ServoDrive(output="voltage", kp=5.0, ki=8.0, limit=6.0, gain=0.8),
    "clamped integral": ServoDrive(
        output="torque", kp=2.0, ki=8.0, limit=1.2, rate=500.0, windup="clamp", integral="before"
    ),
    "speed": ServoDrive(control="velocity", output="torque", kp=0.4, ki=3.0, limit=3.0, rate=500.0, cutoff=60.0),
}


def joint(*hidden: str) -> Model:
    model = paper_plant(PLANT)
    for text in hidden:
        model = model.add(BackEmf(), [0.05]) if text == "back-EMF" else hide(model, text)
    return model


def in_the_loop(model: Model, drive: ServoDrive) -> np.ndarray:
    """Position from one second of rest on (N + 1,), by this project's simulation."""
    volts = drive.supply or 1.0
    servos = Servos(
        (drive,), STEP, GOAL[:, None], np.full((COUNT, 1), volts), ON[:, None], *np.zeros((3, 1)), KnownLoad()
    )
    return simulate_servos(model.terms, model.theta[:, None], servos)[:, 0, 0]


def in_python(model: Model, drive: ServoDrive) -> np.ndarray:
    """The same by the program that is exported."""
    program = load_module(export(model, "python", Request(drive=drive)).content)
    state, path = program.start(), [0.0]
    for goal, on in zip(GOAL.tolist(), ON.tolist(), strict=True):
        state = program.step(state, goal, on=on)
        path.append(state.position)
    return np.array(path)


@pytest.mark.parametrize("name", DRIVES)
def test_a_program_of_a_servo_is_the_simulator_in_the_loop(name):
    model = joint("load_dependent_friction:load_dependent_friction=0.1,output=0.2,weight=0.9", "back-EMF")
    np.testing.assert_allclose(in_python(model, DRIVES[name]), in_the_loop(model, DRIVES[name]), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["position", "speed"])
def test_mujoco_s_own_servo_moves_a_joint_without_effects_alike(name):
    drive, model = replace(DRIVES[name], ki=0.0, rate=None, cutoff=None), joint("gravity_tilt=0.05")
    exported = export(model, "mjcf", Request(drive=drive))
    assert exported.notes == ()
    assert compute_error(simulate_in_mujoco(exported, GOAL, ON), in_the_loop(model, drive)) < 0.005


def test_an_offset_of_the_torque_moves_its_limits_along():
    mujoco = pytest.importorskip("mujoco")
    drive = ServoDrive(output="torque", kp=50.0, limit=0.5)
    world = mujoco.MjModel.from_xml_string(export(joint("torque_offset=0.1"), "mjcf", Request(drive=drive)).content)
    data = mujoco.MjData(world)
    for goal, torque in ((3.0, 0.4), (0.002, 0.0), (-3.0, -0.6)):
        data.ctrl[0] = goal
        mujoco.mj_forward(world, data)
        assert data.qfrc_actuator[0] == pytest.approx(torque, abs=1e-9)


@pytest.mark.parametrize("format", ["python", "mjcf"])
def test_a_drive_is_in_the_unit_of_its_model(format):
    pytest.importorskip("mujoco")
    unknown = Request(drive=ServoDrive(output="voltage", kp=5.0, limit=6.0))
    with pytest.raises(ExportError, match="the model is in N m, but the drive gives V: give the drive its gain"):
        export(joint(), format, unknown)
    told = replace(joint(), torque_constant=Estimate(0.8, 0.01, "N m/V"))
    given = replace(unknown, drive=replace(unknown.drive, gain=0.8))
    assert export(told, format, unknown).content == export(told, format, given).content


@pytest.mark.parametrize("format", ["python", "mjcf"])
def test_play_between_a_drive_and_its_encoder_is_refused(format):
    drive = replace(DRIVES["position"], encoder="output")
    with pytest.raises(ExportError, match="reads the link behind the gear"):
        export(joint("joint_flexibility=0.004"), format, Request(drive=drive))
    assert export(joint(), "python", Request(drive=drive)).content


def test_what_mujoco_does_not_have_of_a_servo_is_named():
    pytest.importorskip("mujoco")
    with pytest.raises(ExportError, match=r"mjcf cannot hold .*\(ki\).*; nor a controller at 500 Hz.*cutoff"):
        export(joint(), "mjcf", Request(drive=DRIVES["speed"]))
    with pytest.raises(ExportError, match="a derivative of the goal"):
        export(joint(), "mjcf", Request(drive=DRIVES["derivative of the error"]))
    noted = export(joint("stribeck"), "mjcf", Request(approximate=True, drive=DRIVES["speed"])).notes
    assert len(noted) == 4 and "stribeck" in noted[0]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A model of a servo whose gears rub more under load, and a study of it."""
    folder = tmp_path_factory.mktemp("servo")
    model = joint("load_dependent_friction:load_dependent_friction=0.1,output=0.3,weight=0.9")
    model.save(folder / "servo.json")
    drive = ServoDrive(output="torque", kp=5.0, limit=4.0)
    path = in_the_loop(model, drive)[:-1]
    rows = np.column_stack([TIME, path, GOAL, ON])[::4]
    np.savetxt(folder / "run.csv", rows, delimiter=",", header="time,position,goal,enabled", comments="", fmt="%.7f")
    study = '[drive]\noutput = "torque"\nlimit = 4.0\n[[recording]]\nfile = "run.csv"\ndrive = {kp = 5.0}\n'
    (folder / "study.toml").write_text(study)
    return folder


def test_an_export_proves_itself_in_the_loop(recorded, run_command, run_refused):
    pytest.importorskip("mujoco")
    asked = ["export", str(recorded / "servo.json"), "--to", "mjcf", "--drive", "output=torque,kp=5,limit=4"]
    said = run_command(*asked, "--approximate", "-o", recorded / "servo.xml", "--check", recorded / "study.toml")
    own, exported = (float(line.split()[-2]) for line in said.splitlines() if line.endswith("%"))
    assert own < 0.5 < exported < 10.0  # per cent of the motion: MuJoCo's gears rub as much under any load
    assert "<mujoco" in (recorded / "servo.xml").read_text()
    told = run_refused(*asked, "--step", "0.003", "--approximate", "--check", recorded / "study.toml")
    assert "--step should be a whole part of it" in told
