"""Reading a log that lost samples, or whose samples cannot all be true: no gap is a reason to refuse."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendulum_env.recording import RecordingError, read_recording
from tests.notes import list_notes

Columns = dict[str, np.ndarray]
COUNT = 2 * np.pi / 16384  # [rad] of a 14-bit encoder


def motion(time: np.ndarray) -> Columns:
    """A smooth run at any times [s]."""
    position = np.sin(7 * time) + 0.6 * np.sin(2.3 * time + 1)
    velocity = 7 * np.cos(7 * time) + 0.6 * 2.3 * np.cos(2.3 * time + 1)
    return {"time": time, "position": position, "velocity": velocity, "torque": 2 * np.cos(7 * time + 0.3)}


@pytest.fixture
def columns() -> Columns:
    """5 s at 1 kHz."""
    return motion(np.arange(5000) / 1000)


def without(columns: Columns, gone: np.ndarray) -> Columns:
    return {quantity: np.delete(values, gone) for quantity, values in columns.items()}


def test_gaps_end_segments_and_are_told() -> None:
    rng = np.random.default_rng(2)
    whole = motion(np.arange(30_000) / 1000)
    begins = 2000 + 2500 * np.arange(10)
    lengths = rng.integers(10, 500, 10)
    gone = np.concatenate([np.arange(a, a + n) for a, n in zip(begins, lengths, strict=True)])
    recording = read_recording(without(whole, gone))
    assert recording.starts == (0, *(begins - np.concatenate([[0], np.cumsum(lengths[:-1])])))
    assert recording.rate == pytest.approx(1000)
    np.testing.assert_array_equal(recording.position, np.delete(whole["position"], gone))
    (note,) = list_notes(recording)
    assert note.startswith("10 gaps of 0.0") and "after 1.999, 4.499, 6.999, 9.499, 11.999 s and 5 more times" in note


def test_a_long_hole_is_a_gap_where_the_motion_is_fast_for_the_rate() -> None:
    time = np.arange(1000) / 50
    gone = [300, 301, 600, 601, 602]
    fast = motion(3 * time) | {"time": time, "velocity": 3 * motion(3 * time)["velocity"]}
    assert len(read_recording(without(fast, gone)).starts) == 3
    slow = motion(0.1 * time) | {"time": time, "velocity": 0.1 * motion(0.1 * time)["velocity"]}
    assert len(read_recording(without(slow, gone)).starts) == 1
    assert len(read_recording(without(slow, [*gone, 900, 901, 902, 903])).starts) == 2  # torque may have changed


def test_segments_too_short_to_use_are_left_out_and_told_and_refused_where_there_are_no_others(columns) -> None:
    gone = np.concatenate([np.arange(2000, 2100), np.arange(2150, 2300)])  # leaves 50 samples between
    recording = read_recording(without(columns, gone))
    assert [len(part) for part in recording.segments] == [2000, 2700]
    assert "50 samples in a segment shorter than 0.2 s are left out" in list_notes(recording)
    time = np.concatenate([np.arange(50) / 1000 + second for second in range(20)])
    with pytest.raises(RecordingError, match=r"none of its 20 segments lasts 0\.2 s"):
        read_recording(motion(time))


def test_cells_that_are_empty_are_as_good_as_lost(columns) -> None:
    columns["torque"][100] = np.nan
    columns["position"][2000:2400] = np.nan
    columns["velocity"][4000] = np.inf
    recording = read_recording(columns)
    assert [len(part) for part in recording.segments] == [2000, 2600]
    truth = motion(recording.time)
    for quantity in ("position", "torque", "velocity"):
        np.testing.assert_allclose(getattr(recording, quantity), truth[quantity], atol=1e-4)
    assert "torque is empty or NaN in data row 101: left out" in list_notes(recording)
    rows = "2001, 2002, 2003, 2004, 2005 and 395 more"
    assert f"position is empty or NaN in 400 data rows ({rows}): left out" in list_notes(recording)


def test_an_optional_column_that_is_mostly_empty_is_left_out(columns) -> None:
    columns["velocity"][np.arange(5000) % 10 > 0] = np.nan
    recording = read_recording(columns)
    assert recording.velocity is None and len(recording) == 5000
    assert list_notes(recording) == ("velocity is left out: it is empty or NaN in 4500 of 5000 rows",)


def test_a_log_that_was_cut_off_is_read_up_to_there(tmp_path: Path, columns: Columns) -> None:
    lines = [",".join(columns), *(",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True))]
    (tmp_path / "run.csv").write_text("\n".join([*lines[:-1], "4.99"]))
    recording = read_recording(tmp_path / "run.csv")
    np.testing.assert_array_equal(recording.position, columns["position"][:-1])
    assert list_notes(recording) == ("the last row is cut off: left out",)


def test_topics_in_rows_of_their_own_are_brought_together(tmp_path: Path, columns: Columns) -> None:
    """As PlotJuggler merges them: a row a message, other cells empty."""
    time, late = columns["time"], 0.0004
    torque = np.floor(5 * np.sin(3 * time))  # held
    speed = motion(time[::10] + 2 * late)["velocity"]
    rows = [(t, q, "", "") for t, q in zip(time, columns["position"], strict=True)]
    rows += [(t - 1e-3 + late, "", u, "") for t, u in zip(time, torque, strict=True)]
    rows += [(t + 2 * late, "", "", v) for t, v in zip(time[::10], speed, strict=True)]
    lines = [",".join(map(str, row)) for row in sorted(rows, key=lambda row: row[0])]
    header = "__time,/arm/elbow/position,/motor/torque,/arm/elbow/velocity"
    (tmp_path / "run.csv").write_text("\n".join([header, *lines]))
    recording = read_recording(tmp_path / "run.csv")
    np.testing.assert_array_equal(recording.position, columns["position"])
    np.testing.assert_array_equal(recording.torque, torque)
    np.testing.assert_allclose(recording.velocity[:4990], columns["velocity"][:4990], atol=0.01)
    assert "torque stands in other rows than position: taken as it was last" in list_notes(recording)


@pytest.mark.parametrize("later", [0.0, 1e-10])
def test_rows_that_came_twice_are_left_out(columns, later) -> None:
    twice = {quantity: np.repeat(values, 1 + (np.arange(5000) % 1000 == 7)) for quantity, values in columns.items()}
    twice["time"][8] += later
    recording = read_recording(twice)
    np.testing.assert_array_equal(recording.position, columns["position"])
    assert list_notes(recording)[0].startswith("time repeats that of the row before in 5 data rows (9, 1010,")


def test_a_glitch_of_one_sample_is_left_out_and_told(columns) -> None:
    truth = columns["position"].copy()
    columns["position"][[777, 3000]] += [1.0, -2000.0]
    recording = read_recording(columns)
    np.testing.assert_allclose(recording.position, truth, atol=1e-6)
    assert list_notes(recording)[0] == "position jumps for one sample in 2 data rows (778 and 3001): left out"


@pytest.mark.parametrize("run", [1, 2, 30])
def test_a_value_that_stays_behind_the_motion_is_left_out_and_told(run: int) -> None:
    time = np.arange(5000) / 1000
    columns = motion(time) | {"position": COUNT * np.round((9 * time + np.sin(time)) / COUNT)}
    columns["velocity"] = 9 + np.cos(time)
    truth = columns["position"].copy()
    columns["position"][3000 : 3000 + run] = columns["position"][2999]
    recording = read_recording(columns, columns={"position": "position:rad"})
    assert list_notes(recording)[0].startswith("position stays behind while the joint moves on in")
    assert len(recording.starts) == 1 + (run > 3)
    kept = np.isin(time, recording.time)
    assert np.abs(recording.position - truth[kept]).max() < 2 * COUNT
    assert np.count_nonzero(~kept) == (run if run > 3 else 0)


@pytest.mark.parametrize(("rate", "run"), [(1000, 50), (1000, 500), (500, 100), (100, 12)])
def test_a_value_that_freezes_in_any_motion_leaves_a_gap(rate: int, run: int) -> None:
    columns = motion(np.arange(10 * rate) / rate)
    truth, first = columns["position"].copy(), 4 * rate
    columns["position"][first : first + run] = truth[first - 1]
    recording = read_recording(columns)
    gone = np.arange(first, first + run)
    np.testing.assert_allclose(recording.position, np.delete(truth, gone), rtol=0, atol=1e-9)
    assert recording.starts == (0, first)
    assert list_notes(recording)[0].startswith("position stays behind while the joint moves on in")


@pytest.mark.parametrize("rate", [200, 1000])
def test_stale_readings_among_many_are_left_out(rate: int) -> None:
    """Every twentieth reading repeats the last one, some beside others, at all speeds."""
    rng, time = np.random.default_rng(3), np.arange(12 * rate) / rate
    truth = 1e-5 * np.round(1e5 * (np.sin(3 * time) + 0.4 * np.sin(8 * time + 1)))
    is_stale = (rng.random(len(time)) < 0.05) & (time > 0.1) & (time < time[-1] - 0.1)
    seen = truth.copy()
    for k in np.flatnonzero(is_stale):
        seen[k] = seen[k - 1]
    columns = {"time": time, "position": seen, "torque": np.cos(time)}
    recording = read_recording(columns, columns={"position": "position:rad"})
    exact = np.interp(recording.time, time, truth)
    assert np.sqrt(np.mean((recording.position - exact) ** 2)) < 0.15 * np.sqrt(np.mean((seen - truth) ** 2))
    assert len(recording) > 0.99 * len(time)


def test_a_jump_after_rest_at_the_seam_of_two_runs_is_no_frozen_value() -> None:
    parts = [motion(np.arange(5000) / 1000) for _ in range(2)]
    parts[0]["position"][-300:] = parts[0]["position"][-301]
    parts[1]["position"] += 3.0
    columns = {name: np.concatenate([part[name] for part in parts]) for name in ("time", "position", "torque")}
    recording = read_recording(columns | {"segment": np.repeat([0, 1], 5000)})
    np.testing.assert_array_equal(recording.position, columns["position"])
    assert recording.starts == (0, 5000)


def test_a_dropout_is_left_out_with_its_first_sample(columns) -> None:
    truth, gone = columns["position"].copy(), np.arange(3050, 3070)
    columns["position"][gone] = 0.0
    recording = read_recording(columns)
    np.testing.assert_array_equal(recording.position, np.delete(truth, gone))
    assert recording.starts == (0, 3050)


@pytest.mark.parametrize("count", [COUNT, 1e-12])
def test_rest_before_a_slip_in_a_coarse_log_is_true(count: float) -> None:
    time = np.arange(4000) / 20
    position = -np.cos(np.pi * np.minimum(time, 150.0) / 25)  # moves, then rests between slips
    for slip in (3200, 3500, 3700):
        position[slip:] += 0.3
        position[slip + 1 :] += 0.02
    columns = {"time": time, "position": count * np.round(position / count), "torque": np.cos(time)}
    recording = read_recording(columns, columns={"position": "position:rad"})
    assert recording.notes == ()
    np.testing.assert_array_equal(recording.position, columns["position"])


@pytest.mark.parametrize(("rate", "held", "turn"), [(100, 1, 64), (100, 1, 256), (500, 5, 2**20), (1000, 5, 2**20)])
def test_an_angle_that_repeats_before_its_wrap_is_no_frozen_value(rate: int, held: int, turn: int) -> None:
    time = np.arange(20 * rate) / rate
    turns = np.repeat((8 * time if held > 1 else time)[::held], held)
    position = 2 * np.pi / turn * np.round(turns * turn / (2 * np.pi))
    columns = {"time": time, "position": np.angle(np.exp(1j * position)), "torque": np.cos(time)}
    with pytest.raises(RecordingError, match="as an angle wrapped at 2 pi does"):
        read_recording(columns)
    assert read_recording(columns, unwrap=True).starts == (0,)


def test_what_joints_do_is_no_glitch() -> None:
    time = np.arange(5000) / 1000
    resting = np.where(time % 1 < 0.5, np.sin(np.pi * (time % 1) / 0.5), 0.0)  # moves, stops, and rests
    bouncing = np.abs(np.sin(9 * time)) + 0.1  # turned round within a sample
    toggling = COUNT * (np.arange(5000) % 97 == 0) + COUNT * np.round(np.sin(time) / COUNT)  # noise of one count
    for position in (resting, bouncing, toggling):
        columns = {"time": time, "position": position, "torque": np.cos(time)}
        assert read_recording(columns).notes == ()
    held = np.cumsum(np.where(np.arange(5000) % 500 < 30, 0.0, 9e-3))  # and goes on from where it was
    columns = {"time": time, "position": COUNT * np.round(held / COUNT), "torque": np.cos(time)}
    read = read_recording(columns, columns={"position": "position:rad"})
    np.testing.assert_array_equal(read.position, columns["position"])


def test_a_wrapped_angle_is_unwrapped_on_either_side_of_a_gap_after_which_a_joint_may_be_anywhere() -> None:
    time = np.delete(np.arange(5000) / 1000, np.arange(2000, 2400))
    turns = 11 * time + np.sin(time)
    columns = {"time": time, "position": np.angle(np.exp(1j * turns)), "torque": np.cos(time)}
    with pytest.raises(RecordingError, match="as an angle wrapped at 2 pi does"):
        read_recording(columns)
    recording = read_recording(columns, unwrap=True)
    for part, truth in zip(recording.segments, np.split(turns, [2000]), strict=True):
        off = part.position - truth
        np.testing.assert_allclose(off, off[0], atol=1e-9)
        assert np.cos(off[0]) == pytest.approx(1)
    assert read_recording(columns | {"position": turns + 40.0 * (time > 2)}).starts == (0, 2000)


@settings(max_examples=60)
@given(
    gone=st.lists(st.tuples(st.integers(0, 1990), st.integers(1, 150)), max_size=8),
    jitter=st.sampled_from([0.0, 0.0, 0.1]),
    seed=st.integers(0, 9),
)
def test_whatever_is_lost_the_rest_is_true(gone: list[tuple[int, int]], jitter: float, seed: int):
    rng = np.random.default_rng(seed)
    time = (np.arange(2000) + rng.uniform(-jitter, jitter, 2000)) / 500
    lost = np.unique(np.concatenate([np.arange(0), *(np.arange(a, min(a + n, 2000)) for a, n in gone)]))
    first = np.delete(time, lost)[0]
    recording = read_recording(without(motion(time), lost))  # of 2000 samples, 800 are left at least, in 9 pieces
    assert recording.rate == pytest.approx(500, rel=5e-3)
    np.testing.assert_allclose(recording.position, motion(first + recording.time)["position"], atol=2e-4)
    assert recording.duration >= 2000 / 500 - (len(lost) + 9 * 105) / 500
