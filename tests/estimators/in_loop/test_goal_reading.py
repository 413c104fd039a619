"""Goals of servos that the base model leaves open: the found model decides whether the other reading is searched."""

from dataclasses import replace

import pytest

from estimators.data.fit_data import FitData
from estimators.diagnosis.case import Trial
from estimators.diagnosis.setting import Setting
from estimators.findings import Finding, Kind, Quantity
from estimators.in_loop.case import SERVO
from estimators.in_loop.goal_reading import reread_goals
from estimators.in_loop.goals import with_goals
from pendulum_env.physics import BASE, effects
from tests.estimators.in_loop.test_in_loop import logged_slowly

TILT = 0.1  # [rad], of horns that the models lack


@pytest.mark.parametrize("is_held", [True, False])
def test_goals_are_read_the_other_way_only_if_the_found_model_predicts_better_so(is_held):
    """The goals are held. The tilt leaves an error under either reading."""
    straight = [logged_slowly(True, 0.0, kp, k) for k, kp in enumerate((4.0, 7.0, 5.0))]
    tilted = [replace(own, position=own.position + TILT, reference=own.reference + TILT) for own in straight]
    first, second, last = with_goals(tilted, is_held)
    tie = Finding(Kind.GOALS_HELD if is_held else Kind.GOALS_RUN_ON, {"gain": Quantity(0.0, 1.0)})
    data = FitData.from_recordings([first, second], [last], BASE).with_treatment(tie)
    changed = reread_goals(Trial.search(SERVO, data, Setting(BASE, {"dead_time": effects()["dead_time"]})))
    goals = None if changed is None else {own.drive.goal for own in changed.recordings if own.drive}
    assert goals == (None if is_held else {"held"})
