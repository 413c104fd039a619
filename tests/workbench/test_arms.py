import json

import numpy as np
import pytest

from benchmarks.two_link import Multisine, TwoLink
from pendulum_env.arms.recording import ArmRecording, write_arm_recording
from workbench.cli import main

ARM = TwoLink()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(ARM.urdf())
    time, signal = np.arange(0, 8, 1e-3), Multisine.paper(0, (3.5, 2.2))
    position, _ = ARM.simulate(signal, time)
    torque = signal.held(time, 1e-3) + 0.02 * np.random.default_rng(0).normal(size=position.shape)
    for name, offset in (("plain", 0.0), ("hidden", 0.3)):
        recording = ArmRecording.of(name, ("shoulder", "elbow"), time, position, torque + np.array([0.0, offset]))
        write_arm_recording(recording, folder / f"{name}.csv")
    return folder


def run(capsys, folder, command, *arguments):
    files = [str(folder / a) if "." in a and not a.startswith("-") else a for a in arguments]
    code = main([command, *files, "--robot", str(folder / "arm.urdf")])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_identify_compare_and_diagnose_an_arm(capsys, folder):
    code, out, _ = run(capsys, folder, "identify", "plain.csv", "-o", "arm.json", "--json", "found.json")
    assert code == 0
    assert "Iyy@shoulder stands for Iyy@shoulder + 0.2025 m@elbow" in out and "filtered_hamiltonian" in out
    found = json.loads((folder / "found.json").read_text())
    assert found["schema"] == "pendulum-ident/arm-identification@1"
    assert found["schemes"]["energy"]["theta"]["coulomb@elbow"]["value"] == pytest.approx(ARM.coulomb[1], rel=0.01)

    code, out, _ = run(capsys, folder, "compare", "arm.json", "hidden.csv", "--json", "errors.json")
    assert code == 0 and "Torque errors" in out
    errors = json.loads((folder / "errors.json").read_text())["joints"]
    assert errors[1]["torque_rms"] == pytest.approx(0.3, rel=0.05)

    code, out, _ = run(capsys, folder, "diagnose", "hidden.csv", "--json", "diagnosis.json", "-o", "better.json")
    assert code == 0 and "Missing: torque_offset@elbow" in out
    assert json.loads((folder / "diagnosis.json").read_text())["selected"] == ["torque_offset@elbow"]
    code, out, _ = run(capsys, folder, "compare", "better.json", "hidden.csv")
    assert code == 0


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("identify", "plain.csv", "--align"), "--align is for pendulums"),
        (("identify", "plain.csv", "--fix", "gravity=2"), "--fix is for pendulums"),
        (("diagnose", "plain.csv", "--only", "backlash"), "unknown effect 'backlash'"),
        (("diagnose", "plain.csv", "--report", "x.html"), "--report is for pendulums"),
        (("identify", "plain.csv", "plain.csv"), "a recording is named twice"),
        (("identify", "study.toml"), "is a study, which is of pendulums"),
        (("identify", "arm.urdf"), "the name does not end in"),
        (("identify", "plain.csv", "--columns", "torque_wrist=u"), "unknown column of the arm 'torque_wrist'"),
        (("compare", "none.json", "plain.csv"), "none.json"),
    ],
)
def test_mistakes_are_one_line(capsys, folder, arguments, told):
    code, _, err = run(capsys, folder, *arguments)
    assert code == 2 and told in err and err.count("\n") == 1


def test_a_pendulums_command_knows_no_joints(capsys, folder):
    assert main(["identify", str(folder / "plain.csv"), "--columns", "torque_elbow=torque_elbow"]) == 2
    assert "columns are named for" in capsys.readouterr().err
