"""Models: built, extended, written and read back, refused with a reason."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pendulum_env.physics import BASE, Estimate, Model, ModelError, Samples, effect, effects
from pendulum_env.plant import hide, make_plant, paper_plant

EVERYTHING = sorted(effects())


def everything() -> Model:
    """The paper's pendulum with every effect of the library."""
    model = paper_plant()
    for id in EVERYTHING:
        model = hide(model, id)
    return model


def test_a_model_with_all_effects_keeps_values_errors_units_and_order(tmp_path):
    model = everything()
    theta = np.random.default_rng(0).standard_normal(len(model.theta)) / 3
    model = Model.build(model.terms, theta, 0.01 * np.abs(theta), **{"stribeck.stribeck_velocity": 0.02})
    model.save(tmp_path / "model.json")
    found = Model.load(tmp_path / "model.json")
    assert found == model
    assert found.effects == tuple(EVERYTHING)
    np.testing.assert_array_equal(found.theta, theta)
    assert found.estimates["stribeck.stribeck_velocity"] == Estimate(0.5, 0.02, "rad/s")


def test_torque_is_the_sum_over_columns_and_laws_without_a_parameter():
    model = hide(hide(paper_plant(), "quadratic_drag=0.03"), "torque_saturation=6")
    rng = np.random.default_rng(0)
    t, q, v, u, a = rng.standard_normal((5, 40))
    inertia, gravity, viscous, coulomb, _ = model.theta
    expected = inertia * a + gravity * np.sin(q) + viscous * v + coulomb * np.sign(v)
    expected += 0.03 * v * np.abs(v) + u - 6 * np.tanh(u / 6)
    np.testing.assert_allclose(model.torque(Samples(t, q, v, u), a), expected, rtol=1e-12)


def test_adding_a_term_leaves_the_model_as_it_was_and_works_once():
    model = Model.build(BASE, np.array([0.1, 2.0, 0.3, 0.8]), 0.01)
    larger = model.add(effect("spring")(), [0.2, 0.1])
    assert model.effects == () and larger.effects == ("spring",)
    assert {name: larger.estimates[name] for name in model.estimates} == dict(model.estimates)
    assert larger.estimates["spring.preload"].value == 0.1
    for term in (effect("spring")(), BASE[0]):
        with pytest.raises(ModelError, match=f"the model has '{term.id}' already: each effect can be added once"):
            larger.add(term)


def edited(**changes: object) -> dict:
    """JSON of a model, some of it replaced."""
    return {**hide(paper_plant(), "stribeck").json(), **changes}


def with_theta(**entries: object) -> dict:
    """The same with entries of theta replaced, or removed where None."""
    data = edited()
    theta = {**data["theta"], **entries}
    return {**data, "theta": {name: entry for name, entry in theta.items() if entry is not None}}


def shaped(id: str, shape: str, value: float) -> dict:
    """JSON of a model with an effect, a nonlinear parameter of which is another."""
    data = hide(paper_plant(), id).json()
    data["theta"].setdefault(f"{id}.{shape}", {})["value"] = value
    return data


def covered(**changes: object) -> dict:
    """JSON of a model with a covariance, some of it replaced."""
    model = paper_plant()
    data = model.with_covariance(list(model.estimates), np.eye(4)).json()
    return data | {"covariance": data["covariance"] | changes}


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (edited(schema="something else"), "this is not a model: 'schema' should be pendulum-ident/model@1"),
        (edited(schema="pendulum-ident/arm-model@1"), "of an arm, not of a pendulum: give the arm"),
        ({"schema": "pendulum-ident/model@1"}, "Object missing required field terms"),
        (edited(terms=["inertia", "stribek"]), r"unknown effect 'stribek': did you mean stribeck\? Known: "),
        (edited(terms=["inertia", "inertia"]), "names a term twice"),
        (with_theta(**{"stribeck.stribeck_velocity": None}), "'theta' lacks 'stribeck.stribeck_velocity'"),
        (with_theta(gravity={"value": np.nan}), "'theta.gravity.value': Expected float >= -1"),
        (with_theta(gravity={"value": 2.0, "std": float("nan")}), "'theta.gravity.std': Expected float >= 0"),
        (with_theta(inertia={"value": 0.0}), "'theta.inertia.value' is 0: .* a number above zero"),
        (edited(limits={"gravity": [np.nan, 1.0]}), "'limits.*': Expected float"),
        (shaped("stribeck", "stribeck_velocity", -0.5), "stribeck_velocity.*-0.5"),
        (shaped("cogging", "order", 3.5), "order.*3.5"),
        (shaped("hard_stop", "lower", 2), "makes no sense: lower has to be below upper"),
        (shaped("backlash", "friction", 1e4), r"'theta.backlash.friction.value' is 10000: expected at most"),
        (covered(parameters=["mass", "gravity", "viscous", "coulomb"]), "no covariance of all parameters"),
        (covered(matrix=np.eye(4)[:3].tolist()), "no covariance of all parameters"),
        (covered(matrix=(-np.eye(4)).tolist()), "no covariance of all parameters"),
        (b"\xff\xfe\x00", "is not JSON; a model is what"),
        ("nowhere", "cannot be read"),
    ],
)
def test_what_makes_no_model_is_refused_with_the_file_and_the_reason(content, match, tmp_path):
    path = tmp_path / "broken.json"
    if content != "nowhere":
        path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    with pytest.raises(ModelError, match=rf"broken\.json: .*{match}"):
        Model.load(path)


