"""What is exported moves as the model does."""

import ctypes
import subprocess
import sys
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pytest

from pendulum_env.excitation import excitation
from pendulum_env.export.actuators import Motor
from pendulum_env.physics import Column, Model, Term, effects
from pendulum_env.physics.actuation import ActuatorLag
from pendulum_env.physics.friction import TemperatureDependentFriction
from pendulum_env.physics.table import Extent, TorqueByAngle
from pendulum_env.plant import PAPER, hide, paper_plant
from pendulum_env.units import JointUnits
from tests.pendulum_env.physics.test_table import KINDS, in_model
from tests.terms import Table
from tests.workbench.exported import compile_library, compute_error, load_module, needs_compiler, simulate_in_mujoco
from workbench.export import ExportError, Request, export

TORQUE = np.r_[0.0, np.where(np.arange(600) % 300 < 150, 3.0, -2.5), np.zeros(300)]  # [N m], comes to rest in the end
STIRRED = ("periodic_disturbance", "joint_flexibility")  # effects that still move the joint then
TABLE = TorqueByAngle.with_extent(Extent(-1.2, 2.1, 5, ("sine",)))
STOP = "hard_stop:hysteresis=0,damping_time=0.005"
CUBIC = "spring:degree=3,stiffness=0.3,quadratic=-0.05,cubic=0.2"


@dataclass(frozen=True)
class Magnet(Term):
    id, law, kind = "magnet", "m sin 2q */ \"(1 + q'^2)", "potential"

    @property
    def columns(self):
        return (Column("magnet.gamma", "N m", force=lambda x: np.sin(2 * x.position) / (1 + x.velocity**2)),)


def plant(*hidden: str) -> Model:
    model = paper_plant()
    for text in hidden:
        model = model.add(TABLE(), 0.1) if text == "table" else hide(model, text)
    return model


def simulated(model: Model, torque=TORQUE, position=0.2) -> np.ndarray:
    return model.simulate(1e-3, torque, position, 0.0).position


def in_python(text: str, torque=TORQUE) -> np.ndarray:
    program = load_module(text)
    state = program.start(0.2)
    path = [state.position]
    for k, value in enumerate(torque):  # Python's own numbers and NumPy's
        state = program.step(state, value if k % 2 else float(value))
        path.append(state.position)
    return np.array(path)


def in_c(text: str, folder, torque=TORQUE) -> np.ndarray:
    compiled, state = compile_library(text, folder), (ctypes.c_double * 100)()
    compiled.pendulum_start.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double]
    compiled.pendulum_step.argtypes = [ctypes.c_void_p, ctypes.c_double]
    compiled.pendulum_start(state, 0.2, 0.0)
    path = [state[1]]
    for value in torque.tolist():
        compiled.pendulum_step(state, value)
        path.append(state[1])
    return np.array(path)


HIDDEN = [None, *effects(), "torque_saturation:limit=2,roundness=0.2", CUBIC, "table", *KINDS[1:], "magnet"]


@pytest.mark.parametrize("hidden", HIDDEN)
def test_python_is_the_simulators_own_step(hidden):
    if hidden == "magnet":  # an effect of a user's own
        model = paper_plant().add(Magnet(), [0.4])
    else:
        model = in_model(hidden) if hidden in KINDS[1:] else plant(*filter(None, [hidden]))
    path = in_python(export(model, "python").content)
    np.testing.assert_allclose(path, simulated(model)[:, 0], rtol=0, atol=1e-12)
    if isinstance(hidden, str | None) and hidden not in STIRRED:
        assert path[-1] == path[-2]  # dry friction holds it, exactly


@pytest.mark.parametrize("hidden", [*effects(), "dead_time=0.0043", CUBIC])
def test_python_steps_a_batch_as_it_steps_each(hidden):
    program = load_module(export(plant(hidden), "python").content)
    position, velocity = np.array([[0.2, -3.0, 0.0, 0.4], [0.0, 5.0, -1.0, 0.0]])
    batch = program.start(position, velocity)
    singles = [program.start(*each) for each in zip(position.tolist(), velocity.tolist(), strict=True)]
    for value in TORQUE[:500]:
        torque = value * np.array([1.0, -1.0, 0.1, 2.0])  # the third sticks
        batch = program.step(batch, torque)
        singles = [program.step(*each) for each in zip(singles, torque.tolist(), strict=True)]
    assert np.ptp(batch.position) > 0.1
    for name, values in batch._asdict().items():
        one_by_one = np.array([getattr(state, name) for state in singles]).T
        np.testing.assert_allclose(np.broadcast_to(values, one_by_one.shape), one_by_one, rtol=1e-9, atol=1e-12)


