"""Recordings of real machines, absent on most computers, each folder read by a study."""

from pathlib import Path

import numpy as np
import pytest

from pendulum_env.recording import Source, read_study, write_study

DATA = Path(__file__).parents[4] / "shared" / "data"
COLUMNS = {"bam_xl330": {}, "dfki": {}, "emps": {"position": "position:m", "torque": "torque:N"}, "odrive": {}}
LOST = {"odrive": 2}  # segments at most; the others have no gap


@pytest.mark.parametrize("folder", COLUMNS)
def test_every_file_is_read_as_it_is(folder: str, tmp_path: Path) -> None:
    files = sorted((DATA / folder).glob("*.csv*"))
    if not files:
        pytest.skip("the real recordings are not on this machine")
    write_study(tmp_path / "study.toml", [Source(file, columns=COLUMNS[folder]) for file in files])
    for file, recording in zip(files, read_study(tmp_path / "study.toml").fitted, strict=True):
        raw = np.loadtxt(file, delimiter=",", skiprows=1)
        assert len(recording.starts) <= LOST.get(folder, 1)
        assert recording.duration == pytest.approx(np.ptp(raw[:, 0]), rel=5e-3)
        near = np.interp(recording.time, raw[:, 0], raw[:, 1])
        assert np.sqrt(np.mean((recording.position - near) ** 2)) < 2e-3 * np.ptp(raw[:, 1])
