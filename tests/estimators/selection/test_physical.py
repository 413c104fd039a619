"""What a body can be."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy

from estimators.checks.signs import NegativeParameters, find_driving_friction
from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Errors, Step
from estimators.decisions.gate import explain_rejection
from estimators.regression.least_squares import Equations, Fit, solve
from estimators.selection.gates import compare_base, compare_errors, compute_coefficient_chance
from estimators.selection.physical import find_violations
from pendulum_env.physics import BASE, Column, Model, Samples, Term, effect, list_ids
from pendulum_env.physics.actuation import ActuatorLag
from pendulum_env.physics.joints import get_coupling, place_term
from pendulum_env.physics.limits import limit_term
from pendulum_env.physics.term import UNLOADED, KnownLoad, derive_kind
from pendulum_env.physics.time_varying import PayloadChange

X = Samples(*np.ones((4, 3)))


def of(effect: Term) -> Model:
    return Model.build([*BASE, effect], [0.1, 2.0, 0.1, 0.1], [0.01] * 4)


def test_a_lag_of_seconds_is_no_drives_but_what_a_user_bounds_may_lie_at_its_bound():
    assert find_violations(of(ActuatorLag(0.01)), {"": X}) == []
    (violated,) = find_violations(of(ActuatorLag(2.0)), {"": X})
    assert (violated.name, violated.value, violated.limit) == ("actuator_lag.time_constant", 2.0, 2.0)
    narrow = limit_term(ActuatorLag(0.01), {"actuator_lag.time_constant": (0.001, 0.01)})
    assert find_violations(of(narrow), {"": X}) == []


def test_friction_at_a_motor_of_two_joints_is_friction_of_both():
    """A joint that has none of its own may come out a little negative; the motor's own may not."""
    terms = [place_term(own, joint) for joint in ("elbow", "wrist") for own in BASE[2:]]
    motions = {"elbow": X, "wrist": X}
    little = [-0.0005, -0.001, 0.1, 0.1]
    assert [own.name for own in find_violations(Model.build(terms, little), motions)] == ["driving_friction"]
    both = [*terms, get_coupling("elbow,-wrist", True)()]
    assert find_violations(Model.build(both, [*little, 0.01, 0.2, 0.3]), motions) == []
    (told,) = find_driving_friction(Model.build(terms, [0.1, 0.2, -0.2, 0.1], 0.01))
    assert told == NegativeParameters(("viscous@wrist",))
    (wrong,) = find_violations(Model.build(both, [*little, -5.0, 0.2, 0.3]), motions)
    assert (wrong.name, wrong.value) == ("coupling.inertia@elbow,-wrist", -5.0)


def swinging(load: KnownLoad = UNLOADED) -> Samples:
    """A heavy arm let go from level, whose motor hardly pushes."""
    time = np.linspace(0.0, 10.0, 1000)
    return Samples(time, 1.5 * np.cos(3 * time), -4.5 * np.sin(3 * time), np.full(1000, 0.01), load=load)


def test_dry_friction_may_be_what_gravity_or_a_load_overcame():
    theta = dict(zip(("inertia", "gravity", "viscous", "coulomb"), (0.1, 2.0, 0.01, 0.3), strict=True))
    assert find_violations(Model.build(BASE, list(theta.values())), {"": swinging()}) == []
    light = Model.build(BASE, list((theta | {"gravity": 0.1}).values()))
    (violated,) = find_violations(light, {"": swinging()})
    assert violated.name == "dry_friction" and violated.value == pytest.approx(0.3)
    assert violated.limit == pytest.approx(0.11, abs=0.005)
    assert find_violations(light, {"": swinging(KnownLoad(0.05, 1.0))}) == []


def test_friction_at_rest_is_bounded_though_no_sample_is_at_rest():
    """A joint that has moved was at rest before; how far a law is extrapolated to it does not matter."""
    x = swinging()
    moving = np.abs(x.velocity) > 0.1
    clear = Samples(*(values[moving] for values in (x.time, x.position, x.velocity, x.torque)))
    slow, theta = effect("stribeck")(stribeck_velocity=0.01), [0.1, 2.0, 0.01, 0.3]
    assert find_violations(Model.build([*BASE, slow], [*theta, 0.5], 0.01), {"": clear}) == []
    for std in (1e39, np.inf):
        (violated,) = find_violations(Model.build([*BASE, slow], [*theta, 1e40], [0.01] * 4 + [std]), {"": clear})
        assert violated.name == "dry_friction"
    assert find_violations(Model.build([*BASE, slow], [*theta, 5.0], [0.01] * 4 + [2.0]), {"": clear}) == []


