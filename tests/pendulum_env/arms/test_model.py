"""Models of an arm, written and read back, refused with the file and the key."""

import json

import pytest

pytest.importorskip("pinocchio")

from pendulum_env.arms.joints import arm_base, choose_coupling, place_effect
from pendulum_env.arms.model import ArmModel
from pendulum_env.physics import ModelError, effect
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


@pytest.mark.parametrize(
    ("k", "changes", "match"),
    [
        (0, {"id": "x"}, r"'terms\[0\]': unknown effect 'x'; known: "),
        (0, {"id": "backlash"}, r"'terms\[0\]': backlash is no effect of one joint's motion"),
        (0, {"joint": "hip"}, r"'terms\[0\]': unknown joint 'hip'"),
        (0, {"joint": "shoulder,elbow"}, r"'terms\[0\]': unknown joint 'shoulder,elbow'"),
        (2, {"joint": "shoulder"}, r"'terms\[2\]' is viscous@shoulder again"),
        (4, {"shape": {"lower": 2.0, "upper": 1.0, "width": 0.1}}, r"'terms\[4\].*"),
        (5, {"shape": {"order": 3.5}}, r"'terms\[5\].shape.order' is 3.5: expected a whole number"),
        (6, {"joint": "elbow"}, r"'terms\[6\]': .*should name two joints"),
    ],
)
def test_a_term_that_makes_no_sense_is_refused_with_its_key(body, content, tmp_path, k, changes, match):
    content["terms"][k] |= changes
    (tmp_path / "model.json").write_text(json.dumps(content))
    with pytest.raises(ModelError, match=rf"model\.json: {match}"):
        ArmModel.load(tmp_path / "model.json", body)
