"""Models: built, extended, written and read back, refused with a reason."""

import json
import os

import numpy as np
import pytest

from pendulum_env.physics import BASE, Estimate, Model, ModelError, Samples, effect, effects
from pendulum_env.physics.base import Inertia, Viscous
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.limits import limited_term
from pendulum_env.plant import hide, paper_plant

EVERYTHING = sorted(effects())


def everything() -> Model:
    """The paper's pendulum with every effect of the library."""
    model = paper_plant()
    for id in EVERYTHING:
        model = hide(model, id)
    return model


@pytest.mark.parametrize("id", EVERYTHING)
def test_a_model_with_an_effect_is_read_back_as_it_was_written(id, tmp_path):
    model = hide(paper_plant(), id)
    model.save(tmp_path / "model.json")
    assert Model.load(tmp_path / "model.json") == model


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


def test_a_parameter_at_its_bound_is_said_to_be_there_and_has_no_error():
    term = limited_term(Stribeck(stribeck_velocity=0.5), {"stribeck.stribeck_velocity": (0.5, 2.0)})
    known = limited_term(Viscous(), {"viscous": (0.3, 0.3)})
    model = Model.build((Inertia(), known, term), (0.1, 0.3, 0.0), 1e-9, **{"stribeck.stribeck_velocity": 0.02})
    assert {name: estimate.text for name, estimate in model.estimates.items()} == {
        "inertia": "0.1000000000 ± 0.0000000010",
        "viscous": "0.3000000000 ± 0.0000000010",
        "stribeck": "0 (at its bound)",
        "stribeck.stribeck_velocity": "0.5 (at its bound)",
    }


def test_json_holds_schema_terms_and_theta():
    data = hide(paper_plant(), "stribeck").json()
    assert data["schema"] == "pendulum-ident/model@1"
    assert data["terms"] == ["inertia", "gravity", "viscous", "coulomb", "stribeck"]
    assert data["theta"]["stribeck"] == {"value": 0.45, "std": 0.0, "unit": "N m"}
    assert data["theta"]["stribeck.stribeck_velocity"]["unit"] == "rad/s"
    assert json.loads(json.dumps(data, allow_nan=False)) == data


def test_parameters_are_in_the_order_of_the_columns():
    model = hide(hide(paper_plant(), "cogging=0.3,0.2"), "stribeck=0.1")
    names = [column.name for column in model.columns]
    assert names == ["inertia", "gravity", "viscous", "coulomb", "cogging.sin", "cogging.cos", "stribeck"]
    np.testing.assert_array_equal(model.theta[4:], [0.3, 0.2, 0.1])


def test_torque_is_the_sum_over_columns_and_laws_without_a_parameter():
    model = hide(hide(paper_plant(), "quadratic_drag=0.03"), "torque_saturation=6")
    rng = np.random.default_rng(0)
    t, q, v, u, a = rng.standard_normal((5, 40))
    inertia, gravity, viscous, coulomb, _ = model.theta
    expected = inertia * a + gravity * np.sin(q) + viscous * v + coulomb * np.sign(v)
    expected += 0.03 * v * np.abs(v) + u - 6 * np.tanh(u / 6)
    np.testing.assert_allclose(model.torque(Samples(t, q, v, u), a), expected, rtol=1e-12)


def test_adding_a_term_leaves_the_model_and_its_estimates_as_they_were():
    model = Model.build(BASE, np.array([0.1, 2.0, 0.3, 0.8]), 0.01)
    larger = model.add(effect("spring")(), [0.2, 0.1])
    assert model.effects == ()
    assert larger.effects == ("spring",)
    assert {name: larger.estimates[name] for name in model.estimates} == dict(model.estimates)
    assert larger.estimates["spring.preload"].value == 0.1


def test_a_term_cannot_be_added_twice():
    with pytest.raises(ModelError, match="the model has 'stribeck' already: each effect can be added once"):
        paper_plant().add(effect("stribeck")()).add(effect("stribeck")(stribeck_velocity=0.1))
    with pytest.raises(ModelError, match="the model has 'inertia' already"):
        paper_plant().add(BASE[0])


def edited(**changes: object) -> dict:
    """JSON of a model, some of it replaced."""
    return {**hide(paper_plant(), "stribeck").json(), **changes}


