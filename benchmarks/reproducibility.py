"""Whether a diagnosis depends on the order in which a computer adds: verdicts and parameters under other kernels.

python -m benchmarks.reproducibility [EFFECT ...]

OpenBLAS and NumPy choose their kernels by the processor, and these add in other orders. Here one processor plays the
others: the same recording is diagnosed under each, in a process of its own. A kernel that the processor lacks is left
out. Exits with 1 if a verdict differs, or a parameter by more than 1 % of its standard error.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

from benchmarks.parallel import THREADS
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.plant import make_plant
from pendulum_env.recording import write_recording
from workbench.terminal import Terminal

SAME = 0.01  # of a standard error
SECONDS = 20.0  # of a recording
EFFECTS = ("stribeck", "cogging", "presliding", "actuator_lag", "joint_flexibility")
NOTHING = "nothing"  # is hidden, where this stands for an effect
NEEDS = {"SkylakeX": "AVX512F", "Haswell": "AVX2", "Zen": "AVX2", "Prescott": "SSE3"}  # of the processor, by kernels


def kernels() -> dict[str, dict[str, str]]:
    """Environment of a process by the name of the kernels that it then uses."""
    every = {
        f"OpenBLAS for {core}, {threads} thread{'s'[: threads - 1]}": {
            "OPENBLAS_CORETYPE": core,
            **dict.fromkeys(THREADS, str(threads)),
        }
        for core, feature in NEEDS.items()
        if __cpu_features__.get(feature)
        for threads in (1, 2)
    }
    newer = [name for name in __cpu_dispatch__ if __cpu_features__.get(name)]
    without_512 = [name for name in newer if name == "X86_V4" or name.startswith("AVX512")]
    for title, disabled in (("NumPy without AVX-512", without_512), ("NumPy without AVX2 either", newer)):
        if disabled:
            every[title] = {"NPY_DISABLE_CPU_FEATURES": " ".join(disabled), **dict.fromkeys(THREADS, "1")}
    return every


def diagnosis(recording: Path, environment: Mapping[str, str]) -> dict[str, Any]:
    """What `diagnose --json` writes of a recording under some kernels."""
    output = recording.with_suffix(".json")
    command = [sys.executable, "-m", "workbench.cli", "diagnose", str(recording), "--json", str(output)]
    subprocess.run(command, env={**os.environ, **environment}, check=True, stdout=subprocess.DEVNULL)
    found: dict[str, Any] = json.loads(output.read_text(encoding="utf-8"))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reproducibility", description=__doc__.splitlines()[0])
    parser.add_argument("effects", nargs="*", default=[NOTHING, *EFFECTS], help="hidden one by one (or nothing)")
    effects = parser.parse_args(argv).effects
    terminal, environments, failed = Terminal(), kernels(), False
    with tempfile.TemporaryDirectory() as folder, terminal.progress("diagnosing") as progress:
        for done, effect in enumerate(effects):
            progress(effect, done / len(effects))
            rng = np.random.default_rng(1)
            plant = make_plant({}, [effect] if effect != NOTHING else [])
            file = Path(folder) / f"{effect}.csv"
            write_recording(record(plant, excitation("paper", rng, SECONDS), SECONDS, rng=rng, name=effect), file)
            terminal.heading(f"Hidden: {effect}")
            found = {name: diagnosis(file, environment) for name, environment in environments.items()}
            rows, same = spread(found)
            terminal.table(("kernels", "verdict", "largest difference in standard errors", "of"), rows, left=("of",))
            failed |= not same
    return int(failed)


def spread(found: Mapping[str, Mapping[str, Any]]) -> tuple[list[tuple[str, str, str, str]], bool]:
    """A row for each of the kernels, compared with the first, and whether all are the same to a reader."""
    first, *_ = found.values()
    rows, same = [], True
    for name, one in found.items():
        theta, reference = one["steps"][-1]["theta"], first["steps"][-1]["theta"]
        alike = theta.keys() == reference.keys() and one["selected"] == first["selected"]
        differences = {
            key: abs(theta[key]["value"] - value["value"]) / max(value["std"], 1e-300)
            for key, value in reference.items()
            if key in theta
        }
        worst = max(differences, key=differences.__getitem__)
        rows.append((name, "+".join(one["selected"]) or NOTHING, f"{differences[worst]:.2g}", worst))
        same &= alike and differences[worst] <= SAME
    return rows, same


if __name__ == "__main__":
    sys.exit(main())
