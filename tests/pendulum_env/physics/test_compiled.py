"""Compiled programs: as NumPy computes them, for any expression, every effect, and laws that cannot be written down."""

import gc
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.search_hints import make_grid
from pendulum_env.physics import BASE, Column, KnownLoad, Samples, Term, compiled, effects, simulate
from pendulum_env.physics.compiled import Machine, SymbolicStep, compile_recurrence
from pendulum_env.physics.potential import Cogging
from pendulum_env.physics.simulation import TorqueBalance, compile_step, step
from pendulum_env.physics.symbols import make_symbol, make_symbols
from pendulum_env.physics.term import _compile_advance, trace_variants
from pendulum_env.plant import hide, paper_plant
from tests.terms import Clipped, Table

H, LANES = np.array([1e-3, 0.7e-3, 0.9e-3]), 3
UNARY = (np.negative, np.abs, np.sin, np.cos, np.tanh, np.arctan, np.sign, lambda x: np.exp(np.minimum(x, 5.0)))
BINARY = (
    np.add,
    np.subtract,
    np.multiply,
    np.maximum,
    np.minimum,
    lambda x, y: x / (1.0 + y**2),
    lambda x, y: np.abs(x) ** np.clip(y, 0.0, 3.0),
    lambda x, y: np.where((x < y) & (x != 0) | (y >= 1.0371), x, y),  # no function rounds to this threshold
    lambda x, y: x * (x > y),
)
numbers = st.floats(-20.0, 20.0)
expressions = st.recursive(
    st.sampled_from("xy").map(lambda text: lambda v: v[text]) | numbers.map(lambda c: lambda v: np.float64(c)),
    lambda inner: (
        st.tuples(st.sampled_from(UNARY), inner).map(lambda p: lambda v: p[0](p[1](v)))
        | st.tuples(st.sampled_from(BINARY), inner, inner).map(lambda p: lambda v: p[0](p[1](v), p[2](v)))
    ),
    max_leaves=12,
)


def computed(result, x, y=0.0) -> np.ndarray:
    """Values (N,) of an expression in the names x and y."""
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), y)
    program = compile_recurrence([make_symbol("x")], [], [make_symbol("y")], [result])
    return program(x[None, None], np.empty((0, 1, len(x))), y[None, None])[1, 0, 0]


@settings(max_examples=50)  # a program is compiled for each
@given(expressions, st.lists(st.tuples(numbers, numbers), min_size=1, max_size=9))
def test_an_expression_has_the_value_that_numpy_gives_it(expression, values):
    x, y = np.array(values).T
    result = computed(expression({"x": make_symbol("x"), "y": make_symbol("y")}), x, y)
    np.testing.assert_allclose(result, expression({"x": x, "y": y}) + 0.0 * x, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("values", [[np.inf, -np.inf, 0.0, -0.0], [1e300, -1e300, 1e-300, 5.0]])
def test_values_beyond_all_bounds_are_held_at_them(values):
    def held(x):
        return np.fmin(np.fmax(x * x - x, -7.0), 7.0)

    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(computed(held(make_symbol("x")), values), held(np.array(values)))


@pytest.mark.parametrize("function", [np.sin, np.cos])
@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=9))
def test_a_sine_has_all_digits_is_none_of_no_number_and_within_its_bounds_of_a_large_one(function, angles):
    some = computed(function(make_symbol("x")), [*angles, np.nan, np.inf, -np.inf, 1e20, -1e300, 1e12])
    np.testing.assert_allclose(some[:-6], function(angles), rtol=0, atol=1e-15)
    assert np.isnan(some[-6:-3]).all() and (np.abs(some[-3:]) <= 1.0).all()


def falling(gravity: float) -> SymbolicStep:
    """A ball under a push, that forgets half its speed at each step."""
    push, speed, height = make_symbols("push"), make_symbols("speed"), make_symbols("height", 2)
    after = 0.5 * speed + push - gravity
    moved = height + np.array([after, 2.0 * after])
    now = {"speed": after, "height": moved, "sum": moved @ moved}
    return SymbolicStep({"push": push}, {"speed": speed, "height": height}, now)


def test_a_machine_outlives_the_programs_that_are_remembered():
    machine = Machine(falling, (0.25,), 1)
    compiled._compile.cache_clear()
    gc.collect()
    machine.step()
    np.testing.assert_allclose(machine.states["speed"], [-0.25])


def stepped(model, torque, load) -> np.ndarray:
    """Position of three pendulums by the simulator's own step, one NumPy operation after the other."""
    balance = TorqueBalance(model.terms, model.theta, has_load=True)
    q, v = np.array([0.3, -1.0, 2.0]), np.array([0.0, 1.0, -2.0])
    x = Samples(np.zeros(LANES), q, v, torque[0], load=load)
    x = replace(x, memory=balance.start(x))
    path = [q]
    for command in torque:
        x = step(balance, replace(x, torque=command), H)
        path.append(x.position)
    return np.array(path)


