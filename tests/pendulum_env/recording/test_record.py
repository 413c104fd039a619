"""The record: what it refuses, and its segments of one period between gaps."""

import numpy as np
import pytest

from pendulum_env.recording import Load, Recording, RecordingError

RATE = 500.0  # [Hz]
LENGTHS = (700, 2, 900, 400)


@pytest.fixture
def gappy() -> Recording:
    """Four segments, with gaps that are no multiples of the period."""
    gaps = np.repeat([0.0, 0.0131, 0.7, 3.14159], LENGTHS)
    time = np.arange(sum(LENGTHS)) / RATE + np.cumsum(np.diff(gaps, prepend=0.0))
    told = {
        "reference": np.sin(time + 0.01),
        "load_torque": np.cos(2 * time),
        "load": Load(0.02, 1.0),
        "notes": ("as it came",),
    }
    starts = tuple(np.cumsum((0, *LENGTHS[:-1])))
    return Recording(time, np.sin(time), np.cos(3 * time), np.cos(time), starts=starts, **told, name="gappy")


def test_segments_are_recordings_without_gaps_that_hold_every_sample(gappy: Recording) -> None:
    parts = gappy.segments
    assert [len(part) for part in parts] == list(LENGTHS)
    for quantity in ("time", "position", "torque", "velocity", "reference", "load_torque"):
        np.testing.assert_array_equal(np.concatenate([getattr(p, quantity) for p in parts]), getattr(gappy, quantity))
    for part in parts:
        assert (part.starts, part.name, part.load, part.notes) == ((0,), "gappy", gappy.load, gappy.notes)
        assert part.rate == pytest.approx(RATE)
        assert part.segments == (part,)


def test_gaps_count_neither_for_rate_nor_for_duration(gappy: Recording) -> None:
    assert gappy.rate == pytest.approx(RATE, rel=1e-12)
    assert gappy.duration == pytest.approx(sum(n - 1 for n in LENGTHS) / RATE)
    assert gappy.summary == "4 s at 500 Hz, 2002 samples in 4 segments"


@pytest.mark.parametrize(
    ("start", "stop", "lengths"),
    [
        (None, 700, (700,)),
        (10, 702, (690, 2)),
        (699, None, (2, 900, 400)),  # one sample of the first is no segment
        (700, 703, (2,)),
        (701, -399, (900,)),
        (5, -5, (695, 2, 900, 395)),
    ],
)
def test_a_slice_keeps_the_gaps(gappy: Recording, start: int | None, stop: int | None, lengths: tuple) -> None:
    part = gappy.slice(start, stop)
    assert tuple(len(segment) for segment in part.segments) == lengths
    assert set(part.time) <= set(gappy.time[start:stop])


@pytest.mark.parametrize(("start", "stop"), [(699, 701), (2001, None), (9, 3)])
def test_a_slice_needs_two_samples_of_one_segment(gappy: Recording, start: int, stop: int | None) -> None:
    with pytest.raises(RecordingError, match="needs at least 2"):
        gappy.slice(start, stop)


def test_a_split_keeps_the_gaps_and_gives_every_sample_to_one_part(gappy: Recording) -> None:
    first, rest = gappy.split(0.5)
    assert [len(part) for part in (*first.segments, *rest.segments)] == [700, 2, 299, 601, 400]
    np.testing.assert_array_equal(np.concatenate([first.time, rest.time]), gappy.time)
    with pytest.raises(ValueError, match="read-only"):
        first.position[0] = 1.0
    for fraction in (0.0, 1.5):
        with pytest.raises(RecordingError, match="both parts need at least 2"):
            gappy.split(fraction)


WHOLE = np.arange(100.0)
TOLD = {"starts": (0, 100)}


@pytest.mark.parametrize(
    ("time", "change", "match"),
    [
        (WHOLE, {"torque": np.zeros(4)}, r"torque of shape \(4,\) with time of shape \(100,\)"),
        (WHOLE, {"velocity": np.where(WHOLE == 2, np.nan, WHOLE)}, "velocity that is not finite"),
        (WHOLE, {"position": np.array(["a"] * 100)}, "position that is not numbers"),
        (WHOLE[:1], {}, "holds 1 samples and needs at least 2"),
        (np.array([0, 1, 2, 3, 5.0]), {}, "not uniform and increasing"),
        (WHOLE[::-1], {}, "not uniform and increasing"),
        (np.append(WHOLE, 200 + WHOLE), {}, "not uniform and increasing"),  # a gap that is not told
        (np.append(WHOLE, WHOLE + 50), TOLD, "not uniform and increasing"),  # back in time
        (np.append(WHOLE, 200 + 1.001 * WHOLE), TOLD, "not uniform and increasing"),  # another period
        (np.append(WHOLE, 99 + WHOLE), TOLD, "not uniform and increasing"),  # a time twice
        *((WHOLE, {"starts": starts}, "segments that start at") for starts in ((), (1,), (0, 1), (0, 50, 40), (0, 99))),
    ],
)
def test_record_refuses(time: np.ndarray, change: dict, match: str) -> None:
    good = dict.fromkeys(("time", "position", "torque"), time)
    with pytest.raises(RecordingError, match=match):
        Recording(**(good | change), name="r")


@pytest.mark.parametrize(("inertia", "gravity"), [(-0.1, 0), (np.inf, 0), (0, np.nan)])
def test_a_load_is_a_body(inertia: float, gravity: float) -> None:
    with pytest.raises(RecordingError, match="a load has"):
        Load(inertia, gravity)