def with_theta(**entries: object) -> dict:
    """The same with entries of theta replaced, or removed where None."""
    data = edited()
    theta = {**data["theta"], **entries}
    return {**data, "theta": {name: entry for name, entry in theta.items() if entry is not None}}


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (edited(schema="something else"), "this is not a model: 'schema' should be pendulum-ident/model@1"),
        (
            edited(schema="pendulum-ident/arm-model@1"),
            "this is a model of an arm, of which a pendulum has no use: commands take it with --robot",
        ),
        ([], "this is not a model"),
        (None, "this is not a model"),
        ({"schema": "pendulum-ident/model@1"}, "the model lacks 'terms'"),
        (edited(terms=["inertia", "stribek"]), r"unknown effect 'stribek': did you mean stribeck\? Known: "),
        (edited(terms=["inertia", "inertia"]), "names a term twice"),
        (edited(terms=3), "'terms' of the model is 3: it has to be a list"),
        (edited(terms=[["inertia"]]), r"'terms\[0\]' of the model is \['inertia'\]: it has to be a text"),
        (edited(theta=[1, 2]), r"'theta' of the model is \[1, 2\]: it has to be a table"),
        (with_theta(stribeck=None), "the model lacks 'stribeck'"),
        (with_theta(**{"stribeck.stribeck_velocity": None}), "the model lacks 'stribeck.stribeck_velocity'"),
        (with_theta(gravity={"std": 0.1}), "the model lacks 'value'"),
        (with_theta(gravity=2.0), "'theta.gravity' of the model is 2.0: it has to be a table"),
        (
            with_theta(gravity={"value": float("nan")}),
            "'theta.gravity.value' of the model is nan: it has to be a finite",
        ),
        (with_theta(gravity={"value": "inf"}), "a finite number"),
        (with_theta(**{"stribeck.stribeck_velocity": {"value": float("nan")}}), "a finite number"),
        (with_theta(gravity={"value": 2.0, "std": float("nan")}), "'theta.gravity.std' of the model is nan"),
        (with_theta(gravity={"value": 1e308}), "'theta.gravity.value' of the model is 1e[+]308"),
        (
            with_theta(inertia={"value": 0.0}),
            "'theta.inertia.value' of the model is 0.0: it has to be a number above zero",
        ),
        (with_theta(inertia={"value": -0.1}), "it has to be a number above zero"),
        (with_theta(gravity={"value": 10**400}), "is 10{27}"),
        (edited(torque_unit=3), "'torque_unit' of the model is 3"),
        (with_theta(gravity={"value": "two"}), "two"),
        (with_theta(gravity={"value": None}), "the model lacks 'value' under 'theta.gravity'"),
    ],
)
def test_what_makes_no_model_is_refused_with_the_reason(data, match, tmp_path):
    with pytest.raises(ModelError, match=match):
        Model.from_json(data)
    (tmp_path / "broken.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match=r"broken\.json: "):
        Model.load(tmp_path / "broken.json")


@pytest.mark.parametrize(
    ("id", "shape", "value"),
    [("stribeck", "stribeck_velocity", -0.5), ("cogging", "order", 3.5), ("cogging", "order", 0)],
)
def test_a_shape_parameter_out_of_its_limits_is_refused_with_the_limits(id, shape, value):
    data = hide(paper_plant(), id).json()
    data["theta"][f"{id}.{shape}"]["value"] = value
    with pytest.raises(ModelError, match=rf"{shape}.*{value:g}"):
        Model.from_json(data)


def test_stops_that_leave_no_room_between_them_are_refused():
    data = Model.build(BASE, 1.0).add(effect("hard_stop")(0.5, -0.5), 40.0).json()
    with pytest.raises(ModelError, match="'hard_stop' makes no sense: lower has to be below upper"):
        Model.from_json(data)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00", b"time,position,torque\n0,0,0\n"])
def test_a_file_that_is_not_json_is_refused_by_name(content, tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=r"run\.csv: is not JSON; a model file is what `identify -o`"):
        Model.load(path)


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(ModelError, match=r"nowhere\.json: cannot be read \(No such file or directory\)"):
        Model.load(tmp_path / "nowhere.json")


def test_a_save_that_fails_leaves_the_old_model_and_nothing_else(tmp_path, monkeypatch):
    path, model = tmp_path / "model.json", paper_plant()
    model.save(path)
    before = path.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    for step in ("os.fsync", "pathlib.Path.replace"):
        with monkeypatch.context() as patch:
            patch.setattr(step, full)
            with pytest.raises(OSError, match="No space left"):
                hide(model, "stribeck").save(path)
        assert path.read_bytes() == before
        assert os.listdir(tmp_path) == ["model.json"]


def test_a_save_replaces_the_file_whole(tmp_path):
    path = tmp_path / "model.json"
    everything().save(path)
    paper_plant().save(path)
    assert Model.load(path) == paper_plant()
    assert path.read_text().endswith("}\n")