@pytest.mark.parametrize("terms", [(), BASE[1:]])
def test_a_model_without_inertia_is_read_and_not_simulated(terms, tmp_path):
    model = Model.build(terms, 0.5)
    model.save(tmp_path / "model.json")
    assert Model.load(tmp_path / "model.json") == model
    with pytest.raises(ModelError, match="lacks the term inertia"):
        model.simulate(0.01, np.ones(10), 0.0, 0.0)
    for given in (model, tmp_path / "model.json"):
        with pytest.raises(ModelError, match="lacks the term inertia"):
            make_plant(model=given)


def test_a_model_is_a_mapping_of_its_estimates_by_full_and_short_name():
    model = Model.build([*BASE, effect("dead_time")()], 0.5)
    assert dict(model) == model.estimates and list(model) == list(model.estimates) and len(model) == 5
    assert "dead_time" in model and model["dead_time"] is model["dead_time.dead_time"]
    assert "stribeck" not in model and float(model["gravity"]) == 0.5
    with pytest.raises(KeyError, match="did you mean gravity"):
        model["gravty"]


def test_a_transmission_is_also_told_as_a_spring_and_a_damper():
    term = effect("joint_flexibility")(resonance=50.0, damping=2.0, gravity=25.0)
    names = {"joint_flexibility.resonance": 0.5, "joint_flexibility.damping": 0.1, "joint_flexibility.gravity": 0.2}
    model = Model.build([*BASE, term], [0.1, 2.0, 0.4, 0.9, 0.02], [0.0] * 4 + [4e-4], **names)
    k, d = model.derived["joint_flexibility.k"], model.derived["joint_flexibility.d"]
    assert (k.value, k.unit, d.unit) == (pytest.approx(50.0), "N m/rad", "N m s/rad")
    assert k.std == pytest.approx(50.0 * np.hypot(0.02, 2 * 0.01), rel=1e-4)  # of J w^2, errors independent
    assert d.std == pytest.approx(0.04 * np.hypot(0.02, 0.05), rel=1e-4)


def test_a_derived_quantity_of_a_parameter_at_its_bound_is_at_its_bound():
    term = effect("joint_flexibility")(resonance=50.0, damping=2.0, gravity=0.1)
    model = Model.build([*BASE, term], [0.1, 2.0, 0.4, 0.9, 0.02], [0.0] * 4 + [4e-4])
    at_bound = replace(model.estimates["joint_flexibility.gravity"], std=0.0, at_bound=True)
    model = replace(model, estimates={**model.estimates, "joint_flexibility.gravity": at_bound})
    weight, stiffness = model.derived["joint_flexibility.mgl"], model.derived["joint_flexibility.k"]
    assert weight.at_bound and weight.std == 0 and not stiffness.at_bound and stiffness.std > 0


@pytest.mark.parametrize("of_gravity", [1e-2, 1e5])
def test_a_saved_model_keeps_the_covariance(of_gravity, tmp_path):
    covariance = np.diag([1e-4, of_gravity, 1e-3, 1e-2]) ** 2
    covariance[2, 3] = covariance[3, 2] = -0.8 * 1e-3 * 1e-2
    model = Model.build(BASE, [0.1, 2.0, 0.4, 0.9], np.sqrt(np.diag(covariance)))
    model = model.with_covariance(["inertia", "gravity", "viscous", "coulomb"], covariance)
    model.save(tmp_path / "model.json")
    np.testing.assert_allclose(Model.load(tmp_path / "model.json").covariance, covariance, rtol=1e-12)
    assert model.with_values({"gravity": 1.9}).covariance is None  # nobody has told that of another model


def test_an_infinite_standard_error_stays_if_errors_are_added():
    model = Model.build(BASE, [0.1, 2.0, 0.4, 0.9], [0.01, np.inf, 0.01, 0.0])
    for _ in range(2):  # without and with known correlations
        model = model.add_errors({"inertia": 0.02, "gravity": 0.5, "viscous": -0.02})
    assert [e.std for e in model.estimates.values()] == pytest.approx([0.03, np.inf, 0.03, 0.0])
    assert model.correlation[0] == pytest.approx((1.0, 0.0, -8 / 9, 0.0))


def test_an_infinite_standard_error_is_null_in_a_file_and_is_read_again(tmp_path):
    model = Model.build(BASE, [0.1, 2.0, 0.4, 0.9], [0.01, np.inf, 0.01, 0.0]).add_errors(
        {"inertia": 0.02, "viscous": 0.02}
    )
    model.save(tmp_path / "model.json")
    content = json.loads((tmp_path / "model.json").read_text(), parse_constant=pytest.fail)  # strict JSON
    assert content["theta"]["gravity"]["std"] is None
    found = Model.load(tmp_path / "model.json")
    assert found == model
    np.testing.assert_allclose(found.covariance, model.covariance, rtol=1e-12)


def test_a_model_at_other_values_has_them_in_estimates_and_terms():
    model = Model.build(BASE, [0.1, 2.0, 0.4, 0.9]).add(effect("stribeck")(0.5), 0.3)
    other = model.with_values({"stribeck.stribeck_velocity": 0.8, "gravity": 1.0})
    assert other.terms[-1].stribeck_velocity == other.estimates["stribeck.stribeck_velocity"].value == 0.8
    assert other.theta.tolist() == [0.1, 1.0, 0.4, 0.9, 0.3]
    for wrong in ({"gravty": 1.0}, {"inertia": 0.0}, {"gravity": np.nan}):
        with pytest.raises(ValueError, match=r"did you mean gravity|cannot be"):
            model.with_values(wrong)


def test_parameters_that_follow_others_are_not_shown_twice():
    model = Model.build([*BASE, effect("encoder_eccentricity")()], [0.1, 2.0, 0.1, 0.1, 0.01, 0.02])
    names = {"inertia", "gravity", "viscous", "coulomb", "encoder_eccentricity.sin", "encoder_eccentricity.cos"}
    assert set(model.readable) == names < set(model.estimates)
