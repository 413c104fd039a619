"""Laws that no effect is: the table that keeps them is named and earns its place on held-out data."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import Addition, Diagnosis, add, diagnose
from estimators.diagnosis.conclusion import NoKnownEffect
from estimators.search_hints import LEAST_SAMPLES, make_grid
from pendulum_env.physics import Samples
from pendulum_env.physics.table import TABLES, TorqueByAngle
from pendulum_env.recording import Recording
from tests.cases import recorded
from tests.once import once
from workbench.narrator.diagnosis import describe_table

HIDDEN = {
    "friction_by_angle": {"friction_spot": {"spot_f": 0.6, "spot_q": 0.5, "spot_w": 0.3}},
    "friction_by_speed": {"cubic_damping": {"cubic": 0.004}},
    "torque_by_angle": {"cogging": {"cog_n": 3, "cog_s": 0.25, "cog_c": 0.1}},
    "mostly friction": {
        "friction_spot": {"spot_f": 0.6, "spot_q": 0.5, "spot_w": 0.3},
        "cogging": {"cog_n": 3, "cog_s": 0.15, "cog_c": 0.06},
    },
    "mostly torque": {
        "friction_spot": {"spot_f": 0.4, "spot_q": 0.5, "spot_w": 0.3},
        "cogging": {"cog_n": 3, "cog_s": 0.25, "cog_c": 0.1},
    },
    "nothing": {},
    "a gain": {"gain_falls_with_speed": {"fall": 0.03}},
}


def recordings(hidden: str) -> list[Recording]:
    """Two recordings of one plant."""
    experiments = (Experiment(rate=500.0, seconds=15.0, seed=seed) for seed in (1, 2))
    return recorded(Plant(effects=HIDDEN[hidden]), *experiments)


@once("estimators", "pendulum_env", "benchmarks")
def diagnosed(hidden: str) -> Diagnosis:
    """What a diagnosis says of it."""
    fitted, unseen = recordings(hidden)
    only = ("stribeck", "position_dependent_friction", "cogging", "torque_saturation")
    return diagnose(fitted, unseen, only=only[:1] if "mostly" in hidden else only)


@once("estimators", "pendulum_env", "benchmarks")
def kept(hidden: str, table: str) -> Addition:
    """The base model with a table."""
    fitted, unseen = recordings(hidden)
    return add(diagnosed("nothing").model, table, fitted, unseen)


@pytest.mark.parametrize("hidden", ["friction_by_angle", "friction_by_speed", "nothing"])
def test_a_diagnosis_names_the_table_that_keeps_a_law_without_a_name_and_none_where_nothing_is_hidden(hidden):
    found, named = diagnosed(hidden), () if hidden == "nothing" else (hidden,)
    assert found.tables == named and not found.selected
    assert not named or (found.json()["tables"] == [hidden] and found.no_experiment == NoKnownEffect((hidden,)))


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["mostly friction", "mostly torque"])
def test_of_two_laws_that_each_explain_a_part_the_table_that_predicts_held_out_data_best_is_named(hidden):
    found, (fitted, unseen) = diagnosed(hidden), recordings(hidden)
    assert not found.selected
    added = {table: add(found.model, table, fitted, unseen) for table in ("torque_by_angle", "friction_by_angle")}
    errors = {table: one.after.errors["holdout"].torque_rms for table, one in added.items() if one.objection is None}
    assert found.tables == (min(errors, key=errors.__getitem__),)


@pytest.mark.slow
def test_a_motor_gain_that_falls_with_the_speed_is_unexplained_and_given_no_name():
    found = diagnosed("a gain")
    assert found.unexplained and not found.selected and not found.tables


@pytest.mark.parametrize("hidden", TABLES)
def test_a_table_takes_the_held_out_error_to_the_noise(hidden):
    added = kept(hidden, hidden)
    assert added.objection is None
    assert added.noise_ratio < 1.4
    before, after = (step.errors["holdout"] for step in (added.before, added.after))
    assert after.position_rms < 0.25 * before.position_rms


@pytest.mark.parametrize("hidden", TABLES)
def test_where_nothing_is_hidden_a_table_does_not_earn_its_place(hidden):
    added = kept("nothing", hidden)
    assert added.objection is not None
    assert "nearly as large as the table itself" in describe_table(added.after)


@pytest.mark.parametrize(
    ("hidden", "wrong"), [("friction_by_angle", "friction_by_speed"), ("friction_by_speed", "torque_by_angle")]
)
def test_a_table_of_another_quantity_leaves_more(hidden, wrong):
    assert kept(hidden, wrong).noise_ratio > 2 * kept(hidden, hidden).noise_ratio


def test_the_band_of_a_table_holds_the_law():
    curve = kept("friction_by_angle", "friction_by_angle").model.tables["friction_by_angle"][1]
    inside = (curve.x > -0.5) & (curve.x < 1.5)
    wanted = 0.6 * np.exp(-(((curve.x - 0.5) / 0.3) ** 2))
    apart = (curve.value - wanted)[inside]
    apart = apart - apart.mean()  # its mean is told as Coulomb friction
    assert np.abs(apart).max() < 0.05
    assert np.sqrt(np.mean((apart / curve.std[inside]) ** 2)) < 3.0


def test_a_table_leaves_to_an_offset_and_to_gravity_what_is_theirs():
    fitted, unseen = recordings("nothing")
    model = add(diagnosed("nothing").model, "torque_offset", fitted, unseen).after.model
    told = add(model, "torque_by_angle", fitted, unseen).after.model.estimates
    plant = Plant()
    for name, true in (("gravity", plant.gravity), ("torque_offset", 0.0)):
        assert abs(told[name].value - true) < 4 * told[name].std < 0.1


@pytest.mark.parametrize("far", [3.0, 8.0])  # without and with a whole turn
def test_a_table_has_no_piece_without_data(far):
    time = np.linspace(0.0, 30.0, 6000)
    position = 0.6 * np.sin(2.1 * time) + far * np.exp(-(((time - 20.0) / 0.2) ** 2))  # one short excursion
    tables = make_grid(TorqueByAngle, Samples(time, position, np.zeros(6000), np.zeros(6000)), np.empty(0))
    assert {table.extent.is_periodic for table in tables} == {False, far > 5.0}
    for extent in (table.extent for table in tables):
        reached = (position + np.pi) % (2 * np.pi) - np.pi if extent.is_periodic else position
        knots = np.delete(np.linspace(extent.low, extent.high, extent.pieces + 1), extent.merged)
        assert np.histogram(reached, knots)[0].min() >= LEAST_SAMPLES * 6000
        assert (knots[0], knots[-1]) == ((-np.pi, np.pi) if extent.is_periodic else (position.min(), position.max()))


def test_no_table_of_the_motor_competes_where_only_a_load_torque_acts():
    (run,) = recorded(Plant(), Experiment(rate=250.0, seconds=15.0, excitation="multisine"))
    moved_by_hand = Recording(run.time, run.position, np.zeros(len(run)), load_torque=run.torque)
    found = diagnose(moved_by_hand, only=("stribeck",))
    assert "gain_by_time" in {table.id for table in diagnose(run, only=("stribeck",)).evidence.tables}
    assert "gain_by_time" not in {table.id for table in found.evidence.tables}
    assert "torque_by_time" in {table.id for table in found.evidence.tables}
