"""A fleet is judged by what was hidden in it: what was found, what was not, and what is not so."""

from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from estimators.fleet import course

pytest.importorskip("distributed")
pytest.importorskip("psutil")  # comes with it

from benchmarks import fleet as benchmark
from benchmarks.fleet import Judged
from benchmarks.survey import BEGAN, Plan, day
from workbench.survey import Fleet
from workbench.survey.fleet import Joint, Missing, Series

PLAN = Plan(joints=10, weeks=12, drifting=1, broken=1)


def joint(label):
    robot, name = label.split(" / ")
    return Joint(robot, name, name)


def missing(label, effect, since=None, significant=True):
    return Missing(joint(label), effect, 6, 12, BEGAN, since, significant)


def drifting(label, parameter):
    one = np.ones(1)
    return Series(joint(label), parameter, "N m", one, one, one, course(one, one, one), changes=True)


def fleet(**said):
    return Fleet(Path("out"), **said)


def test_all_that_was_hidden_and_nothing_else_is_right():
    drifts = drifting("arm0 / joint0", "coulomb")
    judged = Judged.of(fleet(series=(drifts,), effects=(missing("arm1 / joint4", "stribeck", day(6)),)), PLAN)
    assert judged.told == judged.wanted and not judged.false
    assert judged.wanted == {
        ("arm0 / joint0", "coulomb drifts"),
        ("arm1 / joint4", "stribeck is missing"),
        ("arm1 / joint4", "stribeck since 2026-02-16"),
    }


def test_another_date_parameter_joint_or_effect_is_a_false_alarm_and_what_may_be_chance_is_none():
    drifts = drifting("arm0 / joint0", "gravity")
    effects = (
        missing("arm1 / joint4", "stribeck", day(6) + timedelta(weeks=1)),
        missing("arm1 / joint3", "cogging"),
        missing("arm1 / joint2", "spring", significant=False),
    )
    judged = Judged.of(fleet(series=(drifts,), effects=effects), PLAN)
    assert judged.told == {("arm1 / joint4", "stribeck is missing")}
    assert judged.false == {
        ("arm0 / joint0", "gravity drifts"),
        ("arm1 / joint4", "stribeck since 2026-02-23"),
        ("arm1 / joint3", "cogging is missing"),
    }


def test_too_few_recordings_are_one_line(capsys):
    with pytest.raises(SystemExit):
        benchmark.main(["--n", "60"])
    assert "there are to be four of each" in capsys.readouterr().err.splitlines()[-1]
