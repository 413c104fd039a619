"""Segments: what a simulation does in many of them at once is what it does in each."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.regression_data import RegressionData
from estimators.simulation.free_running import cut_segments, simulate_all
from estimators.simulation.output_error import redraw_torque
from estimators.weak_form.traces import trace_all
from pendulum_env.physics import BASE, effect
from pendulum_env.recording import MovedTorque
from tests.cases import TRUTH, recorded


def prepared(*rates: float) -> RegressionData:
    """One recording at each rate."""
    experiments = (Experiment(rate=rate, seconds=5.0, seed=k) for k, rate in enumerate(rates))
    return RegressionData.from_recordings(recorded(Plant(), *experiments))


def test_recordings_fly_together_as_they_fly_alone():
    segments = prepared(250.0, 249.7, 400.0).segments
    lagging = (*BASE, effect("actuator_lag")(time_constant=0.02), effect("dead_time")(dead_time=0.007))
    models = [(lagging, TRUTH), (lagging, 1.1 * TRUTH)]
    for segment, paths in zip(segments, simulate_all(segments, models), strict=True):
        for k, (terms, theta) in enumerate(models):
            np.testing.assert_allclose(paths[:, k], simulate_all([segment], [(terms, theta)])[0][:, 0], atol=1e-9)


def test_torque_that_was_moved_in_time_changed_somewhere_within_a_sample():
    """The mean over a sample of a step at a time that is uniform over it has a twelfth of its square as variance."""
    (segment,) = prepared(250.0).segments
    recording, noise = segment.windows.recording, segment.windows.noise.raw_torque
    torque = np.zeros(len(recording))
    torque[segment.first + np.arange(50, 100)[:, None]] = 2.0
    known = cut_segments(segment.windows.with_torque(torque, torque), segment.first, len(segment.torque))
    moved = replace(known.windows, recording=replace(known.windows.recording, moved=MovedTorque(noise, np.ones(1))))
    rng = np.random.default_rng(0)
    for windows, expected in ((known.windows, noise), (moved, np.hypot(noise, 2.0 / np.sqrt(12)))):
        again = np.stack([redraw_torque(replace(known, windows=windows), rng) for _ in range(1000)])
        assert again[:, 50].std() == pytest.approx(expected, rel=0.1)
        assert again[:, 60].std() == pytest.approx(noise, rel=0.1)
        assert again[:, 50].mean() == pytest.approx(2.0, abs=0.05)


def test_state_along_several_recordings_is_that_along_each():
    windows = prepared(250.0, 250.0).data.windows
    kind = effect("backlash")
    variants = [kind(gap=0.01), kind(gap=0.03, gravity=15.0)]
    for w, together in zip(windows, trace_all(windows, variants), strict=True):
        for one, alone in zip(together, trace_all([w], variants)[0], strict=True):
            np.testing.assert_allclose(one.memory["backlash"], alone.memory["backlash"], atol=1e-9)
