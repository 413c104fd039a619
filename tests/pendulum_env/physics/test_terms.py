"""Terms: what every base term and every effect of the library promises, and how users add their own."""

from dataclasses import fields
from typing import get_args

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from pendulum_env.physics import (
    BASE,
    Column,
    Model,
    NonlinearParameter,
    Samples,
    Term,
    effect,
    effects,
    library,
    register,
)
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.effect_check import check_effect
from pendulum_env.physics.library import BUILT_IN
from pendulum_env.physics.term import Kind
from pendulum_env.plant import get_typical_values, read_parameters
from tests.terms import CubicDamping

TERMS = {term.id: term for term in BASE} | {id: kind() for id, kind in effects().items()}
TERMS["hard_stop"] = effect("hard_stop")(-2.0, 3.0, 0.1, 0.01)  # by itself it is nowhere
TERMS["joint_flexibility"] = effect("joint_flexibility")(50.0, 4.0)  # a damping of one hides how it enters
COLUMNS = {
    f"{column.name}{' (fixed)' * (column in term.fixed)}": (id, part, place)
    for id, term in TERMS.items()
    for part in ("columns", "fixed")
    for place, column in enumerate(getattr(term, part))
}
WITH_MEMORY = [id for id, term in TERMS.items() if type(term).advance is not Term.advance]
LAWS = ("mass", "force", "dry")

every_term = pytest.mark.parametrize("id", TERMS)
every_column = pytest.mark.parametrize("name", COLUMNS)


def motion(shape: tuple[int, ...], seed: int = 0) -> Samples:
    """Random samples of that shape: several turns, both directions, both signs of torque."""
    rng = np.random.default_rng(seed)
    time, position = rng.uniform(0, 20, shape), rng.uniform(-8, 8, shape)
    return Samples(time, position, 4 * rng.standard_normal(shape), 3 * rng.standard_normal(shape))


def at(x: Samples, index: int) -> Samples:
    """One of the samples, as numbers."""
    memory = {id: tuple(np.float64(state[index]) for state in states) for id, states in x.memory.items()}
    return Samples(x.time[index], x.position[index], x.velocity[index], x.torque[index], memory)


def remembering(term: Term, x: Samples) -> Samples:
    """The samples with the state in which the term starts there."""
    if type(term).advance is Term.advance:
        return x
    return Samples(x.time, x.position, x.velocity, x.torque, {term.id: term.start(x)})


def column(name: str) -> tuple[Term, Column]:
    id, part, place = COLUMNS[name]
    return TERMS[id], getattr(TERMS[id], part)[place]


def test_the_library_holds_what_is_a_contract_and_no_two_terms_share_an_id_nor_two_columns_a_name():
    assert [term.id for term in BASE] == ["inertia", "gravity", "viscous", "coulomb"]
    promised = """torque_offset gravity_tilt coulomb_asymmetry viscous_asymmetry stribeck quadratic_drag
        load_dependent_friction position_dependent_friction cogging torque_ripple spring actuator_lag dead_time
        torque_saturation friction_drift payload_change periodic_disturbance backlash joint_flexibility presliding
        encoder_eccentricity hard_stop"""
    assert set(promised.split()) <= effects().keys() and len(TERMS) == len(BASE) + len(effects())
    names = [column.name for term in TERMS.values() for column in term.columns]
    names += [f"{term.id}.{shape.name}" for term in TERMS.values() for shape in term.nonlinear_parameters]
    assert len(set(names)) == len(names)


@every_term
def test_term_says_its_law_and_its_fields_are_nonlinear_parameters_within_their_limits(id):
    term = TERMS[id]
    said = (term.law, type(term).__doc__)
    assert term.id == id and all(text.strip() for text in said)
    assert term.kind in get_args(Kind)
    assert term.columns or term.fixed
    assert all(c.name.split(".")[0] == id and c.unit for c in (*term.columns, *term.fixed))
    assert (twin := type(term)(**term.nonlinear_values)) == term and hash(twin) == hash(term)
    assert [field.name for field in fields(term)] == [shape.name for shape in term.nonlinear_parameters]
    for shape in term.nonlinear_parameters:
        assert shape.low <= term.nonlinear_values[shape.name] <= shape.high and shape.unit
        assert not shape.follows or shape.follows in {c.name for base in (*BASE, BackEmf()) for c in base.columns}


