import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.two_link import TwoLink
from pendulum_env.recording import write_recording
from robots.arms import read_arm_recording
from tests import robot_files, slow
from tests.two_link import record_arm
from tests.workbench.pages import Page
from workbench.cli import main

ARM = TwoLink()
MOVING = ("--joints", "torso,shoulder,elbow")
QUICK = ("--scheme", "filtered_dynamic")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(ARM.urdf())
    (folder / "loaded.toml").write_text('[[recording]]\nfile = "plain.csv"\nload = {mass = 1.0, length = 0.1}\n')
    (folder / "arm.toml").write_text('joints = ["elbow"]\n[[recording]]\nfile = "plain.csv"\n')
    for name, offset in (("plain", 0.0), ("hidden", 0.3)):
        write_recording(record_arm(ARM, seconds=8.0, offset=(0.0, offset)), folder / f"{name}.csv")
    assert main([*map(str, of_arm(folder, "identify", "plain.csv", *QUICK, "-o", "plain.json"))]) == 0
    return folder


def of_arm(folder, command, *arguments):
    """Words of a command on an arm, whose files lie in a folder."""
    files = [folder / a if "." in a and not a.startswith("-") else a for a in arguments]
    return command, *files, "--robot", folder / "arm.urdf"


def curves(page, figure):
    """Band and curves of a figure of a report."""
    found = Page(page.read_text())
    plots = [attributes["id"] for _, attributes in found.tags if attributes.get("class") == "plot"]
    return found.figures[plots.index(figure)]["data"]


def test_identify_compare_and_diagnose_an_arm(run_command, folder):
    out = run_command(*of_arm(folder, "identify", "plain.csv", "-o", "arm.json", "--json", "found.json"))
    assert "Iyy@shoulder stands for Iyy@shoulder + 0.2025 m@elbow" in out and "filtered_hamiltonian" in out
    found = json.loads((folder / "found.json").read_text())
    assert found["schema"] == "pendulum-ident/identification@3"
    assert found["schemes"]["energy"]["theta"]["coulomb@elbow"]["value"] == pytest.approx(ARM.coulomb[1], rel=0.01)

    written = ("--json", "errors.json", "--report", "compared.html")
    assert "Torque errors" in run_command(*of_arm(folder, "compare", "arm.json", "hidden.csv", *written))
    for axis in ("position", "velocity", "time"):
        ((_, shoulder), (_, elbow)) = (curves(folder / "compared.html", f"joint-{k}-{axis}") for k in range(2))
        assert np.abs(shoulder["y"]).max() < 0.02  # [N m]
        assert np.mean(elbow["y"]) == pytest.approx(0.3, abs=0.02)
    errors = json.loads((folder / "errors.json").read_text())["joint"]["errors"]["joints"]
    assert errors["elbow"]["torque_rms"] == pytest.approx(0.3, rel=0.05)

    written = ("--only", "torque_offset,spring", "--json", "diagnosis.json", "-o", "better.json")
    written += ("--report", "found.html")
    out = run_command(*of_arm(folder, "diagnose", "hidden.csv", *written))
    brief = out.partition("\n\n")[2].splitlines()
    assert brief[:2] == ["A torque offset at elbow is missing", "torque_offset@elbow: c"] and len(brief) <= 8
    page = (folder / "found.html").read_text()
    assert "<h1" in page and "A torque offset at elbow is missing" in page and 'id="candidates"' in page
    found = json.loads((folder / "diagnosis.json").read_text())["model"]["theta"]["torque_offset@elbow"]
    assert f"{found['value']:.3f}"[:5] in page.partition('id="candidates"')[0]  # with what was found
    _, before, after = curves(folder / "found.html", "joint-1-velocity")
    assert np.abs(before["y"]).max() > 10 * np.abs(after["y"]).max()
    assert json.loads((folder / "diagnosis.json").read_text())["selected"] == ["torque_offset@elbow"]


def test_torque_of_an_arm_that_is_logged_late_is_corrected_where_that_is_asked_for(run_command, folder):
    late = read_arm_recording(folder / "plain.csv", ("shoulder", "elbow"))
    samples = 4
    late = replace(late, torque=np.roll(late.torque, samples, axis=0)).slice(samples, None)
    write_recording(late, folder / "late.csv")
    for command in (("identify", "late.csv", *QUICK), ("compare", "plain.json", "late.csv")):
        out = run_command(*of_arm(folder, *command, "--align"))
        delay = re.search(r"logged (\d+\.\d+) ± \S+ ms late\. It is corrected", out)
        assert float(delay[1]) == pytest.approx(1e3 * samples / late.rate, rel=0.05)