@pytest.mark.parametrize("id", [id for id in effects() if id != "dead_time"])
def test_every_effect_moves_under_a_load_as_its_own_step_says(id):
    model, load = hide(paper_plant(), id), KnownLoad(0.02, 0.5)  # without one: see test_engines.py
    torque = 4.0 * np.random.default_rng(0).standard_normal((150, LANES)).cumsum(axis=0) / 8
    assert compile_step(model.terms, True, H) is not None, (
        "a function of the law is not in UNARY and BINARY of pendulum_env/physics/symbols.py"
    )
    path = simulate(model.terms, model.theta, H, torque, [0.3, -1.0, 2.0], [0.0, 1.0, -2.0], load=load)
    np.testing.assert_allclose(path.position, stepped(model, torque, load), rtol=0, atol=1e-10)


@pytest.mark.parametrize("period", [1e-3, 5e-3])
@pytest.mark.parametrize("id", [id for id, effect in effects().items() if effect.advance is not Term.advance])
def test_states_along_a_motion_are_those_that_each_advance_gives(id, period):
    rng = np.random.default_rng(1)
    time = period * np.arange(300)
    position = np.sin(5 * time) + 0.2 * np.sin(23 * time)
    x = Samples(time, position, np.gradient(position, period), rng.standard_normal(300))
    tried = make_grid(effects()[id], x, np.zeros(300))
    variants = [tried[0], tried[len(tried) // 2], tried[-1]]
    assert _compile_advance(tried[0], len(tried[0].start(x)), np.array(period)) is not None
    for variant, memory in zip(variants, trace_variants(variants, [x], [x.torque], [period])[0], strict=True):
        own = [variant.start(Samples(time[0], position[0], x.velocity[0], x.torque[0]))]
        for k in range(299):
            speed = 0.5 * (x.velocity[k] + x.velocity[k + 1])
            own.append(variant.advance(own[-1], Samples(time[k], position[k], speed, x.torque[k]), period))
        np.testing.assert_allclose(memory, np.array(own, dtype=float).T, rtol=1e-9, atol=1e-9)


def test_a_law_that_cannot_be_written_down_is_simulated_all_the_same():
    assert compile_step([Table()]) is None
    torque = np.sin(np.arange(300) / 20)
    tabled, clipped = (paper_plant().add(kind(), [0.7]).simulate(1e-3, torque, 0.5, 0.0) for kind in (Table, Clipped))
    np.testing.assert_allclose(tabled.position, clipped.position, rtol=0, atol=1e-12)


def added_in_place(x):
    y = x + 0.0
    y += 1.0
    return y


@pytest.mark.parametrize(
    "law",
    [
        lambda x: 1.0 if x > 0 else 0.0,
        lambda x: float(x),
        lambda x: len(x),
        lambda x: x[0],
        lambda x: x % 2,
        lambda x: np.divide(1.0, x, out=np.zeros_like(x), where=x != 0),
        lambda x: np.hypot(x, 1.0),
        lambda x: np.where(x > 0),
        lambda x: x.max(),
        lambda x: 1.0 if np.any(x > 0) else 0.0,
        lambda x: np.zeros(np.shape(x)),
        added_in_place,
    ],
)
def test_a_law_that_is_no_expression_is_never_taken_for_one(law):
    with pytest.raises((TypeError, AttributeError)):
        law(make_symbol("x"))


def test_what_a_law_reads_besides_its_shapes_is_read_anew(monkeypatch):
    @dataclass(frozen=True)
    class Warm(Term):
        id, law, kind = "warm", "g(t) q'", "dissipative"
        share = 1.0

        @property
        def columns(self):
            return (Column("warm", "N m s/rad", force=lambda x: self.share * x.velocity),)

    torque = np.sin(np.arange(300) / 20)
    cold, warm = (paper_plant().add(Warm(), [k]).simulate(1e-3, torque, 0.5, 0.0).position for k in (0.2, 0.4))
    assert np.abs(cold - warm).max() > 1e-4
    monkeypatch.setattr(Warm, "share", 2.0)
    np.testing.assert_allclose(paper_plant().add(Warm(), [0.2]).simulate(1e-3, torque, 0.5, 0.0).position, warm)


def test_two_terms_of_a_class_have_their_own_shapes():
    torque, base = 3 * np.sin(np.arange(400) / 30), [0.09, 2.0, 0.3, 0.5]
    path, swapped = (
        simulate([*BASE, *cogs], np.array([*base, *theta]), 1e-3, torque, 0.2, 0.0).position
        for cogs, theta in (
            ((Cogging(3.0), Cogging(17.0)), (0.3, 0.1, 0.2, 0.4)),
            ((Cogging(17.0), Cogging(3.0)), (0.2, 0.4, 0.3, 0.1)),
        )
    )
    np.testing.assert_allclose(path, swapped, rtol=0, atol=1e-10)