def test_the_torque_of_breaking_away_bounds_friction_at_rest():
    """Samples in motion leave it out."""
    x = swinging()
    recorded = replace(x, torque=np.where(np.arange(len(x.time)) == 500, 3.0, x.torque))
    slow, theta = effect("stribeck")(stribeck_velocity=0.01), [0.1, 0.1, 0.01, 0.3]
    for size, names in ((2.5, []), (3.0, ["dry_friction"])):
        model = Model.build([*BASE, slow], [*theta, size], 0.01)
        assert [gate.name for gate in find_violations(model, {"": x}, {"": recorded})] == names
        assert [gate.name for gate in find_violations(model, {"": x})] == ["dry_friction"]


def test_only_the_sum_of_friction_that_changes_with_time_has_to_be_possible():
    terms = [*BASE, effect("friction_drift")(3000.0)]  # nearly a straight line over 10 s
    assert find_violations(Model.build(terms, [0.1, 2.0, 0.01, 50.0, 0.0, -49.8]), {"": swinging()}) == []
    (large,) = find_violations(Model.build(terms, [0.1, 0.1, 0.01, 50.0, 0.0, -49.8]), {"": swinging()})
    assert large.name == "dry_friction" and large.value == pytest.approx(0.2 + 49.8 * 5 / 3000, abs=0.01)
    (driving,) = find_violations(Model.build(terms, [0.1, 2.0, 0.01, 50.0, 0.0, -50.3]), {"": swinging()})
    assert driving.name == "driving_friction"


@pytest.mark.parametrize(("std", "names"), [(0.001, ["driving_friction"]), (0.1, [])])
def test_friction_that_is_negative_at_few_angles_drives_unless_its_error_allows_none(std, names):
    """Dry friction 0.3 + 0.32 sin q is negative within 0.36 rad of a quarter turn back."""
    terms = [*BASE, effect("position_dependent_friction")()]
    model = Model.build(terms, [0.1, 2.0, 0.0, 0.3, 0.32, 0.0], std)
    x = swinging()
    assert 0 < np.mean(0.3 + 0.32 * np.sin(x.position) < 0) < 0.3
    assert [own.name for own in find_violations(model, {"": x})] == names


@pytest.mark.parametrize(
    (
        "theta",
        "std",
        "limits",
        "is_pushing",
    ),  # stiffness and preload, and of a hardening spring the quadratic and cubic
    [
        ((0.3, 0.0), 0.0, {}, False),
        ((-0.3, 0.0), 0.0, {}, True),
        ((-0.3, 0.0), 0.09, {}, True),
        ((-0.3, 0.0), 0.11, {}, False),  # or it may be noise
        ((-0.3, 0.0), np.inf, {}, False),
        ((-0.3, 0.0), 0.0, {"spring.stiffness": (-1.0, 0.0)}, False),  # the user allows it
        ((-0.3, 0.5), 0.0, {"spring.preload": (0.0, 1.0)}, True),
        ((0.3, 0.0, 0.0, 5.0), 0.01, {}, False),
        ((-0.3, 0.0, 0.0, 5.0), 0.01, {}, True),
        ((0.1, 0.0, 0.0, -5.0), 0.01, {}, True),  # dF/dq = 0.1 - 15 q^2
        ((0.1, 0.0, 0.0, -0.01), 0.01, {}, False),  # 0.1 - 0.03 q^2 is positive within 1.5 rad
        ((0.1, 0.0, 0.5, 0.0), 0.01, {}, True),  # 0.1 + q
    ],
)
def test_a_spring_pulls_back_at_each_recorded_angle_unless_its_error_or_the_user_allows_else(
    theta, std, limits, is_pushing
):
    spring = limit_term(effect("spring")(3.0 if len(theta) == 4 else 1.0), limits)
    model = Model.build([*BASE, spring], [0.1, 2.0, 0.1, 0.1, *theta], [0.01] * 4 + [std] * len(theta))
    names = [own.name for own in find_violations(model, {"": swinging()})]
    assert names == (["spring.stiffness"] if is_pushing else [])


@pytest.mark.parametrize("correlation", [-0.5, 0.0, 0.5])
def test_friction_with_an_unknown_error_is_not_known_to_drive(correlation):
    model = Model.build(BASE, [0.1, 2.0, 0.1, -0.2], [0.01, 0.01, 0.01, np.inf])
    known = np.eye(4)
    known[2, 3] = known[3, 2] = correlation
    model = replace(model, correlation=tuple(map(tuple, known.tolist())))
    assert find_violations(model, {"": swinging()}) == []


