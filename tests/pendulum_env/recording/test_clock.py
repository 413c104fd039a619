"""Clocks that logs have: since 1970 in any unit, since start-up, with few digits; time counts from the first sample."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.arms import read_arm_recording
from pendulum_env.recording import Recording, RecordingError, read_recording
from pendulum_env.recording.notes import NoteKind

START = 1_700_000_000.25  # [s] since 1970
CLOCKS: dict[str, Callable] = {
    "s": lambda time: START + time,
    "ms": lambda time: np.round(1e3 * (START + time), 3),
    "us": lambda time: np.round(1e6 * (START + time)),
    "ns": lambda time: np.int64(START * 1e9) + np.round(1e9 * time).astype(np.int64),
}


def motion(rate: float, seconds: float = 4.0) -> dict[str, np.ndarray]:
    time = np.arange(round(rate * seconds)) / rate
    return {"time": time, "position": np.sin(5 * time), "torque": np.sign(np.sin(40 * time))}


@pytest.mark.parametrize("unit", CLOCKS)
@pytest.mark.parametrize("rate", [50, 333.3, 8000])
def test_a_clock_since_1970_is_read_as_one_from_0(tmp_path: Path, rate: float, unit: str) -> None:
    run = motion(rate)
    np.savez(tmp_path / "run.npz", **run | {"time": CLOCKS[unit](run["time"])})
    recording = read_recording(tmp_path / "run.npz")
    assert recording.time[0] == 0.0
    np.testing.assert_allclose(recording.time, run["time"], rtol=0, atol=2e-6)
    np.testing.assert_array_equal(recording.position, run["position"])
    assert recording.start_date is not None
    assert abs((recording.start_date - datetime.fromtimestamp(START, UTC)).total_seconds()) < 1e-5


def test_arrays_with_time_since_1970_count_from_the_first_sample_and_keep_their_segments() -> None:
    run, kept = motion(500), np.r_[0:800, 1200:2000]
    recording = Recording(*((START * (name == "time") + v)[kept] for name, v in run.items()), starts=(0, 800))
    np.testing.assert_allclose(recording.time, run["time"][kept], rtol=0, atol=1e-6)
    assert recording.starts == (0, 800)
    assert recording.start_date is not None and recording.start_date.year == 2023


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_arrays_of_dates_and_of_durations_count_in_seconds(tmp_path: Path, unit: str) -> None:
    run = motion(100)
    passed = np.round(1000 * run["time"]).astype("timedelta64[ms]").astype(f"timedelta64[{unit}]")
    date = np.datetime64("2026-03-01T12:00:00.250", "ms")
    for time, start in ((passed, None), (date + passed, datetime(2026, 3, 1, 12, 0, 0, 250_000, UTC))):
        np.savez(tmp_path / "run.npz", **run | {"time": time})
        own = Recording(time, run["position"], run["torque"], name="run")
        for recording in (own, read_recording(tmp_path / "run.npz")):
            np.testing.assert_allclose(recording.time, run["time"], rtol=0, atol=1e-9)
            assert recording.start_date == start


def test_the_date_is_that_of_the_first_row_that_is_kept() -> None:
    run, first = motion(100), np.datetime64("2026-03-01T12:00:00", "ms")
    stamps = first + np.round(1000 * run["time"]).astype("timedelta64[ms]")
    late = run | {"time": stamps, "torque": np.where(run["time"] < 0.5, np.nan, run["torque"])}
    undated = run | {"time": np.r_[np.datetime64("NaT"), stamps[1:]]}
    for log, passed in ((late, 0.5), (undated, 0.01)):
        assert read_recording(log).start_date == datetime(2026, 3, 1, 12, tzinfo=UTC) + timedelta(seconds=passed)


def test_a_time_that_falls_is_told_with_digits_that_differ() -> None:
    run = motion(1000)
    time = START + run["time"]
    time[2000] = time[1999] - 0.001
    with pytest.raises(RecordingError, match="time falls from") as refusal:
        read_recording(run | {"time": time})
    before, after = str(refusal.value).split("time falls from ")[1].split(" s at")[0].split(" to ")
    assert float(before) - float(after) == pytest.approx(0.001, abs=1e-6)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_a_clock_of_another_unit_is_refused_with_the_plausible_one(factor: float, unit: str) -> None:
    run = motion(1000)
    log = run | {"time": factor * run["time"]}
    with pytest.raises(RecordingError, match=f"too long for a pendulum.*time=time:{unit} "):
        read_recording(log)
    assert read_recording(log, columns={"time": f"time:{unit}"}).rate == pytest.approx(1000)


def test_joints_of_an_arm_share_a_clock_since_1970() -> None:
    run = motion(250)
    columns = {f"{quantity}_{joint}": run[quantity] for quantity in ("position", "torque") for joint in ("hip", "knee")}
    recording = read_arm_recording(columns | {"time": CLOCKS["us"](run["time"])}, ["hip", "knee"])
    np.testing.assert_allclose(recording.time, run["time"], rtol=0, atol=2e-6)
    assert recording.start_date is not None and recording.start_date.year == 2023
    assert len(recording.joints[1]) == len(run["time"])


@pytest.mark.parametrize("jitter", [0.1, 0.4])  # of a period
def test_late_stamps_of_uniform_samples_are_replaced_by_the_uniform_clock(jitter: float) -> None:
    run, rng = motion(500, 10.0), np.random.default_rng(1)
    run["time"] = np.sort(run["time"] + 0.002 * jitter * rng.standard_normal(5000))
    whole = read_recording(run)
    assert whole.rate == pytest.approx(500, rel=1e-5) and whole.starts == (0,)
    np.testing.assert_array_equal(whole.position, run["position"])
    np.testing.assert_array_equal(whole.torque, run["torque"])
    assert [note.kind for note in whole.notes] == [NoteKind.STAMPS_LATE]


def test_rows_that_are_lost_remain_gaps_though_stamps_are_late() -> None:
    run, rng = motion(500, 10.0), np.random.default_rng(2)
    lost = np.r_[1000, 1600:1602, 2500:3000]
    stamps = run["time"] + 2e-4 * rng.standard_normal(5000)
    recording = read_recording({name: np.delete(v, lost) for name, v in (run | {"time": stamps}).items()})
    assert recording.rate == pytest.approx(500, rel=1e-5) and recording.starts == (0, 2500)
    np.testing.assert_allclose(recording.position, np.delete(run["position"], lost[3:]), rtol=0, atol=1e-6)
    np.testing.assert_allclose(recording.time, np.delete(run["time"], lost[3:]), rtol=0, atol=2e-4)


@pytest.mark.parametrize("accumulates", [False, True])
def test_stamps_of_samples_that_were_taken_unevenly_stand(accumulates: bool) -> None:
    rng = np.random.default_rng(3)
    uneven = 4e-4 * rng.standard_normal(5000)
    time = np.sort(np.arange(5000) / 500 + (np.cumsum(uneven) if accumulates else uneven))
    recording = read_recording({"time": time, "position": np.sin(5 * time), "torque": np.ones(5000)})
    assert NoteKind.STAMPS_LATE not in [note.kind for note in recording.notes]
    np.testing.assert_allclose(recording.position, np.sin(5 * (recording.time + time[0])), rtol=0, atol=1e-5)


def test_stamps_stand_where_motion_cannot_tell_if_samples_are_uniform() -> None:
    rng = np.random.default_rng(4)
    time = np.arange(2000) / 500
    coarse = 1e-3 * np.round(1e3 * 0.01 * np.sin(2 * time))
    log = {"time": time + 1e-4 * rng.standard_normal(2000), "position": coarse, "torque": np.ones(2000)}
    assert NoteKind.STAMPS_LATE not in [note.kind for note in read_recording(log).notes]


def test_rows_left_out_for_a_repeated_stamp_keep_their_time() -> None:
    run, rng = motion(500, 10.0), np.random.default_rng(5)
    stamps = np.maximum.accumulate(run["time"] + 6e-4 * rng.exponential(size=5000))  # late rows wait for each other
    recording = read_recording(run | {"time": stamps})
    assert recording.rate == pytest.approx(500, rel=1e-4) and recording.starts == (0,)
    np.testing.assert_allclose(recording.position, run["position"][: len(recording.time)], rtol=0, atol=1e-4)
