"""A diagnosis as data: laid out as promised, the same each time, and told while it is made."""

import json
import pickle

import pytest

from estimators import diagnose
from estimators.progress import Screened
from pendulum_env.physics import effects
from tests.cases import THETA, diagnosed, recording


@pytest.mark.parametrize("name", ["steps", "stribeck", "torque_offset", "stribeck and tilt", "knocks"])
def test_json_is_laid_out_as_promised(name):
    data = diagnosed(name).json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["base"]["terms"] == ["inertia", "gravity", "viscous", "coulomb"]
    assert data["base"]["theta"].keys() == THETA.keys()
    assert [step["added"] for step in data["steps"]] == [None, *data["selected"]]
    for step in data["steps"]:
        is_biased = step == data["steps"][-1] and data["unexplained"]["present"]
        assert all(entry["std"] >= 0 and entry.get("biased", False) == is_biased for entry in step["theta"].values())
        assert step["errors"].keys() == {"train", "holdout"}
        for errors in step["errors"].values():
            assert errors["joints"][""]["torque_rms"] == errors["torque_rms"]
            assert errors["torque_rms"] > 0 and errors["position_rms"] > 0
            assert errors["torque_fit"] <= 100 and errors["position_fit"] <= 100  # [%]
    for candidate in data["candidates"]:
        assert 0 <= candidate["score"] <= 1
        assert candidate["verdict"] in {"selected", "ambiguous", "rejected", "not_excited"}
        passed = [gate["passed"] for gate in candidate["gates"]]
        assert all(passed) if candidate["verdict"] in ("selected", "ambiguous") else not passed[-1]
    named = [candidate["effect"] for candidate in data["candidates"]]
    assert sorted(named) == sorted(effects())
    assert named[: len(data["selected"])] == sorted(data["selected"], key=named.index)
    assert {c["effect"] for c in data["candidates"] if c["verdict"] == "selected"} == set(data["selected"])
    in_groups = {id for group in data["ambiguous"] for id in group} - set(data["selected"])
    assert {c["effect"] for c in data["candidates"] if c["verdict"] == "ambiguous"} == in_groups
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
    shares = [share for _, share in told]
    assert all(what for what, _ in told) and 0 <= shares[0] and shares == sorted(shares)  # nor does it run back
    assert any("Stribeck friction" in what for what, _ in told)


def test_progress_tells_the_error_with_each_effect_that_was_screened():
    told: list[str] = []
    diagnose([recording("stribeck")], progress=lambda what, _: told.append(what))
    error = {what.effect: what.error for what in reversed(told) if isinstance(what, Screened)}  # the first round
    assert min(error, key=error.__getitem__) == "stribeck" and error["stribeck"] < 0.5 * error["quadratic_drag"]


def test_the_evidence_of_a_diagnosis_holds_the_model_of_each_candidate_and_is_not_pickled():
    found = diagnose([recording("stribeck")], only=["stribeck", "quadratic_drag"])
    for candidate in (one for one in found.candidates if one.terms):
        fitted = found.evidence.fits.fit_model(candidate.terms)
        assert candidate.effect in {term.id for term in fitted.terms}
    copy = pickle.loads(pickle.dumps(found))
    assert copy.evidence is None and copy.json() == found.json()