@pytest.mark.parametrize("kind", BUILT_IN)
def test_typical_sizes_are_of_parameters(kind):
    assert not kind.typical_size or set(read_parameters(kind.typical_size)) <= get_typical_values(kind()).keys()


@every_column
@pytest.mark.parametrize("shape", [(7,), (5, 3)], ids=["series", "batch"])
def test_laws_broadcast_each_sample_for_itself(name, shape):
    term, item = column(name)
    x = remembering(term, motion(shape))
    flat = [np.ravel(np.broadcast_to(part, shape)) for part in (x.time, x.position, x.velocity, x.torque)]
    memory = {id: tuple(np.ravel(np.broadcast_to(s, shape)) for s in states) for id, states in x.memory.items()}
    series = Samples(*flat, memory)
    a = np.linspace(-3, 3, series.time.size)
    for law in [*(getattr(item, part) for part in LAWS), item.potential, item.power, lambda y: item.torque(y, a[0])]:
        if law is None:
            continue
        together = np.ravel(np.broadcast_to(law(x), shape))
        alone = [law(at(series, k)) for k in range(series.time.size)]
        assert all(np.ndim(value) == 0 for value in alone)
        np.testing.assert_allclose(together, alone, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in COLUMNS if column(name)[1].potential])
def test_force_is_the_slope_of_the_potential_and_a_loss_and_the_potential_depends_on_the_angle_alone(name):
    _, item = column(name)
    x, step = motion((400,)), 1e-5
    ends = [item.potential(Samples(x.time, x.position + d, x.velocity, x.torque)) for d in (step, -step)]
    stored = (ends[0] - ends[1]) / (2 * step)
    np.testing.assert_allclose(item.force(x) * np.ones(400), stored + item.loss(x), atol=1e-6)
    other = motion((400,), seed=1)
    elsewhere = Samples(other.time, x.position, other.velocity, other.torque)
    np.testing.assert_array_equal(item.potential(x), item.potential(elsewhere))


@pytest.mark.parametrize(
    "losses", [{}, {"hysteresis": 0.2}, {"damping_time": 0.03}, {"hysteresis": 0.2, "damping_time": 0.03}]
)
def test_a_stop_pushes_back_never_pulls_and_gives_no_more_than_it_has_taken(losses):
    stop, x = effect("hard_stop")(-2.0, 3.0, **losses), motion((5000,))
    (item,) = stop.columns
    force = item.force(x)
    depth = np.where(x.position > 3, x.position - 3, np.minimum(x.position + 2, 0))
    assert np.all(force[depth == 0] == 0)
    assert np.all(force * np.sign(depth) >= 0)
    assert np.all(item.power(x) >= 0)
    if not losses:
        np.testing.assert_array_equal(force, depth)


@pytest.mark.parametrize(("lower", "upper"), [(-np.inf, 3.0), (-2.0, np.inf)])
def test_a_stop_at_infinity_is_none(lower, upper):
    x = motion((1000,))
    (both,), (one,) = (effect("hard_stop")(*stops, 0.1).columns for stops in ((-2.0, 3.0), (lower, upper)))
    there = x.position > 0 if upper == 3.0 else x.position < 0
    np.testing.assert_array_equal(one.force(x), np.where(there, both.force(x), 0.0))
    np.testing.assert_array_equal(one.potential(x), np.where(there, both.potential(x), 0.0))


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_a_bumper_gives_back_the_share_of_a_slow_impact_that_hunt_and_crossley_say(speed):
    c = 0.1
    model = Model.build([TERMS["inertia"], effect("hard_stop")(upper=0.0, hysteresis=c)], [0.1, 400.0])
    path = model.simulate(1e-4, np.zeros(2000), -1e-6, speed)
    assert path.position[-1] < 0
    assert -path.velocity[-1, 0] / speed == pytest.approx(1 - 2 / 3 * c * speed, abs=0.5 * (c * speed) ** 2)


@pytest.mark.parametrize("id", WITH_MEMORY)
def test_a_joint_that_rests_for_long_stays_in_the_state_in_which_it_starts(id):
    term = TERMS[id]
    closeness = 0.01 if term.kind == "transmission" else 1e-9  # the link hangs to first order in its stretch
    x = motion((20,))
    x = Samples(x.time, 0.3 * x.position, np.zeros(20), x.torque)
    memory = term.start(x)
    for state, later in zip(memory, term.advance(memory, x, 0.05), strict=True):
        np.testing.assert_allclose(later, state * np.ones(20), atol=closeness)


