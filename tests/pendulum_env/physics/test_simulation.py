"""Simulation with set-valued friction: against an independent integrator, closed forms and the balance of energy."""

from dataclasses import dataclass

import numpy as np
import pytest

from pendulum_env.physics import BASE, Coulomb, Inertia, Samples, Term, effect, effects, simulate
from pendulum_env.physics.term import return_zero
from pendulum_env.plant import hide, paper_plant
from tests.runge_kutta import Law, simulate_stick_slip

THETA = (0.09, 2.0, 0.35, 0.8)  # inertia, gravity, viscous, coulomb
INERTIA, MGL, B, FC = THETA

every_effect = pytest.mark.parametrize("id", effects())


def two_tones(seconds: float, period: float, scale: float = 1.0) -> np.ndarray:
    """The paper's torque, strong enough for several full turns in both directions [N m]."""
    time = period * np.arange(round(seconds / period))
    return scale * (3 * np.sin(12.07 * time) + 3 * np.sin(2.25 * time + 1))


@dataclass(frozen=True)
class Case:
    """Terms with parameters, and their laws once more: torque against the motion, and magnitude of dry friction."""

    terms: tuple[Term, ...]
    theta: tuple[float, ...]
    load: Law
    dry: Law = lambda t, q, v, u: FC
    torque: Law = lambda t, q, v, u: u


def pushed_back(depth: float, speed: float) -> float:
    """Push of a bumper with a stiffness of one and 0.1 s/rad of hysteresis against motion inwards."""
    return max(depth * (1 + 0.1 * speed), 0.0) if depth > 0 else 0.0


def base_load(t: float, q: float, v: float, u: float) -> float:
    return MGL * np.sin(q) + B * v


def case(id: str | None, theta: tuple[float, ...], load: Law = base_load, shapes: tuple = (), **laws: Law) -> Case:
    return Case((*BASE, *([effect(id)(*shapes)] if id else [])), (*THETA, *theta), load, **laws)


CASES = {
    "base": case(None, ()),
    "stribeck": case("stribeck", (0.45,), shapes=(0.6,), dry=lambda t, q, v, u: FC + 0.45 * np.exp(-((v / 0.6) ** 2))),
    "load_dependent_friction": case(
        "load_dependent_friction",
        (0.1, 0.05),
        shapes=(2.0, 0.3),
        dry=lambda t, q, v, u: FC + 0.1 * abs(u - 0.3 * v) + 0.05 * abs(2.0 * np.sin(q)),
    ),
    "position_dependent_friction": case(
        "position_dependent_friction", (0.3, -0.2), dry=lambda t, q, v, u: FC + 0.3 * np.sin(q) - 0.2 * np.cos(q)
    ),
    "cogging": case(
        "cogging",
        (0.15, -0.1),
        lambda t, q, v, u: base_load(t, q, v, u) + 0.15 * np.sin(9 * q) - 0.1 * np.cos(9 * q),
        (9.0,),
    ),
    "spring": case("spring", (0.5, -0.2), lambda t, q, v, u: base_load(t, q, v, u) + 0.5 * q - 0.2),
    "hard_stop": case(
        "hard_stop",
        (40.0,),
        lambda t, q, v, u: base_load(t, q, v, u) + 40 * pushed_back(q - 0.3, v) - 40 * pushed_back(-0.2 - q, -v),
        (-0.2, 0.3, 0.1),
    ),
    "torque_saturation": case("torque_saturation", (), shapes=(5.0,), torque=lambda t, q, v, u: 5 * np.tanh(u / 5)),
    "coulomb_asymmetry": case("coulomb_asymmetry", (0.2,), lambda t, q, v, u: base_load(t, q, v, u) + 0.2),
    "friction_drift": case(
        "friction_drift",
        (0.15, 0.4),
        lambda t, q, v, u: base_load(t, q, v, u) + 0.15 * v * np.exp(-t),
        (1.0,),
        dry=lambda t, q, v, u: FC + 0.4 * np.exp(-t),
    ),
}


