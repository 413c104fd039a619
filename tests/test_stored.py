"""Files that earlier versions wrote, or that the pages show, stay readable: `stored/` has one of each kind."""

import json
from pathlib import Path

import pytest

from agents.config import Config
from pendulum_env.backends.hardware.config import load as load_rig
from pendulum_env.excitation import Multisine
from pendulum_env.physics import Model
from pendulum_env.reading import read_toml
from pendulum_env.recording.channel import Load
from pendulum_env.recording.study import Source, read_sources, write_study
from pendulum_env.robot_file import RobotOptions
from robots.arms.model import ArmModel
from robots.servos import ServoDrive
from tests.two_link import body
from workbench.runs import read_suggestion

STORED = Path(__file__).parent / "stored"


def stored_json(name):
    return json.loads((STORED / name).read_text())


def test_a_model():
    model = Model.load(STORED / "model.json")
    assert json.loads(json.dumps(model.json())) == stored_json("model.json")
    assert model.estimates["viscous"].is_biased and model.estimates["coulomb"].is_unknown
    assert model.torque_unit == "A" and model.torque_constant.value == 0.87


def test_a_model_of_an_arm():
    pytest.importorskip("pinocchio")
    model, old = (ArmModel.load(STORED / name, body()) for name in ("arm-model-2.json", "arm-model.json"))
    assert model.json() == stored_json("arm-model-2.json")
    assert (old.terms[1:], old.estimates, old.log_format) == (model.terms[1:], model.estimates, model.log_format)
    content = stored_json("arm-model.json")
    assert {name: estimate.json() for name, estimate in old.estimates.items()} == content["theta"]
    assert [(term.id, term.nonlinear_values) for term in old.terms[1:]] == [
        (f"{term['id']}@{term['joint']}", term["shape"]) for term in content["terms"]
    ]
    assert RobotOptions.read_from_model(STORED / "arm-model.json").log_format == model.log_format != {}


def test_a_diagnosis():
    suggestion = read_suggestion(str(STORED / "diagnosis.json"))
    content = stored_json("diagnosis.json")["suggestion"]
    assert suggestion.json() == {name: content[name] for name in content if name != "text"}
    assert suggestion.signal == Multisine(3.0, 0.1, (2, 9), (0.1, 2.0))


def test_a_study(tmp_path):
    first, second = read_sources(STORED / "study.toml")
    columns = {"position": "-motor_angle:deg/6", "torque": "current:A*0.091"}
    drive = ServoDrive.from_settings({"preset": "xl330", "kp": 400})
    loaded = {"load": Load(0.5 * 0.2**2, 0.5 * 9.81 * 0.2), "unwrap": True, "range": (2.0, 30.5)}
    assert first == Source(STORED / "monday.csv", columns=columns, drive=drive, joints=("shoulder",), **loaded)
    assert second.role == "holdout" and second.drive == ServoDrive.from_settings({"preset": "xl330", "kp": 200})
    assert second.load == Load(0.02, 0.98) and second.columns == {**columns, "torque": "i_q:A*0.091"}
    write_study([first, second], tmp_path / "study.toml")
    assert read_sources(tmp_path / "study.toml") == (first, second)


def test_a_rig():
    rig = load_rig(STORED / "rig.toml")
    assert (rig.rate, rig.torque_sign, rig.encoder.counts, rig.encoder.zero) == (500.0, -1, 4096, None)
    assert (rig.limits.torque, rig.fault.action, rig.link.baud) == (3.5, "brake", 115200)
    assert (
        rig.wiring == "d1305f7676a6ea594a83f299914892b80e3f4cd53a9a01b5fb4e6e43431cb042"
    )  # of a check that has passed


def test_a_training():
    config = Config.from_settings(read_toml(STORED / "training.toml"))
    assert (config.constraint, config.hidden, config.learning_rate, config.levels) == ("rms", 32, 1e-4, (-1, 0, 1))