@pytest.mark.parametrize("id", ["actuator_lag", "presliding"])
def test_two_short_advances_are_one_long_advance(id):
    term, x = TERMS[id], motion((30,))
    start = term.start(motion((30,), seed=1))
    once = term.advance(start, x, 0.01)
    twice = term.advance(term.advance(start, x, 0.004), x, 0.006)
    np.testing.assert_allclose(once, twice, rtol=1e-12)


@pytest.mark.parametrize(("resonance", "damping"), [(40.0, 4.0), (150.0, 2.0), (350.0, 20.0), (500.0, 5.0)])
def test_an_elastic_link_along_a_motion_is_that_of_an_independent_integrator(resonance, damping):
    """The link follows a motor that turns by 0.7 sin 3t + 0.2 sin 17t, sampled at 1 kHz."""
    time = np.arange(3000) / 1000
    q = 0.7 * np.sin(3 * time) + 0.2 * np.sin(17 * time)
    v = 2.1 * np.cos(3 * time) + 3.4 * np.cos(17 * time)
    gravity = 20.0

    def derive(t, state):
        motor = 0.7 * np.sin(3 * t) + 0.2 * np.sin(17 * t), 2.1 * np.cos(3 * t) + 3.4 * np.cos(17 * t)
        twist, speed = motor[0] - state[0], motor[1] - state[1]
        return state[1], resonance**2 * twist + damping * speed - gravity * np.sin(state[0])

    term = effect("joint_flexibility")(resonance, damping, gravity)
    zeros = np.zeros_like(time)
    link, _ = term.trace(Samples(time, q, v, zeros), zeros, 1e-3)
    exact = solve_ivp(derive, (0.0, time[-1]), (0.0, v[0]), t_eval=time, rtol=1e-9, atol=1e-12, max_step=1e-3).y[0]
    assert np.sqrt(np.mean((link - exact) ** 2)) < 3e-5  # [rad]


@pytest.mark.parametrize(
    ("id", "delay"), [(id, delay) for id in ("actuator_lag", "dead_time") for delay in (1e-4, 1.3e-3, 4e-3, 0.03)]
)
def test_torque_that_comes_late_is_averaged_as_the_second_difference_of_the_position_averages_it(id, delay):
    """That is, under a triangle from the sample before to the sample after."""
    period, fine = 2e-3, 400
    command = np.random.default_rng(0).standard_normal(150)
    held = np.repeat(command, fine)
    if id == "dead_time":
        late = np.r_[np.full(round(delay / period * fine), command[0]), held][: len(held)]
    else:
        keep = np.exp(-period / fine / delay)
        late, _ = lfilter([0.0, 1 - keep], [1.0, -keep], held, zi=[keep * command[0]])
    ramp = (np.arange(fine) + 0.5) / fine**2
    triangle = np.r_[ramp, ramp[::-1]]
    expected = [late[(k - 1) * fine : (k + 1) * fine] @ triangle for k in range(40, 149)]
    time = period * np.arange(150)
    x = Samples(time, np.zeros(150), np.zeros(150), np.r_[command[0], 0.5 * (command[1:] + command[:-1])])
    (state,) = effect(id)(delay).trace(x, command, period)
    np.testing.assert_allclose(state[40:149], expected, atol=0.01)


@pytest.fixture
def bare_library(monkeypatch) -> None:
    """The library without users' effects, restored after the test."""
    monkeypatch.setattr(library, "_registered", {})


def cubic(module: str = __name__, **members: object) -> type[Term]:
    """Another class each time, as when a cell of a notebook runs again, or of another module."""
    return type("CubicDamping", (CubicDamping,), {"__module__": module, **members})


@pytest.mark.usefixtures("bare_library")
def test_a_registered_effect_takes_part_in_the_library_in_models_and_in_simulation():
    kind = register(cubic())
    assert list(effects())[-1] == "cubic_damping" and effect("cubic_damping") is kind
    swinging = Model.build(BASE, np.array([0.1, 2.0, 0.1, 0.0]))
    damped = swinging.add(kind(), 0.05)
    assert Model.from_json(damped.json()) == damped
    speeds = [np.ptp(model.simulate(1e-3, np.zeros(300), 2.0, 0.0).velocity) for model in (damped, swinging)]
    assert speeds[0] < speeds[1]


