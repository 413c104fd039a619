"""Files of --json have the fields that the page on results names, alike for a pendulum, an arm and a servo."""

import dataclasses
import json
import re
from functools import cache

import pytest

from benchmarks.two_link import TwoLink
from estimators import add, compare, diagnose, identify
from estimators.findings import Finding
from estimators.texts import TEXTS
from pendulum_env.physics import BASE
from pendulum_env.plugins import load_plugins
from pendulum_env.recording import Recording
from robots.arms import arm_base, read_body
from robots.servos import ServoDrive
from tests.cases import recording
from tests.two_link import record_arm
from tools.prose import ROOT
from workbench.narrator.diagnosis import write_addition, write_comparison, write_diagnosis
from workbench.narrator.identification import write_identification

PAGE = (ROOT / "docs" / "how-to" / "results.md").read_text(encoding="utf-8").partition("## Files of `--json`")[2]
OF_COMMANDS = {"payload", "nearest_body"}  # which commands add
FEW = ("torque_offset", "spring")


def rows(title):
    """Rows of a table of the page, as cells."""
    lines = PAGE.partition(title)[2].partition("\n###")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")][2:]


def names(cell):
    return set(re.findall(r"`([^`]*)`", cell))


def fields(record):
    """Fields of a record that the page names."""
    return {name for kinds, cell, *_ in rows("### Records") if record in kinds.split(", ") for name in names(cell)}


def families():
    """Fields of each family of findings that the page names."""
    return {
        family: names(cell) for cell_of_family, cell, *_ in rows("### Findings") for family in names(cell_of_family)
    }


def test_every_family_of_findings_is_documented():
    load_plugins(TEXTS)  # findings of installed packages
    documented = {found.__name__: {own.name for own in dataclasses.fields(found)} for found in Finding.__subclasses__()}
    on_page = {name.title().replace("_", ""): own for name, own in families().items()}
    assert on_page == documented, "the table Findings of docs/how-to/results.md lists each family with its fields"


@cache
def servo():
    """A servo with a drive, whose motor follows a goal."""
    run, drive = recording("gears 41"), ServoDrive(output="torque", kp=5.0, limit=6.0, rate=1000.0)
    goal = run.position + run.torque / drive.kp
    return Recording(run.time, run.position, run.torque, reference=goal, drive=drive, name="servo")


@pytest.fixture(scope="module", params=["pendulum", "arm", "servo"])
def files(request, tmp_path_factory):
    """What `diagnose`, `compare`, `add` and `identify` write on a machine."""
    terms, runs = BASE, [recording("stribeck")]
    if request.param == "servo":
        runs = [servo()]
    if request.param == "arm":
        pytest.importorskip("pinocchio")
        robot = tmp_path_factory.mktemp("arm") / "arm.urdf"
        robot.write_text(TwoLink().urdf())
        terms, runs = arm_base(read_body(robot)), [record_arm(seconds=6.0, rate=500.0, offset=(0.0, 0.3))]
    found, estimates = diagnose(runs, (), terms, only=FEW), identify(runs, terms, ["dynamic", "filtered_dynamic"])
    effect = "torque_offset@elbow" if request.param == "arm" else "torque_offset"
    added = add(found.steps[0].model, effect, runs)
    written = write_diagnosis(found), write_comparison(compare(found.model, runs)), write_addition(added)
    written = *written, write_identification(estimates)
    return [json.loads(json.dumps(one, allow_nan=False)) for one in written]


def test_files_have_the_documented_fields(files):
    for own, title in zip(
        files, ("### Diagnosis", "### Comparison", "### Addition", "### Identification"), strict=True
    ):
        documented = {name for cell, *_ in rows(title) for name in names(cell)}
        assert own.keys() == documented - OF_COMMANDS
        assert title.lower().removeprefix("### ") in own["schema"] and own["schema"] in PAGE


def test_records_have_the_documented_fields(files):
    diagnosis, comparison, addition, identification = files
    errors = [own for step in (*diagnosis["steps"], *addition["steps"]) for own in step["errors"].values()]
    errors += [own["errors"] for own in (*comparison["recordings"], comparison["joint"])]
    estimates = [own for step in diagnosis["steps"] for own in step["theta"].values()]
    estimates += [own for scheme in identification["schemes"].values() for own in scheme["theta"].values()]
    findings = [*diagnosis["findings"], *identification["findings"]]
    assert all(own.keys() == fields("step") for own in diagnosis["steps"])
    assert all(own.keys() == fields("candidate") for own in diagnosis["candidates"])
    assert all(own.keys() == fields("region") for own in (*diagnosis["regions"], *comparison["regions"]))
    assert findings and all(own.keys() == fields("finding") | families()[own["family"]] for own in findings)
    assert all(fields("quantity") <= own.keys() <= fields("estimate") for own in estimates)
    assert all({"joints"} <= own.keys() <= fields("errors") for own in errors)
    for own in errors:
        assert own["joints"].keys() <= diagnosis["units"].keys() == diagnosis["noise_floor"]["joints"].keys()
