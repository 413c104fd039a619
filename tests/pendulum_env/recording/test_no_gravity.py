"""Motors without gravity: no unit of an angle follows from a torque of gravity."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import identify
from pendulum_env.recording import RecordingError, read_recording
from workbench.cli import main


@pytest.fixture(scope="module")
def log():
    """Swings of a pendulum, with the angle in turns and no unit in its name."""
    experiment = Experiment(rate=200.0, seconds=12.0, excitation="chirp", scale=1.3, torque_noise=0.002)
    (run,) = simulate([(Plant(), experiment)])
    return {"time": run.time, "position": run.position / (2 * np.pi), "torque": run.torque}


def test_a_gravity_of_zero_tells_no_unit(log, tmp_path, capsys):
    with pytest.raises(RecordingError, match="gravity acts on position as on turns"):
        read_recording(log)
    read = read_recording(log, has_gravity=False)
    np.testing.assert_allclose(read.position, log["position"])
    assert identify(log, fixed={"gravity": 0.0}, schemes=["dynamic"]).model.estimates["gravity"].value == 0.0
    file = tmp_path / "log.csv"
    np.savetxt(file, np.column_stack([*log.values()]), delimiter=",", header=",".join(log), comments="", fmt="%.10g")
    assert main(["identify", str(file)]) == 2
    assert "gravity acts on" in capsys.readouterr().err
    assert main(["identify", str(file), "--fix", "gravity=0"]) == 0
