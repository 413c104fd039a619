"""Sessions of an arm, without a browser."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from dash import dcc, html

from benchmarks.two_link import TwoLink
from pendulum_env.physics.friction import Stribeck
from pendulum_env.recording import write_recording
from robots.arms import arm_base, place_effect
from robots.arms.model import ArmModel
from robots.arms.robot_file import ArmFile
from tests.two_link import record_arm
from tests.workbench.app.plants import drop, reload_session, upload
from workbench.app.card import ColumnChoice
from workbench.app.downloads import make_file, write_commands, write_study_text
from workbench.app.panels import describe_state
from workbench.app.parts import list_choices
from workbench.app.stages import STAGES, data
from workbench.app.state import SearchChoices
from workbench.cli import main

TWO, OFFSET = TwoLink(), 0.3  # [N m], hidden in the elbow


def two_link(folder: Path, seconds: float = 6.0) -> tuple[Path, Path]:
    """The file of an arm of two links, and a recording in which the elbow's torque is off."""
    (folder / "arm.urdf").write_text(TWO.urdf())
    write_recording(record_arm(TWO, seconds=seconds, rate=500.0, offset=(0.0, OFFSET)), folder / "run.csv")
    return folder / "arm.urdf", folder / "run.csv"


def test_an_effect_at_a_joint_is_found_added_and_saved(session, tmp_path, monkeypatch):
    from workbench.app.stages import add, diagnose, model

    drop(session, *two_link(tmp_path, 4.0))
    state = session.state
    assert session.notice == "" and state.body is not None and not state.failure_reason
    assert describe_state(state)[1] == "Something is missing at shoulder and elbow"
    assert list_choices(state.body, tables=True)["torque_by_angle@elbow"].endswith("at elbow")
    page = model.show_matches(session)  # the offset is an offset, or as good as one, and at its joint
    tries = [one.id["of"] for one in page._traverse() if isinstance(one, html.Button)]
    assert len(tries) == 3 and tries[0] in ("torque_offset@elbow", "coulomb_asymmetry@elbow")
    session.run_action(lambda: diagnose.start(session, SearchChoices("torque_offset,spring@elbow")))
    assert session.notice == ""
    assert session.state.suggested_additions == ("torque_offset@elbow",)
    assert describe_state(session.state)[1] == "A torque offset at elbow is missing"
    page = diagnose.show_rivals(session)
    markup = "".join(one.data for one in page._traverse() if isinstance(one, dcc.Store))
    assert [f'id="rival-0-{k}-torque"' in markup for k in range(4)] == [True, True, True, False]
    assert "Coulomb friction that differs by direction at elbow" in markup and "at shoulder" not in markup
    session.run_action(lambda: add.start(session, "torque_offset@elbow"))
    state = session.state
    before, after = (rung.errors["holdout"].joints["elbow"] for rung in state.steps)
    assert state.added == ("torque_offset@elbow",) and not state.suggested_additions and after < 0.2 * before
    assert all(stage.show(session) for stage in STAGES)
    shown = {name: show(session) for stage in STAGES for name, show in stage.late.items()}
    assert [name for name, part in shown.items() if part is None] == ["timing"]  # an arm has no timing
    assert "torque_offset@elbow" in make_file(state, "report")[1].decode()

    for name in ("study", "model"):
        saved, content = make_file(state, name)
        (tmp_path / saved).write_bytes(content)
    theta = json.loads((tmp_path / "model.json").read_text())["theta"]
    assert theta["torque_offset@elbow"]["value"] == pytest.approx(OFFSET, rel=0.05)
    monkeypatch.chdir(tmp_path)
    lines = [line.split()[1:] for line in write_commands(state).splitlines()]
    Path("model.json").unlink()
    assert [main(line) for line in lines] == [0] * len(lines)
    assert ArmModel.load("model.json", state.body).theta == pytest.approx(state.model.theta, rel=1e-6)

    session.run_action(lambda: session.start_from_model(Path("model.json")))
    assert (
        session.notice == ""
        and session.state.terms[-1].id == "torque_offset@elbow"
        and not session.state.failure_reason
    )
    session.run_action(session.undo)
    session.run_action(session.undo)
    assert session.state.added == () and session.state.suggested_additions == ("torque_offset@elbow",)


