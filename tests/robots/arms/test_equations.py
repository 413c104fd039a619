"""Windowed equations of an arm: what each joint's rows say, and that laws of one joint's torque stay at that joint."""

import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest

from estimators import identify
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.diagnosis.options import Options
from estimators.regression.balance import Columns
from estimators.schemes.balance import compute_balances
from estimators.selection.search import search
from estimators.signals.measurements import measure_joints
from estimators.weak_form.variant_rows import VariantRows
from pendulum_env.physics import Column, Term, Viscous, effect
from pendulum_env.physics.joints import Links, choose_coupling, list_couplings, place_effect, place_term
from pendulum_env.physics.term import list_loads
from robots.arms import arm_base
from robots.arms.model import ArmModel
from tests.two_link import record_arm

TIME = np.arange(0, 8, 1e-3)


@pytest.fixture(scope="module")
def run():
    return record_arm(seconds=8.0)


@pytest.fixture(scope="module")
def base(body):
    return arm_base(body)


@pytest.fixture(scope="module")
def prepared(run, base):
    return RegressionData.from_arm([run], base)


@pytest.mark.parametrize("counts", [4096, 65_536])
def test_a_whole_model_leaves_what_the_sensors_of_all_joints_give(body, base, counts):
    coarse = RegressionData.from_arm([record_arm(seconds=8.0, noise=1e-3, counts=counts)], base)
    left = coarse.layout.compute_joint_errors(coarse.residual(base))
    assert left == pytest.approx(coarse.floors, rel=0.25)


LAWS = ("load_dependent_friction", "torque_saturation", "actuator_lag", "torque_ripple")


@pytest.mark.parametrize(("joint", "law"), [(k % 2, law) for k, law in enumerate(LAWS)])
@pytest.mark.parametrize("other", [None, "load_dependent_friction", "torque_saturation"])
def test_what_other_joints_share_may_be_condensed_wherever_a_law_acts(body, prepared, base, joint, law, other):
    at, elsewhere = body.joints[joint], body.joints[1 - joint]
    regression = prepared.torque
    terms = base if other is None else (*base, place_effect(effect(other), elsewhere)())
    variant = place_effect(effect(law), at)()
    (own,) = regression.columns([variant])
    whole = regression.regressor.assemble(
        (*terms, variant), [*regression.regressor.list_term_columns(terms), own], regression.fits.weights(terms)
    )
    small = VariantRows(regression.fits, terms).with_variant(prepared.data.locate_rows(at))(variant, own)
    assert isinstance(own, Columns) and len(small.y) <= len(whole.y)
    left, full = (np.linalg.norm(one.weights * one.error(one.solve())) for one in (small, whole))
    # a law that takes torque away counts to first order, and a law of another joint by its tangent
    exactness = 0.2 if law == "torque_saturation" else 1e-5 if other is None else 1e-3
    assert left == pytest.approx(full, rel=exactness)


def test_terms_are_at_a_joint_of_the_arm_and_at_one(body, run):
    for terms in ([Viscous()], [place_term(Viscous(), "wrist")]):
        with pytest.raises(ValueError, match="is at none of the joints shoulder, elbow"):
            identify(run, (Links(body), *terms))
    with pytest.raises(ValueError, match="stribeck@elbow is at a joint already"):
        place_effect(place_effect(effect("stribeck"), "elbow"), "shoulder")


@pytest.mark.parametrize(("at", "is_heavy"), [("shoulder,-elbow", True), ("shoulder,elbow", False)])
def test_a_motor_that_turns_with_two_joints_loads_both(body, tmp_path, at, is_heavy):
    run = record_arm(seconds=8.0, noise=1e-3)
    kind = choose_coupling(at, body)
    assert kind.is_heavy == is_heavy  # parallel axes: the elbow's link turns with their sum as well
    factors = list(list_loads(at).values())
    turned = run.position @ factors
    speed = np.gradient(turned, TIME, edge_order=2)
    needed = 0.2 * speed + 0.3 * np.sign(speed) + 0.01 * is_heavy * np.gradient(speed, TIME, edge_order=2)
    recording = replace(run, torque=run.torque + needed[:, None] * factors)
    model = identify(recording, (*arm_base(body), kind()))["filtered_dynamic"].model
    expected = {"inertia": 0.01, "viscous": 0.2, "coulomb": 0.3}
    found = {
        name.partition("@")[0].removeprefix("coupling."): estimate.value
        for name, estimate in model.estimates.items()
        if name.startswith("coupling")
    }
    assert found == pytest.approx({name: expected[name] for name in found}, rel=0.05)
    model.save(tmp_path / "arm.json")
    assert ArmModel.load(tmp_path / "arm.json", body).terms[1:] == model.terms[1:]
    assert pickle.loads(pickle.dumps(kind())) == kind()
    base = arm_base(body)
    kinds = {one.id: one for one in (*list_couplings(body), place_effect(effect("stribeck"), "elbow"))}
    evidence = Options(base, kinds).make_evidence(FitData((recording,), terms=(*base, *kinds.values())).parts)
    assert [term.id for term in search(evidence).terms[len(base) :]] == [kind.id]


SHARED = (Column("shared", "N m", force=lambda x: np.sin(x.position), potential=lambda x: -np.cos(x.position)),)


@dataclass(frozen=True)
class OfUnknownSize(Term):
    """A law of the difference of two angles, with a parameter."""

    id, law, kind, at = "shared@shoulder,-elbow", "k sin q", "potential", "shoulder,-elbow"
    columns = SHARED


@dataclass(frozen=True)
class OfKnownSize(Term):
    """The same law without a parameter."""

    id, law, kind, at = OfUnknownSize.id, "sin q", "potential", OfUnknownSize.at
    fixed = SHARED


@pytest.mark.parametrize("view", ["torque", "impulse", "energy"])
def test_a_law_without_parameters_loads_both_joints_with_their_factors(body, run, view):
    (joints,) = measure_joints(run.joints)
    unknown, known = (compute_balances(joints, [Links(body), term()], view) for term in (OfUnknownSize, OfKnownSize))
    for of_unknown, of_known in zip(unknown, known, strict=True):
        assert np.abs(of_unknown.phi[:, -1]).max() > 0.1
        np.testing.assert_allclose(of_known.y, of_unknown.y - of_unknown.phi[:, -1], atol=1e-12)