def reference(case: Case, torque: np.ndarray, period: float, start: tuple[float, float]):
    """Position, velocity (N + 1,) and whether each period ends in stick."""

    def net(t: float, q: float, v: float, u: float) -> float:
        return case.torque(t, q, v, u) - case.load(t, q, v, u)

    return simulate_stick_slip(net, case.dry, INERTIA, torque.tolist(), period, start)


def weak(period: float, count: int) -> np.ndarray:
    """Torque under which the joint sticks at every other reversal [N m]."""
    time = period * np.arange(count)
    return 1.9 * np.sin(3 * time) + 1.2 * np.sin(7.3 * time + 1)


@pytest.mark.parametrize("sticks", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_motion_is_that_of_an_integrator_of_high_order_that_goes_from_event_to_event(name, sticks):
    case, period = CASES[name], 0.01
    torque, start = (weak(period, 150), (0.1, 0.0)) if sticks else (np.full(40, 5.0), (-1.0, 8.0))
    position, velocity, stuck = reference(case, torque, period, start)
    step = 5e-4 if sticks else 2.5e-4
    found = simulate(case.terms, np.array(case.theta), period, torque, *start, longest_step=step)
    assert 0.05 < np.mean(stuck) < 0.8 and np.ptp(position) > 0.5 if sticks else not stuck.any()
    np.testing.assert_allclose(found.position[:, 0], position, atol=5e-6)
    np.testing.assert_allclose(found.velocity[:, 0], velocity, atol=1e-4)
    assert np.all(found.velocity[stuck, 0] == 0)


@pytest.mark.parametrize("sticks", [False, True])
@pytest.mark.parametrize("name", ["base", "stribeck", "cogging", "spring", "torque_saturation"])
def test_the_error_is_of_second_order_in_the_step(name, sticks):
    case, period = CASES[name], 0.016
    torque, start = (weak(period, 60), (0.1, 0.0)) if sticks else (np.full(25, 5.0), (-1.0, 8.0))
    position, _, stuck = reference(case, torque, period, start)
    assert np.any(stuck) == sticks
    steps = period / 2.0 ** np.arange(1, 5)
    paths = [simulate(case.terms, np.array(case.theta), period, torque, *start, longest_step=h)[0] for h in steps]
    errors = [np.sqrt(np.mean((path[:, 0] - position) ** 2)) for path in paths]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 1.8 < order < 2.6


def has_energy(id: str) -> bool:
    """Whether a term's energy is a matter of the columns alone: no memory, no delay, a constant inertia."""
    term = effect(id)()
    return type(term).advance is Term.advance and not term.delay and all(c.mass is return_zero for c in term.columns)


@pytest.mark.parametrize("id", ["base", *filter(has_energy, effects())])
def test_work_of_the_torque_is_stored_or_dissipated_by_the_energy_forms_of_the_columns(id):
    model = paper_plant() if id == "base" else hide(paper_plant(), id)
    period = 1e-3
    torque = two_tones(2.0, period)
    path = simulate(model.terms, model.theta, period, torque, 0.3, 0.0)
    q, v = path.position[:, 0], path.velocity[:, 0]
    time = period * np.arange(len(q))
    work = np.sum(torque * np.diff(q))
    stored = dissipated = 0.0
    columns = list(zip(model.columns, model.theta, strict=True))
    columns += [(column, 1.0) for term in model.terms for column in term.fixed]
    # the command is held, so that power is taken at both ends of each period with the torque in it
    before, after = (Samples(time[k], q[k], v[k], torque) for k in (slice(None, -1), slice(1, None)))
    for column, coefficient in columns:
        energy = 0.5 * column.mass(after) * v[1:] ** 2 - 0.5 * column.mass(before) * v[:-1] ** 2
        if column.potential:
            energy = energy + column.potential(after) - column.potential(before)
        power = 0.5 * (column.power(before) + column.power(after))
        stored += coefficient * np.sum(energy)
        dissipated += coefficient * np.sum(power) * period
    assert dissipated > 1
    assert stored + dissipated == pytest.approx(work, rel=2e-4)


@pytest.mark.parametrize("push", [-0.799999, 0.0, 0.3, 0.799999])
def test_a_joint_at_rest_stays_exactly_where_it_is_while_friction_can_hold_it(push):
    q = 0.7
    path = simulate(BASE, np.array(THETA), 1e-3, np.full(2000, push + MGL * np.sin(q)), q, 0.0)
    assert np.all(path.position == q)
    assert np.all(path.velocity == 0)


@every_effect
def test_a_batch_of_pendulums_and_parameters_is_each_one_by_one(id):
    model = hide(paper_plant(), id)
    rng = np.random.default_rng(0)
    theta = model.theta[:, None] * rng.uniform(0.8, 1.25, (len(model.theta), 3))
    torque = two_tones(0.3, 2e-3)[:, None] + rng.uniform(-1, 1, 3)
    q, v, start = rng.uniform(-2, 2, 3), rng.uniform(-3, 3, 3), rng.uniform(0, 20, 3)
    together = simulate(model.terms, theta, 2e-3, torque, q, v, start)
    for j in range(3):
        alone = simulate(model.terms, theta[:, j], 2e-3, torque[:, j], q[j], v[j], start[j])
        np.testing.assert_allclose([part[:, j] for part in together], [part[:, 0] for part in alone], 1e-10, 1e-10)


@every_effect
def test_no_parameters_however_wild_make_a_simulation_return_nan(id):
    model = hide(paper_plant(), id)
    rng = np.random.default_rng(2)
    wild = model.theta[:, None] * 10 ** rng.uniform(-3, 3, (len(model.theta), 60)) * rng.choice([-1, 1], 60)
    wild[:, :20] = rng.standard_normal((len(wild), 20)) * 1e3
    path = simulate(model.terms, wild, 5e-3, two_tones(0.5, 5e-3), 0.3, 2.0, 9.0)
    assert np.isfinite(path.position).all()
    assert np.isfinite(path.velocity).all()


@pytest.mark.parametrize("samples", [1, 7, 50])
def test_dead_time_shifts_the_response_exactly(samples):
    torque, late = two_tones(2.0, 2e-3), effect("dead_time")(dead_time=2e-3 * samples)
    prompt, delayed = (simulate(terms, np.array(THETA), 2e-3, torque, 0.0, 0.0)[0] for terms in (BASE, (*BASE, late)))
    np.testing.assert_allclose(delayed[samples:], prompt[:-samples], atol=1e-11)
    np.testing.assert_array_equal(delayed[: samples + 1], 0.0)


@pytest.mark.parametrize("dead_time", [0.004, 0.0071])
def test_commands_before_the_first_still_arrive_after_it(dead_time):
    torque, terms = two_tones(1.0, 1e-3), (*BASE, effect("dead_time")(dead_time=dead_time))
    whole = simulate(terms, np.array(THETA), 1e-3, torque, 0.0, 0.0)
    q, v = (part[400] for part in whole)
    rest = simulate(terms, np.array(THETA), 1e-3, torque[400:], q, v, before=torque[380:400])
    np.testing.assert_allclose(rest.position, whole.position[400:], atol=1e-11)


@pytest.mark.parametrize("before", [0.0, 2.0])
def test_actuator_lag_answers_a_step_on_a_free_inertia_as_the_closed_form_says(before):
    lag, step, time = 0.03, 2.0, 1e-3 * np.arange(301)
    terms = (Inertia(), effect("actuator_lag")(time_constant=lag))
    memory = None if before == step else {"actuator_lag": (np.zeros(1),)}  # else what has acted for long
    path = simulate(terms, np.array([INERTIA]), 1e-3, np.full(300, step), 0.0, 0.0, memory=memory)
    fade, share = 1 - np.exp(-time / lag), 1 - before / step
    velocity = step / INERTIA * (time - share * lag * fade)
    position = step / INERTIA * (0.5 * time**2 - share * (lag * time - lag**2 * fade))
    np.testing.assert_allclose(path.velocity[:, 0], velocity, atol=2e-4 * velocity.max())
    np.testing.assert_allclose(path.position[:, 0], position, atol=2e-4 * position.max())


def test_presliding_friction_is_a_spring_of_stiffness_f_over_d_for_small_displacements():
    displacement, push = 0.02, 0.002
    terms = (Inertia(), Coulomb(), effect("presliding")(displacement=displacement))
    path = simulate(terms, np.array([INERTIA, FC, FC]), 1e-3, np.full(3000, push), 0.0, 0.0)
    q = path.position[:, 0]
    stiffness = FC / displacement
    assert np.ptp(q[:400]) == pytest.approx(2 * push / stiffness, rel=0.01)  # swings to twice the rest
    crossings = np.flatnonzero((q[:-1] < push / stiffness) & (q[1:] >= push / stiffness))
    period = np.mean(np.diff(crossings)) * 1e-3
    assert period == pytest.approx(2 * np.pi * np.sqrt(INERTIA / stiffness), rel=0.01)


def test_joint_flexibility_swings_at_the_eigenfrequency_of_two_masses():
    link, resonance = 0.06, 40.0  # J, and sqrt(k / J)
    terms = (Inertia(), effect("joint_flexibility")(resonance=resonance, damping=0.01, gravity=0.1))
    start = {"joint_flexibility": (np.zeros(1), np.zeros(1))}
    path = simulate(terms, np.array([INERTIA, link]), 5e-4, np.zeros(2000), 0.0, 1.0, memory=start)
    v = path.velocity[:, 0] - path.velocity[:, 0].mean()
    crossings = np.flatnonzero((v[:-1] < 0) & (v[1:] >= 0))
    frequency = 2 * np.pi / (np.mean(np.diff(crossings)) * 5e-4)
    assert frequency == pytest.approx(resonance * np.sqrt(INERTIA / (INERTIA - link)), rel=0.01)


def test_impacts_of_a_play_are_simulated_to_second_order():
    play = effect("backlash")(gap=0.02, resonance=80.0, damping=15.0, gravity=35.0)
    starts = np.linspace(-1.0, 1.0, 60)

    def end(step: float) -> np.ndarray:
        torque = np.repeat(two_tones(0.3, 1e-3), round(1e-3 / step))
        return simulate((*BASE, play), np.array([*THETA, 0.06]), step, torque, starts, np.zeros(60)).position[-1]

    steps, exact = np.array([1e-3, 5e-4, 2.5e-4]), end(1.5625e-5)
    errors = [np.sqrt(np.mean((end(step) - exact) ** 2)) for step in steps]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 1.7


def test_a_stiff_transmission_is_rigid_and_presliding_friction_far_beyond_its_displacement_is_dry():
    stiff = effect("joint_flexibility")(resonance=800.0, damping=200.0, gravity=MGL / 0.06)
    for term, coefficient, torque, start in (
        (stiff, 0.06, two_tones(0.4, 1e-3), (0.0, 0.0)),
        (effect("presliding")(displacement=1e-3), FC, np.full(600, 5.0), (-1.0, 8.0)),
    ):
        theta = np.array([*THETA, coefficient])
        found = simulate((*BASE, term), theta, 1e-3, torque, *start, longest_step=1e-4).position
        np.testing.assert_allclose(found, simulate(BASE, theta[:4], 1e-3, torque, *start).position, atol=0.01)


def test_the_command_is_held_over_each_period():
    torque = np.random.default_rng(0).standard_normal(200)
    path = simulate((Inertia(),), np.array([INERTIA]), 0.01, torque, 0.0, 0.0)
    np.testing.assert_allclose(path.velocity[1:, 0], np.cumsum(torque) * 0.01 / INERTIA, rtol=1e-10, atol=1e-12)
    assert path.position.shape == (201, 1)
