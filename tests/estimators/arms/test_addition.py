"""An effect added at a joint, in data from SciPy's integration of the textbook's arm with air drag at the elbow."""

import pytest

from benchmarks.two_link import TwoLink
from estimators import add, identify
from pendulum_env.arms.joints import arm_base
from pendulum_env.physics import ModelError
from tests.two_link import recorded

DRAG = 0.06  # [N m s^2/rad^2]


@pytest.fixture(scope="module")
def recording():
    return recorded(TwoLink(drag=(0.0, DRAG)))


@pytest.fixture(scope="module")
def lacking(body, recording):
    return identify(recording, arm_base(body), "filtered_dynamic")["filtered_dynamic"].model


def test_the_hidden_effect_lowers_both_errors_and_its_size_is_found(recording, lacking):
    added = add(lacking, "quadratic_drag@elbow", recording)
    for part in ("train", "holdout"):
        before, after = (step.errors[part].joints["elbow"] for step in (added.before, added.after))
        assert after < 0.5 * before
    estimates = added.after.model.estimates
    assert estimates["quadratic_drag@elbow"].value == pytest.approx(DRAG, rel=0.03)
    assert estimates["viscous@elbow"].value == pytest.approx(TwoLink().viscous[1], rel=0.02)
    biased = added.before.model.estimates["viscous@elbow"].value
    assert abs(biased / TwoLink().viscous[1] - 1) > 0.1
    assert added.objection is None and "lowers the held-out torque error of elbow to" in added.text
    page = added._repr_html_()
    assert added.text in page and "Torque errors on held-out data" in page and "nan" not in page


def test_an_effect_that_is_not_there_is_objected_to(recording, lacking):
    complete = add(lacking, "quadratic_drag@elbow", recording).after.model
    added = add(complete, "spring@shoulder", recording)
    assert added.objection is not None and "no reason to keep it" in added.text
    assert abs(added.after.model.estimates["spring.stiffness@shoulder"].value) < 0.02


def test_what_cannot_be_added_is_refused(recording, lacking):
    with pytest.raises(ValueError, match="unknown joint 'wrist'"):
        add(lacking, "spring@wrist", recording)
    added = add(lacking, "quadratic_drag@elbow", recording)
    with pytest.raises(ModelError, match="has 'quadratic_drag@elbow' already"):
        add(added.after.model, "quadratic_drag@elbow", recording)