def test_python_needs_no_numpy_for_numbers(tmp_path, run_command):
    plant("stribeck", "dead_time=0.0043").save(tmp_path / "model.json")
    (tmp_path / "arm.py").write_text(run_command("export", tmp_path / "model.json", "--to", "python"))
    code = "import arm, sys; arm.step(arm.start(0.1), 2.5); print('numpy' in sys.modules)"
    run_command = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert run_command.stdout.split() == ["False"]


@needs_compiler
def test_c_compiles_without_a_warning_and_equals_python(tmp_path):
    memories = plant("stribeck", "cogging", "presliding", "backlash", "actuator_lag", "dead_time=0.0043", "hard_stop")
    others = [id for id in effects() if id not in {*memories.effects, "joint_flexibility"}]
    for k, model in enumerate((plant(), memories, plant("joint_flexibility", *others))):
        paths = [in_python(export(model, "python").content), in_c(export(model, "c").content, tmp_path / str(k))]
        np.testing.assert_allclose(*paths, rtol=0, atol=1e-12)


@needs_compiler
def test_friction_by_temperature_takes_the_temperature_as_an_input(tmp_path):
    """Friction of the plant itself is what it is at 25 deg C, and at any other temperature that of another plant."""
    law = TemperatureDependentFriction()
    model = paper_plant()
    exported = {language: export(model.add(law, [-0.002, 0.005]), language).content for language in ("python", "c")}
    program, compiled, state = (
        load_module(exported["python"]),
        compile_library(exported["c"], tmp_path),
        (ctypes.c_double * 9)(),
    )
    compiled.pendulum_start.argtypes = [ctypes.c_void_p] + 2 * [ctypes.c_double]
    compiled.pendulum_step.argtypes = [ctypes.c_void_p] + 2 * [ctypes.c_double]
    values = {name: known.value for name, known in model.estimates.items()}
    for warm in (25.0, 60.0):
        other = values | {"viscous": values["viscous"] - 0.002 * (warm - 25.0)}
        other["coulomb"] += 0.005 * (warm - 25.0)
        path = simulated(Model.build(model.terms, [*other.values()]))[:, 0]
        now = program.start(0.2)
        compiled.pendulum_start(state, 0.2, 0.0)
        for torque, position in zip(TORQUE, path[1:], strict=True):
            now = program.step(now, torque, *([] if warm == 25.0 else [warm]))
            compiled.pendulum_step(state, torque, warm)
            assert (now.position, state[1]) == pytest.approx((position, position), abs=1e-12)


MUJOCO = {  # effects that a model for MuJoCo holds
    "base": (),
    "spring": ("spring",),
    "stop": (STOP,),
    "one elastic stop": ("hard_stop:upper=0.9,lower=-inf,hysteresis=0",),
    "lag and delay": ("actuator_lag", "dead_time"),
    "tilt, offset and drag": ("gravity_tilt", "torque_offset", "quadratic_drag"),
    "flexibility": ("joint_flexibility",),
}


@pytest.mark.parametrize("name", MUJOCO)
def test_mujoco_moves_the_exported_model_as_this_simulator_does(name):
    hidden = MUJOCO[name]
    exported = export(plant(*hidden), "mjcf")
    assert not exported.notes
    torque = np.r_[0.0, excitation("paper", np.random.default_rng(0)).signal(np.arange(6000) / 1000)]
    assert compute_error(simulate_in_mujoco(exported, torque), simulated(plant(*hidden), torque, 0.0)[:, 0]) < 0.002


def test_friction_of_a_link_which_acts_at_the_motor_is_an_approximation():
    rubbing = plant("joint_flexibility:viscous=2")
    with pytest.raises(ExportError):
        export(rubbing, "mjcf")
    assert export(rubbing, "mjcf", Request(approximate=True)).notes