def test_compare_tells_what_an_arm_carries(run_command, run_refused, folder):
    """A body as heavy as the forearm, at the same place: twice its mass and moments."""
    heavy = replace(ARM, mass=(ARM.mass[0], 2 * ARM.mass[1]), inertia=(ARM.inertia[0], 2 * ARM.inertia[1]))
    loaded = record_arm(heavy, 3, seconds=8.0, rate=500.0, scale=(6.0, 3.5), noise=0.0)
    write_recording(loaded, folder / "heavy.csv")
    out = run_command(*of_arm(folder, "compare", "plain.json", "heavy.csv"))
    assert re.search(r"A payload of 0\.\d+ ± .* kg behind elbow would explain most of it: see --payload", out)
    written = ("--payload", "--without", "plain.csv", "--json", "payload.json")
    out = run_command(*of_arm(folder, "compare", "plain.json", "heavy.csv", *written))
    assert "Payload at the link behind elbow" in out and "no motion of the joints shows them" in out
    told = json.loads((folder / "payload.json").read_text())["payload"]
    assert told["theta"]["m"]["value"] == pytest.approx(ARM.mass[1], rel=0.02)
    for wrong, said in (
        (("--payload", "wrist"), "unknown joint 'wrist'"),
        (("--without", "plain.csv"), "say --payload, too"),
    ):
        assert said in run_refused(*of_arm(folder, "compare", "plain.json", "heavy.csv", *wrong))


def test_effects_at_joints_and_couplings_are_added_and_looked_for(run_command, run_refused, folder):
    out = run_command(*of_arm(folder, "add", "plain.json", "torque_offset@elbow", "hidden.csv", "-o", "added.json"))
    assert "torque_offset@elbow lowers the held-out errors: torque at elbow to" in out
    theta = json.loads((folder / "added.json").read_text())["theta"]
    assert theta["torque_offset@elbow"]["value"] == pytest.approx(0.3, rel=0.03)
    out = run_command(*of_arm(folder, "add", "plain.json", "coupling@shoulder,elbow", "hidden.csv"))
    assert "coupling.viscous@shoulder,elbow" in out
    run_command(*of_arm(folder, "diagnose", "hidden.csv", "--only", "coupling,spring", "--json", "told.json"))
    judged = {one["effect"] for one in json.loads((folder / "told.json").read_text())["candidates"]}
    pairs = {"coupling@shoulder,elbow", "coupling@shoulder,-elbow"}
    assert judged == {*pairs, "spring@shoulder", "spring@elbow"}
    for effect, model, said in (
        ("stribeck@wrist", "plain.json", "unknown joint 'wrist'"),
        ("torque_offset@elbow", "added.json", "the model has 'torque_offset@elbow' already"),
    ):
        assert said in run_refused(*of_arm(folder, "add", model, effect, "hidden.csv"))


def test_a_model_knows_whether_it_has_rotors_and_whether_the_driver_takes_gravity_off(run_command, folder):
    chosen = ("--seconds", "4", "--rate", "250", "--no-gravity", "-o", "light.csv")
    run_command(*of_arm(folder, "record", *chosen))
    chosen = ("--no-gravity", "--rotors", "--scheme", "filtered_dynamic", "-o", "light.json")
    run_command(*of_arm(folder, "identify", "light.csv", *chosen))
    assert json.loads((folder / "light.json").read_text())["rotors"]
    out = run_command(*of_arm(folder, "compare", "light.json", "light.csv"))
    assert all(float(line.split()[-2]) < 2 for line in out.splitlines() if line.endswith("%"))


@pytest.fixture(scope="module")
def lift(tmp_path_factory):
    """An arm on a torso that slides, with a gripper that the recording has open by 1 cm."""
    folder = tmp_path_factory.mktemp("lift")
    (folder / "arm.urdf").write_text(robot_files.urdf(robot_files.TORSO))
    columns = robot_files.simulate(robot_files.TORSO, {"left": 0.01}, seconds=8.0)
    robot_files.write(columns, folder / "run.csv")
    columns = {
        name: values + 0.02 * np.sin(columns["time"]) * (name == "position_left") for name, values in columns.items()
    }
    robot_files.write({name.replace("torso", "torso [mm]"): values * (1e3 if name == "position_torso" else 1)
                  for name, values in columns.items() if name != "position_right"}, folder / "moved.csv")  # fmt: skip
    for name, joints in (("study", ["torso", "shoulder", "elbow"]), ("empty", "torso")):
        (folder / f"{name}.toml").write_text(f'joints = {json.dumps(joints)}\n[[recording]]\nfile = "run.csv"\n')
    asked = of_arm(folder, "identify", "run.csv", *MOVING, "--scheme", "energy", "-o", "held.json")
    assert main([*map(str, asked)]) == 0
    return folder