def test_a_robot_may_come_after_its_recordings(session, tmp_path):
    robot, run = two_link(tmp_path, 4.0)
    drop(session, run)
    assert session.state.loaded == () and len(session.cards) == 1
    drop(session, robot)
    assert session.state.robot is not None and [one.id for one in session.state.loaded] == ["run.csv"]
    assert not session.cards and session.state.robot.file.name == "arm.urdf"
    upload(session, "swing.csv", b"time,position,torque\n0,0,1\n0.01,0.1,1\n0.02,0.3,1\n")
    (card,) = session.cards
    assert "position_shoulder" in card.error and card.roles[1:3] == ("position_shoulder", "torque_shoulder")


def test_a_person_says_which_column_is_of_which_joint(session, tmp_path):
    robot, run = two_link(tmp_path, 4.0)
    header, rows = run.read_text().split("\n", 1)
    assert header == "time,position_shoulder,position_elbow,torque_shoulder,torque_elbow"
    run.write_text(f"time,position_shoulder,enc2,torque_shoulder,i2\n{rows}")
    drop(session, robot, run)
    (card,) = session.cards
    assert [choice.role for choice in card.choices] == ["time", "position_shoulder", "", "torque_shoulder", ""]
    assert stage_text(session).count("on the side of the joint") == 1
    choices = list(card.choices)
    choices[2], choices[4] = ColumnChoice("position_elbow"), ColumnChoice("torque_elbow", "A", "*0.5")
    session.run_action(lambda: session.apply_card(card.set_choices(choices, False)))
    assert session.notice == "" and not session.cards and not session.state.failure_reason
    assert session.state.loaded[0].source.columns["torque_elbow"] == "i2:A*0.5"


def stage_text(session) -> str:
    return str(data.show(session))


def test_a_saved_study_and_model_bring_back_the_robot_its_recordings_and_its_terms(session, tmp_path):
    robot, run = two_link(tmp_path, 4.0)
    session.run_action(lambda: session.set_robot(ArmFile(robot, rotors=True, weightless=True)))
    drop(session, run)
    session.run_action(lambda: session.hold_out("run.csv", True))
    (tmp_path / "more.csv").write_bytes(run.read_bytes())
    drop(session, tmp_path / "more.csv")
    state = session.state
    begun = ArmModel.build((*arm_base(state.body), place_effect(Stribeck, "elbow")(0.1)), 1.0)
    (tmp_path / "first.json").write_text(json.dumps(begun.json()))
    drop(session, tmp_path / "first.json")
    assert session.notice == "" and not session.state.failure_reason
    again = reload_session(session.state, tmp_path / "again")
    assert again.notice == "" and write_study_text(again.state) == write_study_text(session.state)
    assert replace(again.state.robot, file=robot) == session.state.robot
    assert [one.held_out for one in again.state.loaded] == [True, False]
    assert again.state.model.theta == pytest.approx(session.state.model.theta, rel=1e-6)


def test_lines_to_copy_have_the_robot_and_what_is_looked_for(session, tmp_path):
    from workbench.app.stages import diagnose

    file, run = two_link(tmp_path, 4.0)
    session.run_action(lambda: session.set_robot(ArmFile(file, rotors=True, weightless=True)))
    drop(session, run)
    choices = SearchChoices("torque_offset,spring@elbow", "torque_offset@shoulder")
    session.run_action(lambda: diagnose.start(session, choices))
    first, second = write_commands(session.state).splitlines()
    assert first.endswith("--rotors --no-gravity --scheme filtered_dynamic -o model.json")
    assert "--only=torque_offset,spring@elbow --without=torque_offset@shoulder" in second
