import numpy as np
import pytest

from benchmarks import six_joint
from estimators.data.fit_data import FitData
from estimators.selection.criterion import Criterion
from estimators.selection.residuals import Residuals
from pendulum_env.arms.joints import arm_base


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
