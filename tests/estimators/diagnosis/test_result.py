"""A diagnosis as data: laid out as promised, the same each time, and told while it is made."""

import json
import pickle

import numpy as np
import pytest

from estimators import diagnose
from pendulum_env.physics import effects
from tests.cases import THETA, diagnosed, recording


def is_number(value: object) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool) and bool(np.isfinite(value))


@pytest.mark.parametrize("name", ["steps", "stribeck", "torque_offset", "stribeck and tilt", "knocks"])
def test_json_is_laid_out_as_promised(name):
    data = diagnosed(name).json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["schema"] == "pendulum-ident/diagnosis@2"
    assert data["base"]["terms"] == ["inertia", "gravity", "viscous", "coulomb"]
    assert data["base"]["theta"].keys() == THETA.keys()
    assert [step["added"] for step in data["steps"]] == [None, *data["selected"]]
    for step in data["steps"]:
        biased = {"biased"} if step == data["steps"][-1] and data["unexplained"]["present"] else set()
        for entry in step["theta"].values():
            assert entry.keys() == {"value", "std", "unit"} | biased
            assert is_number(entry["value"]) and is_number(entry["std"]) and entry["std"] >= 0
            assert isinstance(entry["unit"], str)
        assert step["errors"].keys() == {"train", "holdout"}
        for errors in step["errors"].values():
            assert errors.keys() == {"torque_rms", "position_rms", "torque_fit", "position_fit", "joints"}
            assert all(is_number(value) for name, value in errors.items() if name != "joints")
            assert errors["joints"][""]["torque_rms"] == errors["torque_rms"]
            assert errors["torque_rms"] > 0 and errors["position_rms"] > 0
            assert errors["torque_fit"] <= 100 and errors["position_fit"] <= 100  # [%]
    for candidate in data["candidates"]:
        assert candidate.keys() == {"effect", "score", "verdict", "error_ratio", "reason", "gain", "gates"}
        assert candidate["effect"] in effects()
        assert 0 <= candidate["score"] <= 1
        assert candidate["verdict"] in {"selected", "ambiguous", "rejected", "not_excited"}
        assert is_number(candidate["error_ratio"])
        assert candidate["reason"]["kind"]
        assert all(gate.keys() == {"name", "value", "limit", "std", "unit", "passed"} for gate in candidate["gates"])
        passed = [gate["passed"] for gate in candidate["gates"]]
        assert all(passed) if candidate["verdict"] in ("selected", "ambiguous") else not passed[-1]
    named = [candidate["effect"] for candidate in data["candidates"]]
    assert sorted(named) == sorted(effects())
    assert named[: len(data["selected"])] == sorted(data["selected"], key=named.index)
    assert {c["effect"] for c in data["candidates"] if c["verdict"] == "selected"} == set(data["selected"])
    in_groups = {id for group in data["ambiguous"] for id in group} - set(data["selected"])
    assert {c["effect"] for c in data["candidates"] if c["verdict"] == "ambiguous"} == in_groups
    assert data["unexplained"].keys() == {"present", "where", "joints"}
    assert data["unexplained"]["present"] == (data["unexplained"]["where"] is not None)
    assert bool(data["regions"]) == data["unexplained"]["present"]
    least = min(errors["torque_rms"] for errors in data["steps"][-1]["errors"].values())
    assert 0 < data["noise_floor"]["torque_rms"] < 1.3 * least  # by the scatter, whatever the model leaves


def test_the_same_data_give_the_same_diagnosis():
    assert diagnose([recording("stribeck")]).json() == diagnosed("stribeck").json()


def test_progress_is_told_in_words_and_shares():
    told: list[tuple[str, float]] = []
    diagnose([recording("steps")], progress=lambda what, share: told.append((what, share)))
    assert told[-1] == ("done", 1.0)
    assert all(what and 0 <= share <= 1 for what, share in told)
    assert "screening stribeck" in dict(told)


def test_the_evaluator_of_a_diagnosis_holds_the_model_of_each_candidate_and_is_not_pickled():
    found = diagnose([recording("stribeck")], only=["stribeck", "quadratic_drag"])
    for candidate in (one for one in found.candidates if one.terms):
        fitted = found.evaluator.model(candidate.terms)
        assert candidate.effect in {term.id for term in fitted.terms}
    copy = pickle.loads(pickle.dumps(found))
    assert copy.evaluator is None and copy.json() == found.json()
