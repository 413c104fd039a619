"""An effect added at a joint, in data from SciPy's integration of the textbook's arm with air drag at the elbow."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from benchmarks.two_link import TwoLink
from estimators import IdentificationError, add, compare, diagnose, identify
from estimators.diagnosis.completeness import Incomplete
from pendulum_env.physics import ModelError
from robots.arms import arm_base
from tests.two_link import record_arm
from workbench.narrator.diagnosis import describe_addition

DRAG = 0.06  # [N m s^2/rad^2]


@pytest.fixture(scope="module")
def recording():
    return record_arm(TwoLink(drag=(0.0, DRAG)))


@pytest.fixture(scope="module")
def lacking(body, recording):
    return identify(recording, arm_base(body), "filtered_dynamic")["filtered_dynamic"].model


@pytest.fixture(scope="module")
def added(recording, lacking):
    return add(lacking, "quadratic_drag@elbow", recording)


def test_the_hidden_effect_lowers_both_errors_and_its_size_is_found(added):
    for part in ("train", "holdout"):
        before, after = (step.errors[part].joints["elbow"] for step in (added.before, added.after))
        assert after < 0.5 * before
    estimates = added.after.model.estimates
    assert estimates["quadratic_drag@elbow"].value == pytest.approx(DRAG, rel=0.03)
    assert estimates["viscous@elbow"].value == pytest.approx(TwoLink().viscous[1], rel=0.02)
    biased = added.before.model.estimates["viscous@elbow"].value
    assert abs(biased / TwoLink().viscous[1] - 1) > 0.1
    assert added.objection is None
    page = added._repr_html_()
    assert describe_addition(added) in page and "nan" not in page


def test_what_is_missing_at_a_joint_is_warned_of_and_judged_and_nothing_where_nothing_is(body, recording, lacking):
    (finding,) = identify(recording, arm_base(body)).findings
    assert isinstance(finding, Incomplete) and finding.joints == ("elbow",)
    assert 10 <= finding.noise_ratio < 100
    compared = compare(lacking, recording)
    assert {region.at for region in compared.regions} == {"elbow"}
    whole = record_arm(seed=1)
    found = identify(whole, arm_base(body))
    model = found["filtered_dynamic"].model
    assert not found.findings and not compare(model, whole).regions
    rumble = lfilter(*butter(2, (20.0, 60.0), "bandpass", fs=1000.0), np.random.default_rng(0).normal(size=10_000))
    shaken = 0.2 * np.column_stack([rumble / rumble.std(), 0 * rumble])
    left = compare(model, replace(whole, torque=whole.torque + shaken)).regions
    assert {region.at for region in left} == {"shoulder"}


def test_every_command_has_the_same_held_out_noise_floor_and_the_same_errors(body, recording, lacking):
    other = record_arm(TwoLink(drag=(0.0, DRAG)), 1)
    added = add(lacking, "quadratic_drag@elbow", recording, other)
    found = diagnose(recording, other, arm_base(body), only=["quadratic_drag", "stribeck"])
    assert found.selected == ("quadratic_drag@elbow",)
    compared, unseen = (compare(found.model, run).joint for run in (recording, other))
    assert found.floors == added.floors and np.isnan(compared.noise_floor)
    assert unseen.floors == pytest.approx(found.floors, rel=1e-6)
    for own, part in ((compared, "train"), (unseen, "holdout")):
        for step in (found.steps[-1], added.after):
            assert step.errors[part].joints == pytest.approx(own.errors.joints, rel=1e-9)


def test_an_effect_that_is_not_there_is_objected_to_and_what_cannot_be_added_is_refused(recording, added):
    complete = added.after.model
    needless = add(complete, "spring@shoulder", recording)
    assert needless.objection is not None
    assert abs(needless.after.model.estimates["spring.stiffness@shoulder"].value) < 0.02
    chance = add(complete, "torque_offset@shoulder", recording)
    assert [gate.name for gate in chance.objection.gates] == ["p_value"]
    steady = replace(recording, temperature=np.full_like(recording.torque, 25.0))
    for run, id, kind, why in (
        (recording, "spring@wrist", ValueError, "unknown joint 'wrist'"),
        (recording, "temperature_dependent_friction@elbow", IdentificationError, "needs the joint's temperature"),
        (steady, "temperature_dependent_friction@elbow", IdentificationError, "nothing there shows"),
        (recording, "quadratic_drag@elbow", ModelError, "has 'quadratic_drag@elbow' already"),
    ):
        with pytest.raises(kind, match=why):
            add(complete, id, run)
