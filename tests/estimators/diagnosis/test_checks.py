"""The checks of each case: each verb runs all of them, and a new check reaches every result and its text."""

import inspect
from dataclasses import replace

import pytest

from estimators import add, compare, diagnose, identify
from estimators.data.fit_data import FitData
from estimators.diagnosis import checks
from estimators.diagnosis.cases import choose_case, list_cases
from estimators.diagnosis.checks import Subject, check_parameters
from estimators.findings import Finding
from estimators.selection.process_noise import UnloggedTorque
from pendulum_env.physics import BASE
from pendulum_env.quantity import Quantity
from robots.arms import arm_base, read_body
from tests.cases import recording
from tests.two_link import TwoLink, record_arm
from workbench.narrator.identification import list_warnings

NEWS = UnloggedTorque(Quantity(0.5, unit="N m"), Quantity(0.25, unit="N m"))


ALL = tuple(dict.fromkeys(check for case in list_cases() for check in case.checks))


@pytest.mark.parametrize("check", ALL)
def test_a_check_is_a_documented_function_of_a_subject(check):
    (parameter,) = inspect.signature(check).parameters.values()
    assert check.__name__.startswith("check_") and check.__doc__ and "Subject" in str(parameter.annotation)


def test_all_checks_are_those_of_a_case():
    missing = {name for name in vars(checks) if name.startswith("check_")} - {check.__name__ for check in ALL}
    assert not missing, f"add {missing} to CHECKS, or to the checks of another case, at the place of its finding"


@pytest.fixture(params=["pendulum", "arm"])
def machine(request, tmp_path):
    """Recordings of a machine and the terms of its model."""
    if request.param == "pendulum":
        return [recording("stribeck")], BASE
    pytest.importorskip("pinocchio")
    robot = tmp_path / "arm.urdf"
    robot.write_text(TwoLink().urdf())
    return [record_arm(seconds=6.0, rate=500.0, offset=(0.0, 0.3))], arm_base(read_body(robot))


def test_a_new_check_reaches_every_result_and_its_text(machine, monkeypatch):
    subjects: list[Subject] = []

    def check_news(subject: Subject) -> list[Finding]:
        subjects.append(subject)
        return [NEWS]

    runs, terms = machine
    case = choose_case(terms, runs)
    monkeypatch.setattr(type(case), "checks", (*case.checks, check_news))
    identified = identify(runs, terms, ["dynamic", "filtered_dynamic"])
    effect = "stribeck" if terms == BASE else "torque_offset@elbow"
    compared = compare(identified.model, runs)
    results = identified, compared, diagnose(runs, (), terms, only=[effect]), add(identified.model, effect, runs)
    assert [subject.verb for subject in subjects] == ["identify", "compare", "diagnose", "add"]
    assert all(subject.data.recordings for subject in subjects)
    assert all(result.findings[-1] == NEWS for result in results)
    assert all(str(NEWS) in str(result) for result in results[1:]) and list_warnings(identified)[-1] == str(NEWS)


def test_a_check_of_other_verbs_finds_nothing():
    runs = [recording("stribeck")]
    found = identify(runs)
    subject = Subject("add", choose_case(BASE, runs), FitData(tuple(runs)), found.model, doubts=(NEWS,))
    assert [*check_parameters(subject)] == [] and [*check_parameters(replace(subject, verb="identify"))] == [NEWS]