def test_a_payload_may_overcome_dry_friction_but_a_stop_may_not_and_bristles_do_not_push():
    dropped, stopped, bristles = (effect(id) for id in ("payload_change", "hard_stop", "presliding"))
    assert find_violations(Model.build([*BASE, dropped(5.0)], [0.1, 0.1, 0.01, 0.3, 0.0, 2.0]), {"": swinging()}) == []
    (violated,) = find_violations(
        Model.build([*BASE, stopped(-1.0, 1.0)], [0.1, 0.1, 0.01, 8.0, 100.0]), {"": swinging()}
    )
    assert violated.name == "dry_friction" and violated.value == pytest.approx(8.0)
    for force, wrong in ((0.1, []), (-0.1, [("presliding", -0.1)])):
        found = find_violations(Model.build([*BASE, bristles(0.01)], [0.1, 2.0, 0.1, 0.3, force]), {"": X})
        assert [(own.name, own.value) for own in found] == wrong


@pytest.mark.parametrize(("share", "is_too_soft"), [(0.2, True), (0.9, False)])
@pytest.mark.parametrize("stiffness", [0.02, 1.0])
def test_a_stop_that_the_motion_presses_in_by_more_than_the_free_range_limits_nothing(stiffness, share, is_too_soft):
    """A soft stop is a cable or a bumper, however far the largest torque would press it in at rest."""
    x = swinging()
    ends = share * float(x.position.min()), share * float(x.position.max())
    model = Model.build([*BASE, effect("hard_stop")(*ends)], [0.1, 0.1, 0.01, 0.01, stiffness])
    found = find_violations(model, {"": x})
    assert [own.name for own in found] == (["soft_stop"] if is_too_soft else [])


@pytest.mark.parametrize(
    ("torque", "position", "inertia", "failed"),
    [
        (0.5, 0.05, 0.1, None),
        (0.5, 0.2, 0.1, "holdout_position"),
        (2.0, 0.05, 0.1, "holdout_torque"),
        (2.0, 0.2, 0.1, "holdout_position"),  # the first that fails is the last
        (0.5, np.nan, 0.1, None),  # nothing was simulated
        (0.5, 0.05, -0.1, "negative_inertia"),
    ],
)
def test_a_step_meets_physical_bounds_and_held_out_errors_in_this_order(torque, position, inertia, failed):
    before = Step(None, Model.build(BASE, [0.1, 2.0, 0.1, 0.1], 0.01), {"holdout": Errors(1.0, 0.1, joints={"": 1.0})})
    model = Model.build([*BASE, effect("torque_offset")()], [inertia, 2.0, 0.1, 0.1, 0.2], 0.01)
    after = Step("torque_offset", model, {"holdout": Errors(torque, position, joints={"": torque})})
    gates = compare_errors(after, before, {"": X})
    assert [gate.name for gate in gates if not gate.passed][:1] == ([] if failed is None else [failed])
    assert all(gate.passed for gate in gates[:-1])
    assert (explain_rejection(gates) is None) == (failed is None)


@pytest.mark.parametrize(("torque", "passed"), [(0.5, True), (2.0, False)])
def test_without_motion_the_torque_alone_decides(torque, passed):
    before = Step(None, Model.build(BASE, [0.1, 2.0, 0.1, 0.1], 0.01), {"holdout": Errors(1.0, 0.1, joints={"": 1.0})})
    after = replace(before, errors={"holdout": Errors(torque, 0.2, joints={"": torque})})
    assert all(gate.passed for gate in compare_errors(after, before, {"": X}, has_motion=False)) == passed


def test_an_effect_without_torque_is_none_whatever_the_errors():
    terms = [*BASE, effect("stribeck")(stribeck_velocity=0.1)]
    before = Step(None, Model.build(BASE, [0.1, 2.0, 0.1, 0.1], 0.01), {"holdout": Errors(1.0, 0.1, joints={"": 1.0})})
    for size, passed in ((0.0, False), (0.1, True)):
        model = Model.build(terms, [0.1, 2.0, 0.1, 0.1, size], 0.01)
        after = Step("stribeck", model, {"holdout": Errors(0.9, 0.09, joints={"": 0.9})})
        assert all(gate.passed for gate in compare_errors(after, before, {"": X})) == passed


