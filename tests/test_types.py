"""Type checkers see the types of every package from a user's script."""

import subprocess
import sys

import pytest

SCRIPT = """
from agents import load
from estimators import diagnose
from pendulum_env.env import DirectDrivePendulum
from workbench.cli import main

reveal_type(load("peak"))
reveal_type(diagnose("run.csv"))
reveal_type(DirectDrivePendulum().rate)
reveal_type(main([]))
DirectDrivePendulum(efects=["stribeck"])
"""


@pytest.mark.slow
def test_mypy_knows_the_types_of_a_user_s_script(tmp_path):
    pytest.importorskip("mypy", reason="checking types needs mypy")
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--follow-imports=silent", "--cache-dir", str(tmp_path), "script.py"],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    revealed = [line.split("is ")[-1].strip('"') for line in done.stdout.splitlines() if "Revealed" in line]
    assert [name.rpartition(".")[2] for name in revealed] == ["Network", "Diagnosis", "float", "int"], done.stdout
    assert 'Unexpected keyword argument "efects"' in done.stdout and "import-untyped" not in done.stdout
