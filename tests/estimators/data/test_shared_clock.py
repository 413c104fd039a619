"""Files of one log share its clock; recordings of their own clocks begin anew."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import compare, diagnose
from estimators.data.fit_data import FitData
from pendulum_env.recording import read_recording

WARM_UP = 6.0  # [s]


@pytest.fixture(scope="module")
def log():
    """A log of friction that falls as the joint warms up."""
    plant = Plant(effects={"friction_drift": {"drift_a": 0.6, "drift_T": WARM_UP}})
    experiment = Experiment(rate=500.0, seconds=20.0, excitation="multisine", scale=1.3)
    (run,) = simulate([(plant, experiment)])
    return {"time": run.time + 712.5, "position": run.position, "torque": run.torque}


def read_parts(log, *, second=0.0, repeated=0):
    """Read the two halves of a log, the second with another time [s] at its begin and some repeated samples."""
    halves = slice(0, 5500), slice(5500 - repeated, None)
    parts = [{name: values[half] for name, values in log.items()} for half in halves]
    parts[1]["time"] = parts[1]["time"] + second
    return [read_recording(part, name=name) for part, name in zip(parts, ("first", "second"), strict=True)]


def test_the_clock_runs_on_in_the_second_file(log):
    first, second = FitData.from_recordings(read_parts(log)).recordings
    assert first.time[0] == 0.0 and second.time[0] == pytest.approx(11.0)
    again = FitData.from_recordings([first, second]).recordings
    np.testing.assert_allclose(again[1].time, second.time)


def test_the_clock_runs_on_if_both_files_have_the_same_sample(log):
    first, second = FitData.from_recordings(read_parts(log, repeated=1)).recordings
    assert second.time[0] == pytest.approx(first.time[-1])


def test_dates_are_a_clock(log):
    dated = log | {
        "time": np.datetime64("2026-03-01T12:00", "ns") + np.round(1e9 * log["time"]).astype("timedelta64[ns]")
    }
    first, second = FitData.from_recordings(read_parts(dated, second=np.timedelta64(0, "ns"))).recordings
    assert second.time[0] - first.time[0] == pytest.approx(11.0, abs=1e-5)


@pytest.mark.parametrize("second", [-723.5, 40.0, -3.0], ids=["from zero", "after a long pause", "overlapping"])
def test_other_clocks_begin_anew(log, second):
    for recording in FitData.from_recordings(read_parts(log, second=second)).recordings:
        assert recording.time[0] == 0.0


def test_friction_that_drifts_goes_on_in_the_second_file(log):
    found = diagnose(read_parts(log), only=["friction_drift", "stribeck", "viscous_asymmetry"])
    assert found.selected == ("friction_drift",) and not found.unexplained
    warm_up = found.model.estimates["friction_drift.warm_up"]
    assert abs(warm_up.value - WARM_UP) < 4 * warm_up.std


def test_a_comparison_has_the_clock_of_the_fit(log):
    parts = read_parts(log)
    model = diagnose(parts, only=["friction_drift"]).model
    split, whole = (compare(model, data).joint.errors.torque_rms for data in (parts, read_recording(log)))
    assert split == pytest.approx(whole, rel=0.02)