def test_joints_that_do_not_move_are_held_where_the_recording_has_them(run_command, lift):
    out = run_command(*of_arm(lift, "identify", "run.csv", *MOVING, "--json", "found.json", "-o", "model.json"))
    assert "held: left at 0.01 m, right at 0.01 m\n" in out and "gets" not in out
    rows = {line.split()[0]: line.split()[-2:] for line in out.splitlines() if "@torso" in line}
    assert rows["viscous@torso"] == ["N", "s/m"] and rows["m@torso"][1] == "kg" and rows["coulomb@torso"][1] == "N"
    found = json.loads((lift / "found.json").read_text())["schemes"]
    assert [own["unit"] for own in found["dynamic"]["residual"]["joints"].values()] == ["N", "N m", "N m"]
    assert found["energy"]["residual"]["unit"] == "J"
    assert found["dynamic"]["theta"]["coulomb@torso"]["unit"] == "N"
    assert json.loads((lift / "model.json").read_text())["held"] == pytest.approx({"left": 0.01, "right": 0.01})

    again = run_command(*of_arm(lift, "identify", "study.toml", "--scheme", "energy"))
    assert "held: left at 0.01 m, right at 0.01 m\n" in again
    out = run_command(*of_arm(lift, "compare", "model.json", "moved.csv", "--report", "page.html", "--json", "e.json"))
    assert "warning: left gets 0.02 m away from there in moved: name it in --joints if it moves" in out
    assert "position_torso converted to m from column 'position_torso [mm]'" in out
    units = json.loads((lift / "e.json").read_text())["units"]
    assert [own["torque"] for own in units.values()] == ["N", "N m", "N m"] and units["torso"]["position"] == "m"
    (row,) = [line for line in out.splitlines() if line.startswith("torso")]
    assert row.split()[3] == "N" and float(row.split()[4]) < 2.0  # [%]
    figures = Page((lift / "page.html").read_text()).figures
    titles = [figure["layout"]["xaxis"]["title"]["text"] for figure in figures]
    titles = titles[titles.index("position q [m]") :]  # after the recordings over time
    assert titles[:2] == ["position q [m]", "velocity q̇ [m/s]"] and titles[3] == "angle q [rad]"


def test_a_base_that_floats_is_taken_as_bolted_down_and_listed(run_command, folder, tmp_path):
    text = (folder / "arm.urdf").read_text().replace('<link name="base"/>', '<link name="world"/><link name="base"/>')
    root = '<joint name="root" type="floating"><parent link="world"/><child link="base"/></joint></robot>'
    (tmp_path / "arm.urdf").write_text(text.replace("</robot>", root))
    asked = ("identify", str(folder / "plain.csv"), "--scheme", "energy")
    assert "held: root at zero" in run_command(*of_arm(tmp_path, *asked))


MISTAKES = {
    "folder": [
        ("record -o x.csv --effect stribeck", "'stribeck' should say at which joint"),
        ("record -o x.csv --backend simulated", "arms know pymunk and mujoco alone"),
        ("record -o x.csv --excitation prbs", "arms know rl alone"),
        ("diagnose plain.csv --only backlash", "unknown effect of joints 'backlash'"),
        ("diagnose plain.csv --experiment x.csv", "--experiment is for pendulums"),
        (
            "identify plain.csv --columns torque_shoulder=torque_elbow,torque_elbow=torque_elbow:mNm",
            "column 'torque_elbow' is given for torque_shoulder and for torque_elbow: which is it",
        ),
        ("identify loaded.toml", "plain.csv: `load` is of one joint"),
    ],
    "lift": [
        (
            "identify run.csv --joints torso,shoulder,elbow,left",
            "there is none for left among .*: name them torque_left and so on.* naming those that move",
        ),
        ("identify run.csv --joints torso,sholder", "unknown joint 'sholder': did you mean shoulder"),
        ("identify empty.toml", "'joints': Expected array"),
        ("identify study.toml --joints torso", "given twice"),
        (
            "record -o x.csv --joints torso,shoulder,elbow --backend pymunk",
            "'torso' does not turn in .* --backend mujoco",
        ),
        ("add held.json cogging@torso run.csv", "cogging is of joints that turn: it cannot be at 'torso'"),
        ("compare held.json run.csv --joints shoulder,elbow", "is of an arm with joints torso, shoulder"),
    ],
    "": [  # of a pendulum
        ("diagnose hidden.csv --only coupling", ""),  # it has no two joints
        ("record --effect stribeck@elbow -o x.csv", "unknown effect 'stribeck@elbow': did you mean stribeck"),
        ("record --max-speed 2 -o x.csv", "--max-speed is of an arm: give its links with --robot"),
        ("identify plain.csv --joints elbow", "--joints is of an arm: give its links with --robot"),
        ("identify arm.toml", "its study names joints of an arm"),
    ],
}