def test_friction_that_stands_in_for_a_law_of_speed_is_closest_to_it():
    pytest.importorskip("mujoco")
    text = export(plant("stribeck", "viscous_asymmetry"), "mjcf", Request(approximate=True)).content
    joint = ElementTree.fromstring(text).find(".//joint")
    speed = np.linspace(0.05, 5.0, 100)
    law = PAPER["coulomb"] + PAPER["viscous"] * speed + 0.45 * np.exp(-((speed / 0.5) ** 2))
    viscous, dry = np.polyfit(speed, law, 1)
    assert float(joint.get("damping")) == pytest.approx(viscous, rel=1e-4)
    assert float(joint.get("frictionloss")) == pytest.approx(dry, rel=1e-4)


def test_a_known_mass_moves_the_centre_and_a_known_armature_is_part_of_the_inertia():
    mujoco = pytest.importorskip("mujoco")
    text = export(plant(), "mjcf", Request(mass=0.8)).content
    inertial = ElementTree.fromstring(text).find(".//inertial")
    lever = -float(inertial.get("pos").split()[2])
    assert 0.8 * 9.81 * lever == pytest.approx(PAPER["gravity"], rel=1e-4)
    about = float(inertial.get("diaginertia").split()[0])
    assert about + 0.8 * lever**2 == pytest.approx(PAPER["inertia"], rel=1e-4)
    text = export(plant(), "mjcf", Request(armature=0.03)).content
    world = mujoco.MjModel.from_xml_string(text)
    assert (world.dof_armature[0], world.dof_M0[0]) == pytest.approx((0.03, PAPER["inertia"]), rel=1e-5)


REFUSED = {
    "a torque in A: masses and inertias are those per A": (
        paper_plant().convert_units(JointUnits("A")),
        "mjcf",
        Request(),
    ),
    "a law of this model cannot be written down": (paper_plant().add(Table(), [0.4]), "c", Request()),
    "the hysteresis of hard_stop": (plant("hard_stop"), "mjcf", Request()),
    "--mass has to be above 0.46": (plant(), "mjcf", Request(mass=0.4)),
    "leaves the pendulum no inertia": (plant(), "mjcf", Request(armature=0.1)),
    "mjcf cannot hold spring": (plant(CUBIC), "mjcf", Request()),
}


@pytest.mark.parametrize("why", REFUSED)
def test_what_a_format_does_not_hold_is_refused_in_a_sentence(why):
    model, format, request = REFUSED[why]
    if format == "mjcf":
        pytest.importorskip("mujoco")
    with pytest.raises(ExportError, match=why):
        export(model, format, request)


def test_the_command_writes_and_checks(tmp_path, run_command):
    pytest.importorskip("mujoco")
    model, run, out = (tmp_path / name for name in ("model.json", "run.csv", "model.xml"))
    plant("actuator_lag", "dead_time=0.0043").save(model)
    hidden = ("--effect", "actuator_lag", "--effect", "dead_time=0.0043")
    run_command("record", "--seconds", 6, "--seed", 1, "-o", run, *hidden)
    said = run_command("export", model, "--to", "mjcf", "-o", out, "--check", run)
    assert out.read_text().startswith("<mujoco") and f"wrote {out}" in said
    errors = [float(line.split()[-2]) for line in said.splitlines() if line.endswith("%")]  # of the motion, in percent
    assert len(errors) == 3 and max(errors) < 1.0


@dataclass(frozen=True)
class SlowAmplifier(ActuatorLag):
    """A user's lag of the torque."""

    id, columns = "slow_amplifier", ()


def test_a_users_lag_is_that_of_the_motor_and_a_second_lag_is_left_out():
    lagging, zero = paper_plant().add(SlowAmplifier(0.02)), paper_plant().add(ActuatorLag(0.0))
    assert "slow_amplifier" in Motor(0.001).list_held(lagging) and "actuator_lag" in Motor(0.001).list_held(zero)
    assert "actuator_lag" not in Motor(0.001).list_held(lagging.add(ActuatorLag(0.01)))
