"""Known loads of a study: commands say the torque constant, or speak of amperes alone."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from workbench.cli import main

K = 0.873  # [N m/A]
ARMS = ((0.0, 0.2), (0.5, 0.2), (1.0, 0.2))  # [kg] at [m]
NEWTON_METRE = re.compile(r"(?:N|kg)(?: |\N{NO-BREAK SPACE}|&nbsp;|\\u00a0)m(?!/A)(?![a-z])")


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """Currents under three loads, of friction that grows with the load, and studies of all and of one."""
    folder = tmp_path_factory.mktemp("bench")
    friction = {"load_dependent_friction": {"load_mu": 0.12}}
    cases = [
        (
            Plant(0.03 + m * r * r, 0.6 + 9.81 * m * r, 0.15, 0.25, friction),
            Experiment(500.0, 8.0, "two_tone", 0.7, seed, counts=65_536),
        )
        for seed, (m, r) in enumerate(ARMS)
    ]
    entries = []
    for k, (run, (m, r)) in enumerate(zip(simulate(cases), ARMS, strict=True)):
        rows = np.column_stack([run.time, run.position, run.torque / K])
        np.savetxt(folder / f"load{k}.csv", rows, delimiter=",", header="t,q,i", comments="", fmt="%.9g")
        entries.append(f'[[recording]]\nfile = "load{k}.csv"\nload = {{mass = {m}, length = {r}}}\n')
    columns = '[columns]\ntorque = "i:A*?"\n'
    (folder / "all.toml").write_text(columns + "".join(entries))
    (folder / "one.toml").write_text(columns + entries[1])
    return folder


FOUND = re.compile(r"torque constant 0\.87\d* ± 0\.\d+ N m/A, from 3 known loads")


def test_a_torque_constant_is_identified_kept_and_used(bench, tmp_path, capsys: pytest.CaptureFixture[str], done):
    study, model = str(bench / "all.toml"), str(tmp_path / "model.json")
    assert FOUND.search(done("identify", study, "-o", model, "--json", tmp_path / "identified.json"))
    data = json.loads((tmp_path / "identified.json").read_text())
    assert data["torque_constant"]["value"] == pytest.approx(K, rel=0.01)
    saved = json.loads(Path(model).read_text())["torque_constant"]
    assert saved["value"] == pytest.approx(K, rel=0.01) and 0 < saved["std"] < 0.01 and saved["unit"] == "N m/A"
    assert main(["compare", model, str(bench / "one.toml")]) == 0  # whose current alone would not tell it
    told = capsys.readouterr().out
    assert "torque constant 0.87" in told and "N m/A, of the model" in told and "torque [N m]" in told


@pytest.mark.slow
def test_without_loads_that_differ_nothing_is_said_in_newton_metres(bench, tmp_path, done):
    study, model, page = str(bench / "one.toml"), str(tmp_path / "model.json"), tmp_path / "page.html"
    told = []
    for command in (
        ["identify", study, "-o", model, "--json", str(tmp_path / "identified.json")],
        ["compare", model, study, "--json", str(tmp_path / "compared.json")],
        ["diagnose", study, "-v", "--json", str(tmp_path / "diagnosis.json"), "--report", str(page)],
        ["add", model, "stribeck", study],
    ):
        told.append(done(*command))
    for k in (0, 2, 3):
        assert "the torque constant is not known, and every parameter is per A" in told[k]
    assert "inertia [A s^2]" in told[0] and "torque [A]" in told[1] and "torque, fitted [A]" in told[2]
    written = [file.read_text() for file in tmp_path.glob("*.json")]
    shown = re.sub(r'<script type="application/gzip".*?</script>', "", page.read_text(), flags=re.S)
    assert len(written) == 4
    for text in (*told, *written, shown):
        assert not NEWTON_METRE.search(text)