@pytest.mark.parametrize(
    ("place", "words", "told"), [(place, *mistake) for place, mistakes in MISTAKES.items() for mistake in mistakes]
)
def test_mistakes_are_one_line(request, run_refused, monkeypatch, place, words, told):
    monkeypatch.chdir(request.getfixturevalue(place or "folder"))
    assert re.search(told, run_refused(*words.split(), *(["--robot", "arm.urdf"] if place else [])))


@pytest.mark.parametrize("words", ["record -o x.csv", "compare a.json plain.csv"])
def test_without_pinocchio_the_pip_command_is_told(run_refused, folder, monkeypatch, words):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    assert "pip install 'pendulum-ident[arms]'" in run_refused(*of_arm(folder, *words.split()))


def test_currents_need_a_torque_constant_which_the_model_keeps(run_command, run_refused, folder):
    columns = ",".join(f"torque_{joint}=torque_{joint}:A*{{}}" for joint in ("shoulder", "elbow"))
    told = run_refused(*of_arm(folder, "identify", "plain.csv", "--columns", columns.format(2, "?")))
    assert "joint 'elbow' has no torque constant" in told and "torque_elbow=torque_elbow:A*0.4" in told
    known = "--columns", columns.format(2, 2), "--scheme", "filtered_dynamic"
    run_command(*of_arm(folder, "identify", "plain.csv", *known, "-o", "amperes.json"))
    out = run_command(*of_arm(folder, "compare", "amperes.json", "plain.csv"))
    assert "torque_elbow=torque_elbow:A*2" in out
    (row,) = [line.split() for line in out.splitlines() if line.startswith("elbow")]
    assert float(row[-2]) < 1.0  # [%]


ROBOTS = {  # three with grippers and one with a torso that slides, and their joints that move
    "parallel": ("shoulder", "elbow"),
    "angular": ("shoulder", "elbow", "wrist"),
    "driven": ("shoulder", "jaw"),
    "torso": ("torso", "shoulder", "elbow"),
}


@pytest.mark.parametrize("robot", slow.but_first(["torso", "parallel", "angular", "driven"]))
def test_a_robot_goes_through_all_commands(robot, tmp_path, run_command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    joints, at = ROBOTS[robot], ROBOTS[robot][-1]
    (tmp_path / "robot.urdf").write_text(robot_files.urdf(getattr(robot_files, robot.upper())))
    asked = ["--robot", "robot.urdf"]
    moving = [*asked, "--joints", ",".join(joints)]

    usual = ("--seconds", "6", "--rate", "250")
    usual += () if robot == "torso" else ("--backend", "mujoco")  # which is taken where no plane holds all joints
    run_command("record", *moving, *usual, "-o", "plain.csv")
    out = run_command(
        "record", *moving, *usual, "--seed", "1", "--effect", f"torque_offset@{at}=1.5", "-o", "hidden.csv"
    )
    assert f"hidden: torque_offset@{at}" in out and ("held: left at zero" in out) == (robot != "driven")
    run_command("identify", "plain.csv", *moving, "--scheme", "filtered_dynamic", "-o", "model.json")
    out = run_command("compare", "model.json", "hidden.csv", *moving, "--report", "compared.html")
    assert re.search(rf"^{at} ", out, re.M)
    found = ("--only", "torque_offset,quadratic_drag", "--report", "found.html", "-o", "better.json")
    assert f"A torque offset at {at} is missing" in run_command("diagnose", "hidden.csv", *moving, *found)
    theta = json.loads((tmp_path / "better.json").read_text())["theta"]
    assert theta[f"torque_offset@{at}"]["value"] == pytest.approx(1.5, rel=0.02)
    looked = ("--only", f"spring@{at}", "--json", "again.json")
    run_command("diagnose", "hidden.csv", *moving, "--model", "better.json", *looked)
    candidates = json.loads((tmp_path / "again.json").read_text())["candidates"]
    assert [one["effect"] for one in candidates] == [f"spring@{at}"]
    assert "lowers" in run_command("add", "model.json", f"torque_offset@{at}", "hidden.csv", *moving)
    run_command("export", "model.json", *asked, "--to", "mjcf", "-o", "model.xml")
    out = run_command("compare", "model.json", "plain.csv", "--robot", "model.xml")  # what moved in the first one
    assert all(float(line.split()[-2]) < 5 for line in out.splitlines() if line.endswith(" %"))
