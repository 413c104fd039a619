"""Tables are the splines of the books, say nothing that the base laws say, and are simulated, saved and exported."""

import pickle

import numpy as np
import pytest
from msgspec.structs import astuple
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pendulum_env.errors import UserError
from pendulum_env.physics import Model, ModelError, Samples
from pendulum_env.physics.actuation import TorqueOffset
from pendulum_env.physics.friction import QuadraticDrag
from pendulum_env.physics.potential import GravityTilt, Spring
from pendulum_env.physics.simulation import compile_step
from pendulum_env.physics.table import (
    Extent,
    FrictionByAngle,
    FrictionBySpeed,
    GainByTime,
    Table,
    TorqueByAngle,
)
from pendulum_env.plant import paper_plant

KINDS = [
    TorqueByAngle.with_extent(Extent(-1.2, 2.1, 9, ("sine",))),
    TorqueByAngle.with_extent(Extent(-np.pi, np.pi, 12, ("sine",))),
    FrictionByAngle.with_extent(Extent(-0.3, 0.9, 5)),
    FrictionByAngle.with_extent(Extent(-np.pi, np.pi, 7)),
    FrictionBySpeed.with_extent(Extent(0.0, 7.0, 8)),
    TorqueByAngle.with_extent(Extent(-1.2, 2.1, 12, ("sine",), merged=(1, 2, 5, 11))),
    FrictionByAngle.with_extent(Extent(-np.pi, np.pi, 9, merged=(1, 4, 5))),
    FrictionByAngle.with_extent(Extent(-np.pi, np.pi, 4, merged=(2,))),
]
GAIN = GainByTime.with_extent(Extent(0.0, 7.0, 5))  # which competes with effects, and no model keeps
SAID_ALREADY = {  # by the base model, of the table's argument
    "torque_by_angle": [np.sin],
    "friction_by_angle": [lambda q: 1.0],
    "friction_by_speed": [lambda v: 1.0, lambda v: v],
}


def values(kind: type[Table], x) -> np.ndarray:
    return np.column_stack([np.broadcast_to(own, np.shape(x)) for own in kind.basis(np.asarray(x, dtype=float))])


def in_model(kind: type[Table], size: float = 0.3) -> Model:
    theta = size * np.random.default_rng(0).uniform(-1.0, 1.0, len(kind().columns))
    plant = paper_plant()
    return Model.build((*plant.terms, kind()), np.r_[plant.theta, theta], 0.01)


@pytest.mark.parametrize("kind", [*KINDS, GAIN])
def test_every_column_is_a_cubic_spline_and_together_they_are_all_there_are(kind):
    low, high, pieces, _, merged = astuple(kind.extent)
    scale = np.sqrt if kind.axis == "velocity" else np.positive
    knots = np.delete(np.linspace(scale(low), scale(high), pieces + 1), merged)
    at_knots = values(kind, knots**2 if kind.axis == "velocity" else knots)
    spline = CubicSpline(knots, at_knots, bc_type="periodic" if kind.extent.is_periodic else "natural")
    x = np.linspace(low, high, 997)
    np.testing.assert_allclose(values(kind, x), spline(scale(x)), atol=1e-9)
    heights = len(knots) - kind.extent.is_periodic
    assert np.linalg.matrix_rank(at_knots) == heights - len(SAID_ALREADY.get(kind.id, ["none at first"]))


@pytest.mark.parametrize("kind", [*KINDS, GAIN])
def test_a_table_says_nothing_that_the_base_model_says_and_goes_on_beyond_its_ends_or_round_the_turn(kind):
    low, high, *_ = astuple(kind.extent)
    x = low + (high - low) * (np.arange(20_000) + 0.5) / 20_000
    for law in SAID_ALREADY.get(kind.id, []):
        inner = np.mean(values(kind, x) * np.broadcast_to(law(x), x.shape)[:, None], axis=0)
        assert np.abs(inner).max() < 2e-3
    if kind is GAIN:
        np.testing.assert_allclose(values(kind, [0.0]), 0.0, atol=1e-12)
    if kind.extent.is_periodic:
        x = np.linspace(-3.0, 3.0, 41)
        np.testing.assert_allclose(values(kind, x + 4 * np.pi), values(kind, x), atol=1e-9)
    else:
        np.testing.assert_array_equal(values(kind, [high + 5.0]), values(kind, [high]))