@pytest.mark.parametrize(("torque", "passed"), [(1.04, True), (1.06, False)])
def test_a_torque_error_may_rise_by_its_margin_if_the_position_error_falls(torque, passed):
    before, after = (
        Step(None, Model.build(BASE, [0.1, 2.0, 0.1, 0.1], 0.01), {"holdout": Errors(own, angle, joints={"": own})})
        for own, angle in ((1.0, 0.1), (torque, 0.05))
    )
    assert all(gate.passed for gate in compare_errors(after, before, {"": X}, torque_margin=0.05)) == passed
    assert not all(gate.passed for gate in compare_errors(after, before, {"": X}))


@pytest.mark.parametrize(
    ("id", "coefficients", "std", "p_value"),
    [
        ("torque_offset", [1.0], 1.0, 0.3173),
        ("torque_offset", [-2.5], 1.0, 0.01242),
        ("cogging", [1.5, 1.5], 1.0, 0.1054),  # exp(-z^2 / 2) of both together
        ("cogging", [2.0, 2.0], 1.0, 0.01832),
        ("torque_offset", [0.2], 0.0, 0.0),  # given
    ],
)
def test_coefficients_that_may_all_be_zero_fail_the_gate_of_their_effect(id, coefficients, std, p_value):
    terms, count = [*BASE, effect(id)()], len(coefficients)
    covariance = np.diag([1.0] * 4 + [std**2] * count)
    fit = Fit(
        np.array([0.1, 2.0, 0.1, 0.1, *coefficients]),
        covariance,
        np.empty(0),
        1.0,
        np.full(len(covariance), 1e9),
    )
    chance = compute_coefficient_chance(terms, fit, list_ids(BASE))
    assert chance == pytest.approx(p_value, rel=1e-3)


def test_coefficients_of_an_effect_that_is_not_there_pass_in_one_of_twenty_though_blocks_are_few():
    """Eight blocks of correlated noise, and the four coefficients of cogging and its harmonic."""
    rng, n_passed = np.random.default_rng(0), 0
    terms, clusters = [*BASE, effect("cogging")(), effect("cogging")()], np.repeat(np.arange(8), 25)
    for _ in range(300):
        q = 0.1 * np.cumsum(rng.normal(size=200))
        own = [law(3 * k * q) for k in (1, 2) for law in (np.cos, np.sin)]
        phi = np.column_stack([rng.normal(size=(200, 2)), np.sin(q), np.ones(200), *own])
        noise = scipy.signal.lfilter([1], [1, -0.8], rng.normal(size=200))
        fit = solve(Equations(phi, noise), np.ones(200), clusters)
        n_passed += compute_coefficient_chance(terms, fit, list_ids(BASE)) <= 0.05
    assert n_passed / 300 < 0.08


LEAST = Criterion().kept_inertia


@pytest.mark.parametrize(
    ("inertia", "gravity", "passed"),
    [
        (0.06, 1.5, {"kept_inertia": True, "kept_gravity": True}),
        (0.04, 2.0, {"kept_inertia": False, "kept_gravity": True}),  # a lag imitates the inertia
        (0.1, -2.0, {"kept_inertia": True, "kept_gravity": False}),  # a spring and negative gravity
        (0.1, -0.02, {"kept_inertia": True, "kept_gravity": True}),  # zero within 3 standard errors
    ],
)
def test_a_larger_model_keeps_half_of_the_inertia_and_the_sign_of_gravity(inertia, gravity, passed):
    before = Model.build(BASE, [0.1, 2.0, 0.1, 0.1], [0.001, 0.01, 0.01, 0.01])
    after = Model.build([*BASE, ActuatorLag(0.01)], [inertia, gravity, 0.1, 0.1], [0.02, 0.01, 0.01, 0.01])
    gates = compare_base(after, before, {"": X}, LEAST)
    assert {gate.name: gate.passed for gate in gates} == passed
    assert [gate.value for gate in gates] == pytest.approx([inertia / 0.1, gravity / 2.0])


@pytest.mark.parametrize(("std", "passed"), [(1.0, True), (3.0, False)])
def test_effects_of_the_angle_that_leave_gravity_undetermined_draw_a_curve_of_their_own(std, passed):
    before = Model.build(BASE, [0.1, 2.0, 0.1, 0.1], 0.01)
    terms = [*BASE, effect("gravity_tilt")()]
    for gravity in (2.0, -20.0):
        after = Model.build(terms, [0.1, gravity, 0.1, 0.1, 0.5], [0.001, std, 0.01, 0.01, std])
        assert [gate.passed for gate in compare_base(after, before, {"": X}, LEAST)] == [True, passed]


