"""Clocks that logs have: since 1970 in any unit, since start-up, with few digits; time counts from the first sample."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.recording import Recording, RecordingError, read_recording
from pendulum_env.recording.notes import NoteKind
from robots.arms import read_arm_recording

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
    assert recording.clock_start == START


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
            assert recording.clock_start == pytest.approx(start.timestamp() if start else 0.0, abs=1e-6)


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


@pytest.mark.parametrize("rate", [100, 200, 500])
@pytest.mark.parametrize("share", [0.002, 0.01, 0.03])
@pytest.mark.parametrize("jitter", [0.05, 0.1, 0.15, 0.2])  # of a period
def test_rows_keep_their_time_beside_lost_rows_wherever_their_stamps_determine_it(
    jitter: float, share: float, rate: int
) -> None:
    run, rng = motion(rate, 20.0), np.random.default_rng(rate)
    error = jitter * rng.standard_normal(len(run["time"]))
    is_kept = rng.uniform(size=len(error)) >= share
    is_kept[[0, -1]], is_clear = True, np.abs(error) < 0.3
    stamps = np.maximum.accumulate(run["time"] + error / rate)
    recording = read_recording({name: v[is_kept] for name, v in (run | {"time": stamps}).items()})
    assert NoteKind.STAMPS_LATE in [note.kind for note in recording.notes]
    rows = np.rint(recording.time * rate).astype(int)
    assert rows[-1] == len(error) - 1
    np.testing.assert_allclose(recording.time, rows / rate, rtol=0, atol=0.02 / rate)
    is_own = (is_kept & is_clear)[rows]
    np.testing.assert_allclose(recording.position[is_own], run["position"][rows][is_own], rtol=0, atol=1e-12)


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


@pytest.mark.parametrize(("decimals", "burst"), [(3, 1), (2, 1), (9, 5), (9, 16)])
def test_samples_whose_stamps_repeat_are_read_on_the_uniform_clock(decimals: int, burst: int) -> None:
    run = motion(1027, 10.0)
    last = np.minimum(np.arange(len(run["time"])) // burst * burst + burst, len(run["time"])) - 1
    recording = read_recording(run | {"time": 1.7e9 + np.round(run["time"][last] + 0.123456, decimals)})
    assert recording.rate == pytest.approx(1027, rel=1e-4) and recording.starts == (0,)
    np.testing.assert_array_equal(recording.position, run["position"])


@pytest.mark.parametrize(("rate", "burst"), [(500, 2), (500, 16), (1027, 5), (1027, 16)])
def test_rows_lost_inside_bursts_keep_their_time(rate: int, burst: int) -> None:
    run, lost = motion(rate, 10.0), np.array([1001, 3007, 3700])
    last = np.minimum(np.arange(len(run["time"])) // burst * burst + burst, len(run["time"])) - 1
    log = {name: np.delete(v, lost) for name, v in (run | {"time": run["time"][last]}).items()}
    recording = read_recording(log)
    assert recording.rate == pytest.approx(rate, rel=1e-5) and recording.starts == (0,)
    np.testing.assert_allclose(recording.position, run["position"], rtol=0, atol=0.01 * 5 / rate)  # of a row's motion


def test_bursts_in_nanoseconds_since_1970_are_recognised() -> None:
    run = motion(500, 10.0)
    stamps = 1_700_000_000_123_456_789 + (np.arange(5000) // 5) * 10_000_000
    assert read_recording(run | {"time": stamps}).rate == pytest.approx(500, rel=1e-4)


def test_few_different_times_in_many_rows_of_motion_are_refused() -> None:
    run = motion(500, 10.0)
    with pytest.raises(RecordingError, match=r"5000 rows .* only 11 different times"):
        read_recording(run | {"time": np.round(run["time"])})


def held(rate: float, phase: float = 0.0, log_rate: float = 500.0, shift: float = 0.0) -> dict[str, np.ndarray]:
    """20 s of a log whose encoder, of 2^16 counts, samples at another rate and holds its value; it rests in between."""
    time = np.arange(round(20 * log_rate)) / log_rate
    sampled = phase + np.floor((time - phase) * rate + 1e-9) / rate
    position, count = rest_for_a_while(sampled) + shift, 2 * np.pi / 65536
    return {"time": time, "position": count * np.round(position / count), "torque": np.cos(3 * time)}


def rest_for_a_while(time: np.ndarray) -> np.ndarray:
    return np.sin(5 * (np.minimum(time, 6.0) + np.maximum(time - 9.0, 0.0)))


@pytest.mark.parametrize(("rate", "phase"), [(100.0, 0.0), (250.0, 0.0), (130.0, 0.0031), (371.3, 0.0012)])
def test_an_encoder_slower_than_its_log_is_read_at_its_own_times(rate: float, phase: float) -> None:
    log = held(rate, phase)
    recording = read_recording(log, columns={"position": "position:rad"})
    assert [note.kind for note in recording.notes] == [NoteKind.ENCODER_SLOW]
    assert recording.rate == pytest.approx(rate, rel=1e-6)
    sampled = recording.time + phase
    np.testing.assert_allclose(recording.position, rest_for_a_while(sampled), rtol=0, atol=3e-4)
    mean = np.cos(3 * (sampled + 0.5 / rate - 0.001))  # of torque that is held for 2 ms
    np.testing.assert_allclose(recording.torque[1:-1], mean[1:-1], rtol=0, atol=1e-3)
    window = np.sin(np.pi * (sampled - sampled[0]) / (sampled[-1] - sampled[0])) ** 2  # a smooth weight
    exact = np.interp(log["time"] + 0.001, sampled + 0.5 / rate, window, left=0.0, right=0.0) @ log["torque"] / 500.0
    assert window @ recording.torque / rate == pytest.approx(exact, abs=2e-4)


def test_torque_with_the_clock_of_a_slow_encoder_is_taken_with_its_samples() -> None:
    log = held(130.0, 0.0031)
    number = np.floor((log["time"] - 0.0031) * 130.0).astype(int) + 1
    steps = np.random.default_rng(5).standard_normal(number[-1] + 1)
    recording = read_recording(log | {"torque": steps[number]}, columns={"position": "position:rad"})
    np.testing.assert_array_equal(recording.torque, steps[1 : len(recording) + 1])


def test_runs_of_a_slow_encoder_keep_their_seams() -> None:
    runs = [
        held(130.0, 0.0031) | {"segment": np.zeros(10_000)},
        held(130.0, 0.0052, shift=2) | {"segment": np.ones(10_000)},
    ]
    runs[0]["position"][-400:] = runs[0]["position"][-401]  # at rest before the seam
    recording = read_recording({name: np.concatenate([run[name] for run in runs]) for name in runs[0]})
    first, second = recording.segments
    assert recording.rate == pytest.approx(130.0, rel=1e-6)
    assert np.abs(first.position).max() < 1.01 and second.position.min() > 0.99


@pytest.mark.parametrize("rate", [100.0, 250.0, 371.3])
def test_a_run_whose_samples_have_no_known_time_is_left_out_with_a_note(rate: float) -> None:
    long = held(rate, 0.0012)
    slow = {name: column[:2000] for name, column in long.items()}
    slow["position"] = slow["position"][0] + 1e-4 * (slow["time"] > 2)
    short = [{name: column[:length] for name, column in long.items()} for length in range(1, 13)]
    runs = [run for other in (*short, slow) for run in (long, other)]
    labels = np.repeat(np.arange(len(runs)) % 3, [len(run["time"]) for run in runs])  # labels that recur
    log = {name: np.concatenate([run[name] for run in runs]) for name in long} | {"segment": labels}
    recording = read_recording(log, columns={"position": "position:rad"})
    alone = read_recording(long, columns={"position": "position:rad"})
    assert len(recording.segments) == len(runs) // 2
    for part in recording.segments:
        np.testing.assert_allclose(part.position, alone.position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(part.torque, alone.torque, rtol=0, atol=1e-3)
    note = next(note for note in recording.notes if note.kind is NoteKind.SPOILT)
    assert note.places[0] == 10_001 and note.numbers["count"].value >= 2000 + 1 + 2


def test_goals_of_a_loop_keep_their_rows_beside_a_slow_encoder() -> None:
    log = held(100.0, 0.004)
    goal = np.sign(np.sin(7 * log["time"]))
    recording = read_recording(log | {"reference": goal}, columns={"position": "position:rad"})
    np.testing.assert_array_equal(recording.reference, goal)
    assert recording.rate == pytest.approx(500.0)


@pytest.mark.parametrize("rate", [100.0, 130.0, 500.0])
def test_joints_of_an_arm_keep_common_rows_beside_a_slow_encoder(rate: float) -> None:
    hip, knee = held(100.0), held(rate, 0.004 * (rate < 500.0))
    columns = {f"{name}_{joint}": log[name] for joint, log in (("hip", hip), ("knee", knee)) for name in list(log)[1:]}
    recording = read_arm_recording(columns | {"time": hip["time"]}, ["hip", "knee"])
    np.testing.assert_allclose(recording.time, hip["time"], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(recording.position, np.column_stack([hip["position"], knee["position"]]))


@pytest.mark.parametrize("counts", [64, 512])
def test_a_coarse_encoder_in_slow_motion_is_as_fast_as_its_log(counts: int) -> None:
    time, count = np.arange(20_000) / 1000, 2 * np.pi / counts
    slow = np.concatenate([np.sin(0.7 * time[:10_000]), np.sin(7.0) + 0.1 * (time[10_000:] - 10.0)])
    log = {"time": time, "position": count * np.round(slow / count), "torque": np.cos(time)}
    recording = read_recording(log, columns={"position": "position:rad"})
    np.testing.assert_array_equal(recording.position, log["position"])
    assert recording.notes == ()