@pytest.mark.parametrize("kind", KINDS)
def test_a_curve_is_the_law_and_its_errors_are_those_of_many_draws(kind):
    model = in_model(kind)
    term, curve = model.tables[kind.id]
    rng, names = np.random.default_rng(1), [column.name for column in term.columns]
    theta = np.array([model.estimates[name].value for name in names])
    draws = theta + 1e-2 * rng.standard_normal((4000, len(names)))
    many = values(kind, curve.x) @ draws.T
    np.testing.assert_allclose(curve.value, values(kind, curve.x) @ theta)
    np.testing.assert_allclose(curve.std, many.std(axis=1), rtol=0.1, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_compiled_and_plain_simulation_agree_with_an_integrator_that_knows_the_curve_alone(kind):
    model = in_model(kind)
    curve = model.tables[kind.id][1]
    own = CubicSpline(curve.x, curve.value)
    value = {name: e.value for name, e in model.estimates.items()}
    period, torque = 0.2, np.full(2, 5.0)

    def law(t, state):  # while the joint turns one way
        q, v = state
        by_angle = own(
            np.mod(q + np.pi, 2 * np.pi) - np.pi if kind.extent.is_periodic else np.clip(q, *astuple(kind.extent)[:2])
        )
        by_speed = own(np.clip(v, *astuple(kind.extent)[:2]))
        lost = by_speed if kind.axis == "velocity" else by_angle
        rest = 5.0 - lost - value["gravity"] * np.sin(q) - value["viscous"] * v - value["coulomb"]
        return v, rest / value["inertia"]

    exact = solve_ivp(law, (0.0, 0.4), (-0.3, 0.5), method="DOP853", rtol=1e-10, atol=1e-10).y[0, -1]
    assert compile_step(model.terms) is not None
    compiled = model.simulate(period, torque, -0.3, 0.5).position[-1, 0]
    batch = model.simulate(period, torque, np.array([-0.3, -0.3]), 0.5).position[-1]
    assert compiled == pytest.approx(exact, abs=2e-5)
    np.testing.assert_allclose(batch, compiled, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_file_keeps_a_table_and_so_does_a_process(kind, tmp_path):
    model = in_model(kind)
    model.save(tmp_path / "m.json")
    again = Model.load(tmp_path / "m.json")
    assert again.terms == model.terms == pickle.loads(pickle.dumps(model)).terms
    assert again.estimates == model.estimates
    np.testing.assert_array_equal(again.tables[kind.id][1].value, model.tables[kind.id][1].value)
    assert len(again.readable) == 5  # four parameters, and the table in one row


@pytest.mark.parametrize(
    ("kind", "extent"),
    [
        (KINDS[0], {"low": 1.0, "high": 0.0, "pieces": 4}),
        (KINDS[0], {"low": 1.0, "high": 1.0 + 1e-15, "pieces": 4}),
        (KINDS[0], {"low": 0.0, "high": 1.0, "pieces": 4, "beside": ["tan"]}),
        (KINDS[0], {"low": 0.0, "high": 1.0, "pieces": 4, "merged": [4]}),
        (KINDS[0], {"low": 0.0, "high": 1.0, "pieces": 5, "merged": [1, 1]}),
        (KINDS[0], {"low": 0.0, "high": 1.0, "pieces": 4, "merged": [1, 2]}),
        (KINDS[0], {"low": 0.0}),
        (KINDS[4], {"low": -1.0, "high": 1.0, "pieces": 8}),  # no speed is below zero
    ],
)
def test_an_extent_that_makes_no_sense_is_one_sentence(kind, extent):
    data = in_model(kind).json() | {"tables": {kind.id: extent}}
    with pytest.raises(ModelError, match=rf"tables\.{kind.id}|lacks 'high'"):
        Model.from_json(data)


def test_what_a_table_may_be_is_added_before_it():
    by_angle, friction = in_model(KINDS[0]), in_model(KINDS[2])
    for known in (TorqueOffset(), Spring(), GravityTilt()):
        with pytest.raises(
            UserError, match=f"'torque_by_angle' holds all that '{known.id}' is: add '{known.id}' first"
        ):
            by_angle.add(known)
        assert friction.add(known).terms[-1] == known
    assert by_angle.add(QuadraticDrag()).terms[-1] == QuadraticDrag()


def test_a_gain_scales_the_torque_and_friction_takes_the_sign_of_the_speed():
    x = Samples(np.full(3, 2.0), np.zeros(3), np.array([-2.0, 0.0, 2.0]), np.array([1.0, 1.0, 3.0]))
    gain, friction = GAIN().columns[2], KINDS[4]().columns[2]
    share = values(GAIN, [2.0])[0, 2]
    np.testing.assert_allclose(gain.torque(x, 0.0)[[0, 2]], [share, 3.0 * share])
    magnitude = values(KINDS[4], [2.0])[0, 2]
    np.testing.assert_allclose(friction.torque(x, 0.0), [-magnitude, 0.0, magnitude])
