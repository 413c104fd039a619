"""Robots extend the pendulum by entry points alone."""

import subprocess
import sys
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from estimators import add, compare, diagnose, identify, texts
from estimators.data import preparation
from estimators.data.treatment import Treatment
from estimators.diagnosis import cases
from estimators.diagnosis.cases import choose_case, list_cases, register_case
from estimators.diagnosis.pendulum import PENDULUM, Pendulum
from estimators.findings import Quantity
from estimators.identification import CoarseEncoder
from estimators.texts import FindingTexts
from pendulum_env import plugins
from pendulum_env.errors import UserError
from pendulum_env.export.exporter import find_exporter
from pendulum_env.export.request import Request
from pendulum_env.physics import BASE
from pendulum_env.plant import paper_plant
from pendulum_env.recording.actuator import parse_actuator
from pendulum_env.robot_file import find_link_reader
from robots.arms.model import ArmModel
from robots.servos import ServoDrive
from robots.servos.export import ServoExporter
from tests.cases import CASES, recording
from workbench.narrator.findings import describe_cause

WITHOUT_ROBOTS = """
import sys, warnings
sys.modules["robots"] = None  # every import of it fails
warnings.simplefilter("ignore")
import gymnasium as gym
import numpy as np
import pendulum_env
from estimators import add, compare, diagnose, identify, simulate
from estimators.wrappers import EstimateParameters
from pendulum_env.physics import BASE, Model

env = EstimateParameters(gym.make(pendulum_env.PENDULUM), schemes="dynamic")
env.reset(seed=0)
for _ in range(50):
    env.step(env.action_space.sample())
truth = Model.build(BASE, [0.09, 2.0, 0.3, 0.2])
time = np.arange(6000) / 500
run = simulate(truth, 4 * np.sin(9 * time) + 3 * np.sin(2.3 * time), 500.0)
found = identify(run)
assert abs(found.model["gravity"].value - 2.0) < 0.01, found.model
assert compare(found, run).errors.torque_rms < 0.05
assert diagnose(run, only=["stribeck", "cogging"]).selected == ()
assert add(found, "cogging", run).objection is not None
from workbench.cli import main
from workbench.export import export

assert main(["identify", "run.csv"]) != 0  # there is no such file
assert "def step" in export(found.model, "python").content
assert not [name for name in sys.modules if name.startswith("robots.")]
"""


def test_the_core_works_without_robots():
    done = subprocess.run([sys.executable, "-c", WITHOUT_ROBOTS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_robots_of_this_distribution_register_themselves(recwarn):
    names = [case.name for case in list_cases()]
    assert {"arm", "servo"} < {*names} and names[-1] == "pendulum"
    assert isinstance(parse_actuator({"kp": 2.0, "output": "torque"}), ServoDrive) and parse_actuator({}) is None
    assert find_link_reader().read.__name__ == "read_body"
    assert isinstance(find_exporter(paper_plant(), Request(drive=ServoDrive())), ServoExporter)
    assert find_exporter(paper_plant(), Request()) is None
    assert not recwarn.list


class Heavy(Pendulum):
    """Pendulum with a doubled torque, as a kind of machine of its own."""

    name = "heavy"

    def accepts(self, base, recordings):
        return all(recording.name.startswith("heavy") for recording in recordings)

    def prepare(self, recordings, holdout, options):
        doubled = [[replace(one, torque=2 * one.torque) for one in part] for part in (recordings, holdout)]
        return super().prepare(*doubled, options)


@pytest.fixture
def heavy(monkeypatch):
    monkeypatch.setattr(preparation, "_registered", [])
    return register_case(Heavy())


def test_a_registered_case_takes_its_recordings(heavy):
    run = recording("stribeck")
    named = replace(run, name="heavy")
    assert choose_case(BASE, [run]) is PENDULUM and choose_case(BASE, [named]) is heavy
    light, found = (diagnose(one, only=["stribeck"]) for one in (run, named))
    assert found.selected == light.selected == tuple(CASES["stribeck"].hidden)
    for name, estimate in light.model.estimates.items():
        factor = 1.0 if name.endswith(("velocity", "exponent")) else 2.0
        assert found.model.estimates[name].value == pytest.approx(factor * estimate.value, rel=0.02)
    assert compare(light.model, named).model is light.model and set(identify(named)) == set(identify(run))
    assert np.isfinite(add(light.steps[0].model, "stribeck", named).after.errors["holdout"].torque_rms)


def test_a_case_makes_the_models_of_its_schema(monkeypatch, tmp_path):
    class Own(Pendulum):
        models: ClassVar = {"own@1": lambda content, body: content["value"]}

    monkeypatch.setattr(preparation, "_registered", [Own()])
    (tmp_path / "model.json").write_text('{"schema": "own@1", "value": 3}')
    assert ArmModel.load(tmp_path / "model.json", None) == 3


def test_a_package_that_fails_is_a_warning_and_no_error(monkeypatch):
    class Broken:
        name, value = "broken", "package.case"

        def load(self):
            raise SystemExit("no")

    monkeypatch.setattr(plugins, "_failures", {})
    monkeypatch.setattr(plugins, "entry_points", lambda group: [Broken()])
    with pytest.warns(UserWarning, match="'package.case' of .* cannot be loaded"):
        assert plugins.load_plugins.__wrapped__("pendulum_ident.cases") == {}
    assert "package.case" in str(plugins.make_missing_error("pendulum_ident.cases", "has a case"))


def test_a_drive_or_links_without_their_case_are_an_error_and_no_pendulum(monkeypatch):
    monkeypatch.setattr(preparation, "list_preparations", lambda: ())
    monkeypatch.setattr(cases, "list_preparations", lambda: ())
    driven = replace(recording("stribeck"), drive=ServoDrive(output="torque"), reference=recording("stribeck").position)
    for call in (lambda: choose_case(BASE, [driven]), lambda: preparation.find_preparation([driven])):
        with pytest.raises(UserError, match=r"no installed package .*: install pendulum-ident again"):
            call()
    assert choose_case(BASE, [recording("stribeck")]) is PENDULUM


def test_a_finding_of_a_plug_in_has_a_text():
    @dataclass(frozen=True)
    class BentRail(CoarseEncoder):  # other tests list the direct subclasses of `Finding`
        bend: Quantity
        rail: str

    assert str(BentRail(Quantity(0.5, 0.02, "rad"), "left")) == "Bent rail: bend 0.500 ± 0.020 rad, rail left."


def test_another_package_registers_the_texts_of_its_findings(monkeypatch):
    @dataclass(frozen=True)
    class LooseScrew(CoarseEncoder):
        torque: Quantity
        joints: tuple[str, ...]

    registered = FindingTexts(
        {LooseScrew: "A screw is loose at {joints}: {torque:2}.", "tightened": "The screws are tight."},
        causes={LooseScrew: lambda finding: f"a screw at {finding.joints[0]}"},
    )
    monkeypatch.setattr(texts, "load_plugins", lambda group: {"rail": registered})
    finding = LooseScrew(Quantity(0.5, unit="N m"), ("hip", "knee"))
    assert str(finding) == "A screw is loose at hip and knee: 0.5 N m." and describe_cause(finding) == "a screw at hip"
    assert str(Treatment("tightened")) == "The screws are tight." and describe_cause(Treatment("tightened")) == ""
