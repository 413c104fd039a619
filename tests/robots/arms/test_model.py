"""Models of an arm, written and read back, refused with the file and the key."""

import json

import pytest

pytest.importorskip("pinocchio")

from pendulum_env.physics import ModelError, effect
from pendulum_env.physics.joints import choose_coupling, place_effect
from pendulum_env.physics.limits import collect_limits, limit_term
from robots.arms import arm_base
from robots.arms.model import ArmModel
from tests import two_link


@pytest.fixture(scope="module")
def body():
    return two_link.body()


@pytest.fixture
def content(body) -> dict:
    """Content of a model file with effects at joints and a coupling."""
    effects = [place_effect(effect("hard_stop"), "elbow")(), place_effect(effect("cogging"), "elbow")()]
    return ArmModel.build([*arm_base(body), *effects, choose_coupling("shoulder,-elbow", body)()], 0.5, 0.01).json()


def test_a_model_reads_back(body, content, tmp_path):
    (tmp_path / "model.json").write_text(json.dumps(content))
    assert ArmModel.load(tmp_path / "model.json", body).json() == content


def test_bounds_and_correlations_are_kept(body):
    (viscous, *others), limits = arm_base(body)[1:], {"viscous@shoulder": (0.0, 0.2)}
    model = ArmModel.build([*arm_base(body)[:1], limit_term(viscous, limits), *others], 0.1, 0.01)
    model = model.add_errors({"viscous@shoulder": 0.02, "coulomb@shoulder": -0.02})
    again = ArmModel.from_json_of_body(json.loads(json.dumps(model.json())), body)
    assert collect_limits(again.terms[1:]) == limits
    assert again.assumed_covariance == pytest.approx(model.assumed_covariance)
    assert again.correlation[6][7] == pytest.approx(-0.8)  # 0.02^2 / (0.01^2 + 0.02^2)


@pytest.mark.parametrize(
    ("k", "changes", "match"),
    [
        (0, {"id": "x"}, "unknown effect 'x'; known: "),
        (0, {"id": "backlash"}, "backlash is no effect of one joint's motion"),
        (0, {"joint": "hip"}, "unknown joint 'hip'"),
        (0, {"joint": "shoulder,elbow"}, "unknown joint 'shoulder,elbow'"),
        (2, {"joint": "shoulder"}, "the model names a term twice"),
        (4, {"shape": {"lower": 2.0, "upper": 1.0, "width": 0.1}}, "'hard_stop@elbow' makes no sense"),
        (5, {"shape": {"order": 3.5}}, r"'theta.cogging.order@elbow.value' is 3.5: expected a whole number"),
        (6, {"joint": "elbow"}, ".*should name two joints"),
    ],
)
def test_a_term_that_makes_no_sense_is_refused(body, content, tmp_path, k, changes, match):
    id, _, joint = content["terms"][k].partition("@")
    content["terms"][k] = f"{changes.get('id', id)}@{changes.get('joint', joint)}"
    for name, value in changes.get("shape", {}).items():
        content["theta"][f"{id}.{name}@{joint}"] = {"value": value}
    (tmp_path / "model.json").write_text(json.dumps(content))
    with pytest.raises(ModelError, match=rf"model\.json: {match}"):
        ArmModel.load(tmp_path / "model.json", body)
