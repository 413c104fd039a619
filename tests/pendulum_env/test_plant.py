"""Plants, and effects hidden in them."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.backends import record
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.excitation import excitation
from pendulum_env.physics import Model, Samples, effects
from pendulum_env.physics.actuation import ActuatorLag
from pendulum_env.plant import get_typical_values, hide, make_plant, paper_plant, read_parameters
from pendulum_env.registration import PENDULUM


def test_values_in_order_by_name_and_typical_agree():
    usual = get_typical_values(effects()["cogging"]())
    none = {f"order_{k}": 0.0 for k in range(2, 6)}
    assert usual == {"sin": 0.15, "cos": 0.1, "order": 12.0} | none
    plant = paper_plant()
    alone, ordered, named = (
        hide(plant, "cogging"),
        hide(plant, "cogging=0.15,0.1"),
        hide(plant, "cogging:order=12"),
    )
    assert alone == ordered == named
    assert hide(plant, "cogging=0.2,0.3,14") == hide(plant, "cogging:order=14,sin=0.2, cos=0.3")
    several = hide(plant, "cogging:order=7,order_2=28,sin_2=0.03").estimates
    assert [several[f"cogging.{name}"].value for name in ("order", "order_2", "sin_2")] == [7, 28, 0.03]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("stribek", r"did you mean stribeck\?"),
        ("stribeck=a", "'a' in 'stribeck=a' is not a number"),
        ("stribeck=1,2,2,3", r"at most 3 values \(stribeck, stribeck_velocity, exponent\), got 4"),
        ("stribeck=nan", "is not a number"),
        ("cogging:ordre=3", r"unknown parameter of cogging 'ordre': did you mean order\?"),
        ("cogging:order", "'order' in 'order' is not of the form name=value"),
        ("hard_stop:lower=inf", "lower of hard_stop cannot be inf: give a number from -inf"),
        ("hard_stop:lower=0.5,upper=-0.5", "hard_stop cannot be as .* says: lower has to be below upper"),
        ("cogging:order=7,order_2=7", "its orders have to differ"),
        ("cogging:sin_2=0.1", "parameter of cogging 'sin_2'"),
        ("stribeck=-1", r"stribeck of stribeck cannot be -1: give a number from 0 to"),
        ("quadratic_drag=-.1", r"quadratic_drag of quadratic_drag cannot be -0\.1: give a number from 0 to"),
        ("load_dependent_friction=0.9", "cannot be 0.9: give a number from 0 to 0.7"),
        ("stribeck=0.4,-1", "stribeck_velocity of stribeck cannot be -1: give a number from 1e-06 to 10000"),
    ],
)
def test_text_that_makes_no_effect_is_refused(text, match):
    with pytest.raises(ValueError, match=match):
        hide(paper_plant(), text)


@pytest.mark.parametrize("id", [id for id, kind in effects().items() if kind().columns])
def test_a_single_zero_is_an_effect_of_size_zero(id):
    plant = hide(paper_plant(), f"{id}=0")
    assert plant.effects == (id,) and not plant.theta[4:].any()
    assert make_plant(effects={id: 0}) == plant


def test_zeros_of_some_parameters_leave_the_others():
    sizes = [hide(paper_plant(), text).theta[4:].tolist() for text in ("cogging=0,0.3", "cogging:sin=0", "spring=0")]
    assert sizes == [[0.0, 0.3], [0.0, 0.1], [0.0, 0.0]]


# the state of a lag is that of the last half step of the integration
@pytest.mark.parametrize(("id", "accuracy"), [("actuator_lag", 2 * 2 * np.pi / COUNTS), ("dead_time", 0.0)])
def test_a_delay_of_zero_changes_no_motion_and_may_begin_later(id, accuracy, tmp_path):
    (name,) = effects()[id]().nonlinear_values
    plant = hide(paper_plant(), f"{id}=0")
    record_plant = partial(record, excitation=excitation("paper", 1), seconds=1.0, rng=1)
    without, with_zero = record_plant(paper_plant()), record_plant(plant)
    np.testing.assert_allclose(with_zero.position, without.position, rtol=0, atol=1.01 * accuracy)
    plant.save(tmp_path / "model.json")
    assert Model.load(tmp_path / "model.json").estimates[f"{id}.{name}"].value == 0.0
    later = record_plant(plant.with_values({f"{id}.{name}": 0.05}))
    assert np.array_equal(later.position, record_plant(hide(paper_plant(), f"{id}=0.05")).position)
    assert not np.array_equal(later.position, without.position)
    with pytest.raises(ValueError, match=f"{name} of {id} cannot be 1e-05: give a number from 0.0001 to ., or 0"):
        hide(paper_plant(), f"{id}=1e-5")


def test_a_lag_of_zero_is_the_limit_of_a_short_lag():
    time, command = np.arange(4) / 100.0, np.array([1.0, -2.0, 3.0, 0.5])
    x = Samples(time, 0.1 * time, 0.1 + 0.0 * time, command)
    zero, short = ActuatorLag(0.0), ActuatorLag(1e-6)
    np.testing.assert_allclose(zero.trace(x, command, 0.01)[0], short.trace(x, command, 0.01)[0], atol=1e-3)
    np.testing.assert_allclose(zero.advance(zero.start(x), x, 0.01)[0], short.advance(zero.start(x), x, 0.01)[0])


@pytest.mark.parametrize(
    ("mapping", "text"),
    [
        ({"stribeck": 0.77}, "stribeck=0.77"),
        ({"stribeck": 0.1 + 0.2}, f"stribeck={0.1 + 0.2!r}"),
        ({"cogging": {"order": 14, "sin": 0.2}}, "cogging:order=14,sin=0.2"),
        ({"stribeck": {}}, "stribeck"),
    ],
)
def test_a_mapping_sets_sizes_or_parameters_of_effects(mapping, text):
    plant = hide(paper_plant(), text)
    assert make_plant(effects=mapping) == make_plant(effects=text) == make_plant(effects=[text]) == plant
    assert gym.make(PENDULUM, effects=mapping).unwrapped.model == plant
    assert gym.make_vec(PENDULUM, num_envs=2, effects=mapping).model == plant


@pytest.mark.parametrize("given", [0.4, [0.4], {"stribeck": None}, {"stribeck": {"stribeck_velocity": "fast"}}])
def test_effects_of_another_kind_are_refused(given):
    with pytest.raises(TypeError, match="give"):
        make_plant(effects=given)


def test_a_stop_may_be_left_out():
    plant = hide(paper_plant(), "hard_stop:upper=0.9,lower=-inf")
    assert "hard_stop.lower" not in plant.estimates
    assert plant == hide(paper_plant(), "hard_stop=40,-inf,0.9")
    assert Model.from_json(plant.json()) == plant


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("inertai=0.1", r"unknown parameter 'inertai': did you mean inertia\?"),
        ("inertia=0", "inertia of a plant cannot be 0"),
        ("gravity", "not of the form name=value"),
    ],
)
def test_parameters_of_the_plant_are_set_by_name_and_what_makes_no_plant_is_refused(text, match):
    assert paper_plant(read_parameters("inertia=0.1, coulomb=0")).theta == pytest.approx([0.1, 2.01, 0.3638, 0.0])
    with pytest.raises(ValueError, match=match):
        paper_plant(read_parameters(text))
