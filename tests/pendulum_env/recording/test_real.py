"""Recordings of real machines, each folder read by a study, and simulated ones: absent on most computers."""

from pathlib import Path

import numpy as np
import pytest

from pendulum_env.recording import (
    Recording,
    RecordingError,
    Source,
    read_recording,
    read_study,
    write_study,
)  # fmt: skip

SHARED = Path(__file__).parents[4] / "shared"
COLUMNS = {"bam_xl330": {}, "dfki": {}, "emps": {"position": "position:m", "torque": "torque:N"}, "odrive": {}}
LOST = {"odrive": 2}  # segments at most; the others have no gap


def at_hand(*folder: str) -> list[Path]:
    files = sorted(SHARED.joinpath(*folder).glob("*.csv*"))
    if not files:
        pytest.skip("these recordings are not on this machine")
    return files


@pytest.mark.slow
def test_practice_recordings_are_left_alone_and_refused_in_degrees(tmp_path: Path) -> None:
    for path in at_hand("practice"):
        recording = read_recording(path)
        assert recording.rate == pytest.approx(round(recording.rate), rel=1e-12)
        assert recording.notes == ()
        columns = recording.columns | {"position": np.degrees(recording.position)}
        with pytest.raises(RecordingError, match=r"'position:deg'"):
            Recording(*(columns[name] for name in ("time", "position", "torque")))
        np.savez(tmp_path / "deg.npz", **columns)
        with pytest.raises(RecordingError, match=r"--columns position=position:deg"):
            read_recording(tmp_path / "deg.npz")


@pytest.mark.parametrize("folder", COLUMNS)
def test_every_file_is_read_as_it_is(folder: str, tmp_path: Path) -> None:
    files = at_hand("data", folder)
    write_study([Source(file, columns=COLUMNS[folder]) for file in files], tmp_path / "study.toml")
    for file, recording in zip(files, read_study(tmp_path / "study.toml").fitted, strict=True):
        raw = np.loadtxt(file, delimiter=",", skiprows=1)
        assert len(recording.starts) <= LOST.get(folder, 1)
        assert recording.duration == pytest.approx(np.ptp(raw[:, 0]), rel=5e-3)
        near = np.interp(recording.time, raw[:, 0] - raw[0, 0], raw[:, 1])
        assert np.sqrt(np.mean((recording.position - near) ** 2)) < 2e-3 * np.ptp(raw[:, 1])