@pytest.mark.usefixtures("bare_library")
@pytest.mark.parametrize("taken", ["stribeck", "inertia", "cubic_damping"])
def test_an_id_cannot_be_taken_twice_and_registering_again_changes_nothing(taken):
    first = cubic()
    assert register(register(first)) is first and list(effects().values()).count(first) == 1
    columns = (Column(taken, "N m s^3/rad^3", force=lambda x: x.velocity**3),)
    with pytest.raises(ValueError, match=f"effect id '{taken}' is taken: choose another id for CubicDamping"):
        register(cubic("elsewhere", id=taken, columns=columns))


@pytest.mark.usefixtures("bare_library")
def test_a_class_that_is_written_again_takes_its_own_place_under_any_id():
    register(cubic())
    again = register(cubic(law="2 c q'^3"))
    assert effects()["cubic_damping"] is again
    columns = (Column("cubed", "N m s^3/rad^3", force=lambda x: x.velocity**3),)
    register(cubic(id="cubed", columns=columns))
    assert "cubed" in effects() and "cubic_damping" not in effects()


@pytest.mark.usefixtures("bare_library")
@pytest.mark.parametrize(
    ("members", "what"),
    [
        ({"law": None}, "law of CubicDamping"),
        ({"id": "cubic=damping"}, "id of CubicDamping"),
        ({"kind": "dissipativ"}, "kind of CubicDamping 'dissipativ': did you mean dissipative"),
        ({"nonlinear_parameters": (NonlinearParameter("speed", "rad/s", 0.1, 10.0),)}, "'speed' of .* is no field"),
        ({"columns": (Column("drag", "1"),)}, "a column of CubicDamping is named 'drag'"),
        ({"columns": (Column("cubic_damping", "1", dry=lambda x: x.speed),)}, "dry of column .* of CubicDamping: Attr"),
        ({"columns": (Column("cubic_damping", "1", mass=lambda x: 1 / (0 * x.time)),)}, "mass of .* is not finite"),
        ({"columns": (Column("cubic_damping", "1", force=lambda x: 0 * x.velocity),)}, "CubicDamping has no torque"),
        ({"columns": (Column("cubic_damping", "1", potential=lambda x: np.cos(x.position)),)}, "no force: give force"),
        (
            {"columns": (Column("cubic_damping", "1", potential=lambda x: x.position, force=lambda x: x.position),)},
            "a force that is not dU/dq",
        ),
        ({"columns": (Column("cubic_damping", "1", force=lambda x: -(x.velocity**3)),)}, "gains energy"),
        ({"kind": "potential", "columns": (Column("cubic_damping", "1", force=lambda x: x.position),)}, "no potential"),
        ({"columns": (Column("cubic_damping", "1", force=lambda x: 2 * x.velocity),)}, "has the law of 'viscous'"),
        ({"columns": (Column("cubic_damping", "1", dry=lambda x: 1.0),)}, "has the law of 'coulomb'"),
        ({"start": lambda self, x: (x.position,), "advance": lambda *_: ()}, "advance of CubicDamping"),
    ],
)
def test_an_effect_is_tried_when_it_is_registered_and_named_by_class_and_field(members, what):
    with pytest.raises(ValueError, match=what):
        register(cubic(**members))
    assert "cubic_damping" not in effects()


@pytest.mark.parametrize("id", list(effects()))
def test_every_effect_of_the_library_passes_the_check_of_a_user_s_own(id):
    check_effect(effect(id))


@pytest.mark.parametrize(("roundness", "law", "off"), [
    (1.0, lambda u: 5 * np.tanh(u / 5), 1e-12), (0.01, lambda u: np.clip(u, -5, 5), 0.02), (2.0, None, 0.0),
])  # fmt: skip
def test_saturation_is_odd_of_slope_one_and_ends_at_its_limit_usually_as_a_tanh_and_else_as_a_clip(roundness, law, off):
    torque = np.concatenate([np.linspace(-60, 60, 2001), [-1e9, 1e9]])
    x = Samples(0 * torque, 0 * torque, 0 * torque, torque)
    given = torque - effect("torque_saturation")(5.0, roundness).fixed[0].force(x)
    np.testing.assert_allclose(given[:2001], -given[2000::-1], atol=1e-12)
    assert np.all(np.diff(given[:2001]) >= -1e-12)
    np.testing.assert_allclose(given[-2:], [-5.0, 5.0], rtol=1e-6)
    np.testing.assert_allclose(np.gradient(given[:2001], 0.06)[1000], 1.0, atol=0.02)
    if law is not None:
        np.testing.assert_allclose(given, law(torque), atol=off)
