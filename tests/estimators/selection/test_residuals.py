from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import six_joint
from estimators.data.fit_data import FitData
from estimators.decisions.criterion import Criterion
from estimators.selection.residuals import Residuals, set_grid
from pendulum_env.physics import BASE, Samples
from pendulum_env.physics.table import Extent, TorqueByAngle
from robots.arms import arm_base


def test_held_out_data_update_the_parameters_of_an_arm_with_more_parameters_than_blocks(monkeypatch):
    """An arm with coarse encoders and a short recording: the update lowers the held-out errors of all joints."""
    pytest.importorskip("mujoco")
    monkeypatch.setattr(six_joint, "COUNTS", 2**12)
    base = arm_base(six_joint.body())
    data = FitData.from_recordings([six_joint.simulate(1, seconds=14.0, rate=200.0)], (), base)
    residuals = Residuals(*data.parts, Criterion(), base)
    train, holdout = data.parts
    before, after = holdout.equations(base).error(train.solve(base)), residuals.holdout_residual(base)
    for at in residuals.joints:
        rows = holdout.layout.joints[at]
        assert np.linalg.norm(after[rows]) < 1.02 * np.linalg.norm(before[rows]), at
    assert residuals.is_noise(base)


def test_a_table_keeps_its_range_if_nearly_all_held_out_angles_are_in_one_piece():
    """Held-out data 2 rad beyond the table, with one excursion, have too few angles for a table of their own."""
    position = np.r_[np.full(5000, 3.0), np.linspace(3.0, 2.0, 20)]
    part = SimpleNamespace(samples=Samples(np.arange(5020) / 200, position, 0 * position, 0 * position))
    table = TorqueByAngle.with_extent(Extent(-1.0, 1.0, 12))()
    data = SimpleNamespace(data=SimpleNamespace(part=lambda at: part))
    assert not table.covers(part.samples) and set_grid(data, (*BASE, table)) == (*BASE, table)