def test_inertia_has_to_keep_half_of_what_the_smaller_model_shows_beyond_three_standard_errors():
    after = Model.build([*BASE, ActuatorLag(0.01)], [0.03, 2.0, 0.1, 0.1], [0.001, 0.01, 0.01, 0.01])
    for std, limit, passed in ((0.001, 0.485, False), (0.02, 0.2, True)):
        before = Model.build(BASE, [0.1, 2.0, 0.1, 0.1], [std, 3.0, 0.01, 0.01])
        (gate,) = compare_base(after, before, {"": X}, LEAST)
        assert gate.limit == pytest.approx(limit) and gate.passed is passed


def test_a_known_inertia_has_to_be_kept():
    """A payload of minus the inertia leaves an equation without any torque, which each motion meets."""
    before = Model.build(BASE, [1.0, 11.0, 0.1, 0.1], [0.0, 0.01, 0.01, 0.01])
    for payload, passed in ((-0.9, False), (-0.3, True)):
        after = Model.build([*BASE, PayloadChange(0.0)], [1.0, 11.0, 0.1, 0.1, payload, 0.0], [0.0, *[0.01] * 5])
        inertia, _ = compare_base(after, before, {"": X}, LEAST)
        assert inertia.passed is passed


def test_inertia_of_a_payload_that_comes_later_counts_as_kept():
    """The smaller model has the mean of the inertia before and after."""
    x = replace(X, time=np.linspace(0.0, 1.0, 3))
    half = PayloadChange(0.5)
    before = Model.build(BASE, [0.1, 2.0, 0.1, 0.1], 0.001)
    after = Model.build([*BASE, half], [0.01, 2.0, 0.1, 0.1, 0.135, 0.0], 0.001)
    gates = compare_base(after, before, {"": x}, LEAST)
    assert gates[0].value == pytest.approx(1.0) and gates[0].passed


def test_a_base_parameter_that_the_smaller_model_does_not_determine_has_no_gate():
    before = Model.build(BASE, [0.1, 2.0, 0.1, 0.1], [0.2, 3.0, 0.01, 0.01])
    after = Model.build([*BASE, ActuatorLag(0.01)], [0.001, -2.0, 0.1, 0.1], [0.001, 0.01, 0.01, 0.01])
    assert compare_base(after, before, {"": X}, LEAST) == []


@dataclass(frozen=True)
class GasSpring(Term):
    """A user's spring, whose torque must not fall with the angle."""

    id, law, kind, is_restoring = "gas_spring", "k tanh q", "potential", True

    columns = (
        Column(
            "gas_spring", "N m", force=lambda x: np.tanh(x.position), potential=lambda x: np.log(np.cosh(x.position))
        ),
    )


def test_a_users_spring_pushes_towards_its_rest_as_that_of_the_library():
    assert find_violations(Model.build([*BASE, GasSpring()], [0.1, 2.0, 0.1, 0.1, 0.3], 0.01), {"": swinging()}) == []
    (pushing,) = find_violations(Model.build([*BASE, GasSpring()], [0.1, 2.0, 0.1, 0.1, -0.3], 0.01), {"": swinging()})
    assert pushing.name == "gas_spring" and pushing.value == pytest.approx(-0.3, abs=0.01)


@dataclass(frozen=True)
class EndPad(GasSpring):
    """A user's stop, which begins at an angle."""

    lower: float = -np.inf
    upper: float = np.inf

    id, is_restoring, has_impacts = "end_pad", False, True

    @property
    def ends(self) -> tuple[float, float]:
        return self.lower, self.upper


def test_a_users_stop_is_too_soft_as_that_of_the_library():
    theta = [0.1, 2.0, 0.1, 0.1, 0.3]
    assert find_violations(Model.build([*BASE, EndPad(upper=1.4)], theta), {"": swinging()}) == []
    (soft,) = find_violations(Model.build([*BASE, EndPad(upper=-0.5)], theta), {"": swinging()})
    assert soft.name == "soft_stop" and (soft.value, soft.limit) == pytest.approx((2.0, 1.0), abs=0.01)
    assert EndPad(upper=1.4).open_ends == (True, False) and GasSpring().open_ends == (False, False)


@pytest.mark.parametrize(("changes", "keeps_sign"), [({}, False), ({"is_weight": True}, True)])
def test_beside_another_weight_gravity_may_have_any_sign(changes, keeps_sign):
    other = derive_kind(GasSpring, lambda kind: kind, **changes)()
    before, after = (
        Model.build(BASE, [0.1, 2.0, 0.1, 0.1], 0.01),
        Model.build([*BASE, other], [0.1, -2.0, 0.1, 0.1, 4.0], 0.01),
    )
    (gravity,) = (gate for gate in compare_base(after, before, {"": X}, 0.5) if gate.name == "kept_gravity")
    assert gravity.passed == keeps_sign
