"""Hints for the search: where it begins, for effects of the library and for a law alone."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.search_hints import SearchHints, count_variants, is_possible, make_grid, set_hints
from pendulum_env.physics import Column, NonlinearParameter, Samples, Term, effect, effects
from pendulum_env.physics.joints import place_effect
from pendulum_env.physics.limits import limit_kind
from tests.motions import recorded

MOTIONS = {
    "short and small": {"seconds": 3.0, "scale": 0.1},
    "usual": {"seconds": 8.0},
    "many turns": {"seconds": 30.0, "drift": -6.0},
    "long": {"seconds": 200.0, "scale": 1.5},
    "fast": {"seconds": 6.0, "drift": 60.0},
}


@pytest.mark.parametrize("id", effects())
@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_grid_offers_valid_variants_on_random_motion(id, motion):
    kind = effects()[id]
    rng = np.random.default_rng(0)
    x = recorded(1, rate=50.0, **motion)
    wandering = 0.02 * np.cumsum(rng.standard_normal(len(x.time)))
    residual = wandering - wandering.mean() + np.sin(0.04 * x.time)
    variants = make_grid(kind, x, residual)
    assert len(set(variants)) == len(variants)
    for variant in variants:
        assert type(variant) is kind
        assert is_possible(variant, x)
        assert not variant.fault
        for known in kind.nonlinear_parameters:
            value = variant.nonlinear_values[known.name]
            assert isinstance(value, float)
            assert known.low <= value <= known.high, f"{known.name} = {value:g}"
            assert not known.integer or value == round(value)
    assert variants or kind.nonlinear_parameters  # only a search over nonlinear parameters may have nowhere to start


def test_what_the_best_tone_takes_out_of_noise_is_what_a_choice_among_so_many_gives():
    tones, count, seeds = effect("periodic_disturbance"), 1000, 40
    zero = np.zeros(count)
    x = Samples(0.01 * np.arange(count), zero, zero, zero)
    beyond = []
    for seed in range(seeds):
        noise = np.random.default_rng(seed).standard_normal(count)
        best = max(abs(np.mean(noise * np.exp(1j * tone.frequency * x.time))) for tone in make_grid(tones, x, noise))
        # a tone takes N |mean(noise exp(jwt))|^2 nats: exponentially distributed, close to it for the best of M
        beyond.append(count * best**2 / np.var(noise) - np.log(count_variants(tones, x, noise)))
    assert abs(np.mean(beyond)) < 0.5, np.mean(beyond)


def test_what_acts_most_of_the_time_is_no_stop():
    x = recorded(2)
    low, middle, high = np.quantile(x.position, [0.1, 0.5, 0.9])
    stop = effect("hard_stop")
    assert is_possible(stop(low, high), x) and is_possible(stop(upper=high), x)
    assert not is_possible(stop(lower=high), x) and not is_possible(stop(upper=middle - 1e-3), x)


@given(order=st.integers(61, 400), phase=st.floats(0.0, 6.28), reach=st.floats(0.8, 20.0), seed=st.integers(0, 99))
def test_cogging_of_a_fine_order_is_among_what_is_tried(order, phase, reach, seed):
    """Gears of strain waves ripple twice in a turn of their motor, some 200 times in one of the joint."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-reach, reach, 4000)
    residual = np.sin(order * q + phase) + rng.standard_normal(len(q))
    x = Samples(np.arange(len(q)) * 0.01, q, np.ones_like(q), np.zeros_like(q))
    near = 2.0 * np.pi / (2.0 * reach)  # orders that so short a way tells apart
    assert min(abs(term.order - order) for term in make_grid(effect("cogging"), x, residual)) <= near


@dataclass(frozen=True)
class Bump(Term):
    """A law alone: a torque around an angle, of a width, that begins at an instant."""

    angle: float = 0.0
    width: float = 0.1
    order: float = 3.0
    begin: float = 0.0
    power: float = 2.0

    id, law, kind = "bump", "b(q)", "potential"
    nonlinear_parameters = (
        NonlinearParameter("angle", "rad", -3.0, 3.0),
        NonlinearParameter("width", "rad", 0.01, 1.0),
        NonlinearParameter("order", "1", 1, 9, integer=True),
        NonlinearParameter("begin", "s", 0.0, 1e6, instant=True),
        NonlinearParameter("power", "1", 0.0, 9.0, nominal=2.0),
    )
    columns = (Column("bump", "N m", force=lambda x: x.position),)


@dataclass(frozen=True)
class Wave(Term):
    """A law alone: waves over the angle."""

    order: float = 12.0

    id, law, kind = "wave", "sin Nq", "potential"
    nonlinear_parameters = (NonlinearParameter("order", "1", 1, 60, integer=True),)


def test_without_hints_a_search_begins_all_over_the_bounds():
    x = recorded(1, seconds=10.0)
    variants = make_grid(Bump, x, x.torque)
    assert variants[0] == Bump() and count_variants(Bump, x, x.torque) == len(variants) == len(set(variants))
    values = {name: {variant.nonlinear_values[name] for variant in variants} for name in Bump().nonlinear_values}
    for known in Bump.nonlinear_parameters[:3]:
        assert {known.low, known.high} <= values[known.name]
    assert max(values["begin"]) == x.time[-1] and values["power"] == {2.0}
    assert [wave.order for wave in make_grid(Wave, x, x.torque)[1:]] == [n for n in range(1, 61) if n != 12]
    assert make_grid(effect("torque_offset"), x, x.torque) == [effect("torque_offset")()]


def test_hints_of_a_user_serve_the_effect_at_a_joint_and_within_limits():
    @dataclass(frozen=True)
    class Own(Wave):
        """The same with hints."""

    x = recorded(1)
    set_hints(
        Own, SearchHints(lambda kind, x, residual: [kind(5.0), kind(20.0)], is_possible=lambda term, x: term.order > 9)
    )
    for kind in (Own, place_effect(Own, "elbow"), limit_kind(Own, {"wave.order": (2.0, 30.0)})):
        assert [own.order for own in make_grid(kind, x, x.torque)] == [5.0, 20.0]
        assert [is_possible(own, x) for own in make_grid(kind, x, x.torque)] == [False, True]
    narrow = limit_kind(Own, {"wave.order": (8.0, 10.0)})
    assert [own.order for own in make_grid(narrow, x, x.torque)] == [8.0, 10.0]
