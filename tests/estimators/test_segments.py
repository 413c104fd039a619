"""A gap ends a segment: nothing reaches across it, and what stands clear of it is as if there were none."""

from itertools import pairwise

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.fits import fit_terms
from estimators.data.model_errors import compute_errors
from estimators.data.regression_data import RegressionData
from estimators.simulation.free_running import choose_segments
from estimators.simulation.multiple_shooting import list_adjacent_segments
from estimators.weak_form.traces import trace_all
from estimators.weak_form.window_columns import WindowColumns, WindowTorque
from estimators.weak_form.windows import cut
from pendulum_env.physics import BASE
from pendulum_env.physics.actuation import ActuatorLag
from pendulum_env.physics.friction import Presliding
from pendulum_env.recording import Recording, read_recording
from tests.cases import diagnosed, recorded


@pytest.fixture(scope="module")
def whole() -> Recording:
    """Ten seconds with Stribeck friction, from an independent simulator."""
    plant = Plant(effects={"stribeck": {"strib_d": 0.4, "strib_v": 0.5}})
    return recorded(plant, Experiment(rate=500.0, seconds=10.0, seed=3))[0]


def with_gaps(recording: Recording, gaps: list[tuple[int, int]]) -> Recording:
    """The recording without the samples of each gap."""
    kept = np.ones(len(recording), dtype=bool)
    for first, stop in gaps:
        kept[first:stop] = False
    index = np.flatnonzero(kept)
    starts = (0, *(np.flatnonzero(np.diff(index) > 1) + 1).tolist())
    return Recording(
        recording.time[index], recording.position[index], recording.torque[index], starts=starts, name="gaps"
    )


@pytest.fixture(scope="module")
def gapped(whole) -> Recording:
    return with_gaps(whole, [(900, 1000), (2300, 2301), (2307, 2500), (3600, 3850)])


def test_windows_that_do_not_touch_a_gap_are_those_of_the_whole_recording(whole, gapped):
    full, parts = cut(whole, 0.012), cut(gapped, 0.012)
    centers = (np.round(one.select_center_samples().time, 6) for one in (full, parts))
    shared, of_full, of_parts = np.intersect1d(*centers, return_indices=True)
    assert len(shared) > 100
    for term in BASE:
        ((left, _),), ((right, _),) = (WindowColumns([w]).columns([term]) for w in (full, parts))
        assert right[of_parts] == pytest.approx(left[of_full], rel=1e-9, abs=1e-9)
    left, right = (WindowTorque([w]).recorded for w in (full, parts))
    assert right[of_parts] == pytest.approx(left[of_full], rel=1e-12)


def test_no_window_and_no_simulated_stretch_reaches_across_a_gap(gapped):
    windows = cut(gapped, 0.012)
    bounds = list(pairwise((*gapped.starts, len(gapped))))

    def within(first, last):
        return all(any(b <= f and stop < e for b, e in bounds) for f, stop in zip(first, last, strict=True))

    reach = len(windows.kernel) // 2 + 1
    assert within(windows.centers - reach, windows.centers + reach)
    segments = choose_segments(windows)
    assert within(segments.first, segments.first + len(segments.torque))
    assert len(segments.first) >= 5
    starts = list_adjacent_segments(windows)
    assert within(starts, starts + 100)


@pytest.mark.parametrize("term", [ActuatorLag(0.02), Presliding(0.05)])
def test_memory_starts_anew_in_each_segment(gapped, term):
    windows = cut(gapped, 0.012)
    (state,) = trace_all([windows], [term])[0][0].memory[term.id]
    for begin, end in pairwise((*gapped.starts, len(gapped))):
        if end - begin > 60:
            alone = cut(gapped.slice(begin, end), 0.012)
            (own,) = trace_all([alone], [term])[0][0].memory[term.id]
            assert state[begin:end] == pytest.approx(own, abs=0.05 * np.abs(own).max())


def test_lost_rows_gaps_and_a_jittering_clock_change_no_verdict_and_no_parameter(whole, tmp_path):
    rng = np.random.default_rng(7)
    time = whole.time + np.clip(rng.normal(0.0, 0.1, len(whole)), -0.45, 0.45) / whole.rate
    kept = rng.random(len(whole)) > 0.02
    for begin in np.arange(1.5, 9.5, 2.0):
        kept &= (time < begin) | (time > begin + rng.uniform(0.02, 0.5))
    rows = np.column_stack([time, np.interp(time, whole.time, whole.position), whole.torque])[kept]
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,position,torque", comments="")
    verdict, found = diagnosed(whole), diagnosed([read_recording(tmp_path / "log.csv")])
    assert found.selected == verdict.selected == ("stribeck",)
    for name, estimate in verdict.model.estimates.items():
        other = found.model.estimates[name]
        assert abs(estimate.value - other.value) < 2 * np.hypot(estimate.std, other.std)


def test_seconds_that_were_glued_together_are_simulated_in_segments_that_fit_in(whole):
    """Steps of a second with gaps between them, as some benches log them."""
    glued = with_gaps(whole, [(first - 6, first) for first in range(500, len(whole), 500)])
    data = RegressionData.from_recordings([glued])
    model, _ = fit_terms(data, BASE)
    assert len(data.segments[0].first) >= 9
    assert np.isfinite(compute_errors(data, model).position_rms)
