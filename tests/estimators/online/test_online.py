"""Estimation sample by sample: equal to estimation from the whole recording, sure of itself as far as it may be."""

import pickle
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.online import Estimates, OnlineEstimator
from estimators.online.recursion import SquareRootLeastSquares
from estimators.regression.recursive import PRIOR, history
from estimators.schemes import six
from estimators.schemes.six import PAPER, SCHEMES, Integral, LowPass
from estimators.signals.measurements import Smoothing, choose_smoothing, measure, remember
from pendulum_env.physics import BASE, Column, Term, effect
from pendulum_env.recording import Recording
from tests import slow
from tests.terms import Clipped, Table

MORE = (
    *SCHEMES,
    six.scheme("energy", operator=Integral(None)),
    six.scheme("filtered_dynamic", operator=LowPass(order=2)),
    six.scheme("filtered_dynamic", operator=LowPass(cutoff=60.0), guard=0.05),
    six.scheme("dynamic", guard=None),
)


def run(estimator: OnlineEstimator, recording: Recording) -> list[Estimates]:
    """Estimates after every sample; the torque comes with the sample that ends its period."""
    held = np.r_[0.0, recording.torque[:-1]]
    return [
        estimator.take(np.full(1, t), np.full(1, q), np.full(1, u))
        for t, q, u in zip(recording.time, recording.position, held, strict=True)
    ]


@pytest.mark.parametrize(
    "terms",
    [
        BASE,
        pytest.param((*BASE, effect("stribeck")(0.6), effect("cogging")(order=7.0)), marks=pytest.mark.slow),
        pytest.param(
            (*BASE, effect("payload_change")(moment=4.0), effect("load_dependent_friction")()), marks=pytest.mark.slow
        ),
        (*BASE, effect("torque_saturation")(limit=6.0)),
    ],
    ids=lambda terms: terms[-1].id,
)
def test_online_equals_offline(terms, paper_run):
    """To 1e-9: theta and P of the recursion, for every scheme, at several moments."""
    recording = paper_run.recording
    smoothing = choose_smoothing(recording)
    online = OnlineEstimator(recording.rate, terms, MORE, smoothing=smoothing)
    estimates = run(online, recording)
    whole = measure(recording, smoothing)
    points = np.array([1500, 4000, 9000])
    for s, scheme in enumerate(MORE):
        equations, usable = scheme.regression(whole, terms)
        course = history(equations, usable, points)
        for k, point in enumerate(points):
            now = estimates[point + smoothing.reach + online.delay]
            assert now.index[0] == point
            np.testing.assert_allclose(now.theta[0, s], course.theta[k], rtol=1e-9, atol=1e-12)
            scale = np.sqrt(np.outer(*2 * [np.diag(course.P[k])]))
            np.testing.assert_allclose(now.P[0, s] / scale, course.P[k] / scale, atol=1e-9)


@pytest.mark.parametrize("id", slow.but_first(["actuator_lag", "presliding", "dead_time", "joint_flexibility"]))
def test_terms_with_memory_are_estimated_with_the_others(id, paper_run):
    """The base parameters, as offline to what happens within a sample."""
    terms = (*BASE, effect(id)())
    recording = paper_run.recording
    smoothing = choose_smoothing(recording)
    now = run(OnlineEstimator(recording.rate, terms, SCHEMES, smoothing=smoothing), recording)[-1]
    assert np.isfinite(now.theta).all()
    for s, scheme in enumerate(SCHEMES):
        equations, usable = scheme.regression(remember(measure(recording, smoothing), terms), terms)
        course = history(equations, usable, np.array([len(equations.y) - 1]))
        np.testing.assert_allclose(now.theta[0, s, :4], course.theta[0, :4], rtol=5e-3)


def test_a_law_that_is_no_formula_is_estimated_as_the_formula_it_holds(paper_run):
    recording = paper_run.recording.slice(0, 4000)
    tables, formulas = (
        run(OnlineEstimator(recording.rate, (*BASE, kind()), MORE), recording)[-1] for kind in (Table, Clipped)
    )
    assert np.abs(tables.theta[0, :, 4]).max() > 1e-3
    np.testing.assert_allclose(tables.theta, formulas.theta, rtol=1e-9, atol=1e-12)


@dataclass(frozen=True)
class Singular(Term):
    """Friction whose law has no value where nothing moves, nor at time zero."""

    id, law, kind = "singular", "k ln|q'| sgn q'", "dissipative"

    @property
    def columns(self):
        return (Column("singular", "N m", dry=lambda x: np.log(np.abs(x.velocity)) / np.sqrt(x.time)),)


def test_a_law_may_be_infinite_where_nothing_is_taken_from_it(paper_run):
    recording = paper_run.recording.slice(0, 4000)
    estimator = OnlineEstimator(recording.rate, (*BASE, Singular()))
    with np.errstate(all="ignore"):
        now = run(estimator, Recording("late", recording.time + 1.0, recording.position, recording.torque))[-1]
    guarded = [s for s, scheme in enumerate(SCHEMES) if scheme.guard is not None]
    assert now.usable[0].any()
    assert np.isfinite(now.theta[0, guarded]).all()
    assert np.isfinite(now.P[0, guarded]).all()


def test_time_goes_on_across_resets_of_the_filters(paper_run):
    recording = paper_run.recording.slice(0, 1500)
    time = recording.time + np.where(np.arange(1500) < 700, 0.0, 2.0)  # a gap
    estimator, told = OnlineEstimator(recording.rate), []
    for k in range(1500):
        position = np.nan if k == 300 else recording.position[k]
        told.append(estimator.take(time[k : k + 1], np.full(1, position), recording.torque[k : k + 1]).time[0])
    told = np.delete(told, 300)  # of a sample that is lost
    assert (np.diff(told) > 0).all()
    np.testing.assert_allclose(told[-1], time[-1] - estimator.delay / recording.rate, atol=1e-9)


def test_batch_is_many_alone(paper_run):
    recording = paper_run.recording
    half = Recording("late", recording.time, 0.5 * recording.position, recording.torque)
    both = OnlineEstimator(recording.rate, batch=2)
    held = np.r_[0.0, recording.torque[:-1]]
    for k in range(3000):
        now = both.take(
            np.full(2, recording.time[k]), np.array([recording.position[k], half.position[k]]), np.full(2, held[k])
        )
    for b, alone in enumerate((recording, half)):
        one = run(
            OnlineEstimator(recording.rate),
            Recording("", *(x[:3000] for x in (alone.time, alone.position, alone.torque))),
        )[-1]
        np.testing.assert_allclose(now.theta[b], one.theta[0], rtol=1e-9)
        np.testing.assert_allclose(now.covariance[b], one.covariance[0], rtol=1e-6)


@pytest.mark.parametrize("terms", [BASE, (*BASE, effect("presliding")())], ids=lambda terms: terms[-1].id)
def test_reset_forgets_one_pendulum_and_leaves_the_other(terms, paper_run):
    recording = paper_run.recording
    held = np.r_[0.0, recording.torque[:-1]]

    def feed(estimator: OnlineEstimator, ks: range, batch: int) -> Estimates:
        for k in ks:
            now = estimator.take(*(np.full(batch, x[k]) for x in (recording.time, recording.position, held)))
        return now

    both = OnlineEstimator(recording.rate, terms, MORE, batch=2)
    feed(both, range(2000), 2)
    both.reset(np.array([False, True]))
    after = feed(both, range(2000, 4000), 2)
    steady = feed(OnlineEstimator(recording.rate, terms, MORE), range(4000), 1)
    fresh = feed(OnlineEstimator(recording.rate, terms, MORE), range(2000, 4000), 1)
    np.testing.assert_allclose(after.theta[0], steady.theta[0], rtol=1e-9)
    np.testing.assert_allclose(after.theta[1], fresh.theta[0], rtol=1e-9)
    np.testing.assert_allclose(after.P[1], fresh.P[0], rtol=1e-9)


def test_estimates_that_were_handed_out_do_not_change(paper_run):
    estimator = OnlineEstimator(paper_run.recording.rate)
    early = run(estimator, paper_run.recording.slice(0, 6000))[5000]
    theta = early.theta.copy()
    estimator.reset()
    np.testing.assert_array_equal(early.theta, theta)
    assert (np.linalg.eigvalsh(early.covariance) > 0).all()


@pytest.mark.slow
def test_pickled_estimator_goes_on_as_before(paper_run):
    recording = paper_run.recording
    estimator = OnlineEstimator(recording.rate, (*BASE, effect("stribeck")(), Table()))
    held = np.r_[0.0, recording.torque[:-1]]
    for k in range(4000):
        estimator.take(*(np.full(1, x[k]) for x in (recording.time, recording.position, held)))
    copy = pickle.loads(pickle.dumps(estimator))
    for k in range(4000, 5000):
        a, b = (
            e.take(*(np.full(1, x[k]) for x in (recording.time, recording.position, held))) for e in (estimator, copy)
        )
    np.testing.assert_array_equal(a.theta, b.theta)


@settings(max_examples=30)
@given(st.integers(1, 5), st.integers(0, 2**32 - 1), st.sampled_from([1.0, 0.99]))
def test_recursion_equals_filterpy(parameters, seed, forgetting):
    """Once P is far below P(0), towards which ours fades."""
    rng = np.random.default_rng(seed)
    phi, truth = rng.normal(size=(60, parameters)), rng.normal(size=parameters)
    y = phi @ truth + 0.1 * rng.normal(size=60)
    ours = SquareRootLeastSquares((1, 1), parameters, 1e9, forgetting)
    kalman = KalmanFilter(dim_x=parameters, dim_z=1)
    kalman.Q, kalman.R = np.zeros((parameters,) * 2), np.eye(1)
    for k, (row, value) in enumerate(zip(phi, y, strict=True)):
        if k == 15:
            kalman.x, kalman.P = ours.theta[0, 0][:, None].copy(), ours.P[0, 0].copy()
        if k >= 15:
            kalman.P = kalman.P / forgetting
            kalman.update(value, H=row[None])
        ours.take(row[None, None], np.array([[value]]), np.ones((1, 1), dtype=bool))
    np.testing.assert_allclose(ours.theta[0, 0], kalman.x[:, 0], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(ours.P[0, 0], kalman.P, rtol=1e-8, atol=1e-12)


@settings(max_examples=50)
@given(st.lists(st.tuples(*3 * [st.floats(-1e6, 1e6)], st.booleans()), min_size=1, max_size=60))
def test_covariance_stays_positive_definite_whatever_comes(rows):
    ours = SquareRootLeastSquares((1, 1), 2, PRIOR, 0.9)
    for a, b, y, used in rows:
        ours.take(np.array([[[a, b]]]), np.array([[y]]), np.array([[used]]))
        assert np.isfinite(ours.theta).all() and np.isfinite(ours.P).all()
        assert (ours.P == ours.P.swapaxes(-1, -2)).all()
        assert (np.linalg.eigvalsh(ours.P) > -1e-9 * np.abs(ours.P).max()).all()


def test_what_is_not_excited_returns_to_the_prior_and_the_rest_still_follows():
    ours = SquareRootLeastSquares((1, 1), 2, PRIOR, 0.99)
    for k in range(4000):
        ours.take(np.array([[[1.0, 0.0]]]), np.array([[1.0 if k < 2000 else 2.0]]), np.ones((1, 1), dtype=bool))
    assert 0.9 * PRIOR < ours.P[0, 0, 1, 1] < 1.1 * PRIOR
    assert ours.theta[0, 0] == pytest.approx([2.0, 0.0], abs=1e-6)


@cache
def stick_and_slip(runs: int, seconds: float, change: float | None = None) -> tuple[np.ndarray, ...]:
    """Time, position and measured torque of many runs of an independent simulator, and their two truths."""
    heavier = {} if change is None else {"payload_change": {"pay_I": 0.03, "pay_mgl": 0.6, "pay_t": change}}
    cases = [
        (Plant(effects=heavier), Experiment(rate=500.0, seconds=seconds, seed=seed, torque_noise=0.05))
        for seed in range(runs)
    ]
    records = simulate(cases)
    position, torque = (np.array([getattr(r, name) for r in records]).T for name in ("position", "torque"))
    plant = Plant()
    before = np.array([plant.inertia, plant.gravity, plant.viscous, plant.coulomb])
    return records[0].time, position, np.vstack([np.zeros(runs), torque[:-1]]), before


def coverage(now: Estimates, truth: np.ndarray) -> np.ndarray:
    """Share of runs whose 95 % interval holds the truth (S, P)."""
    std = np.sqrt(np.einsum("bsii->bsi", now.covariance))
    return (np.abs(now.theta - truth) < 1.96 * std).mean(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("forgetting", [1.0, 0.998])
def test_intervals_hold_the_truth_as_often_as_they_say(forgetting):
    """200 seeded runs: 90 to 99 %, for every scheme on average over its parameters; also after many memories."""
    time, position, torque, truth = stick_and_slip(200, 20.0)
    online = OnlineEstimator(500.0, batch=200, forgetting=forgetting)
    for k in range(len(time)):
        now = online.take(np.full(200, time[k]), position[k], torque[k])
        if time[k] in (8.0, time[-1]):
            share = coverage(now, truth)
            assert (share > 0.86).all(), share
            assert ((share.mean(axis=1) > 0.90) & (share.mean(axis=1) < 0.99)).all(), share


@pytest.mark.slow
def test_parameters_that_may_wander_are_not_claimed_to_be_known_better():
    """They stand still here, so that the intervals hold more than they say; but errors come near them."""
    time, position, torque, truth = stick_and_slip(50, 10.0)
    online = OnlineEstimator(500.0, batch=50, random_walk=0.02)
    for k in range(len(time)):
        now = online.take(np.full(50, time[k]), position[k], torque[k])
    z = (now.theta - truth) / np.sqrt(np.einsum("bsii->bsi", now.covariance))
    assert (coverage(now, truth) > 0.9).all()
    assert (np.sqrt(np.mean(z**2, axis=0)) > 0.1).all()


@pytest.mark.slow
def test_what_cannot_be_told_is_not_said_to_be_known():
    """Turning one way only, dry friction and an offset of the torque are the same, and no stop is reached."""
    terms = (*BASE, effect("torque_offset")(), effect("hard_stop")(upper=1e3))
    rng = np.random.default_rng(0)
    time = np.arange(10_000) / 1000
    command = np.repeat(rng.uniform(3.0, 6.0, 100), 100)
    (run_one_way,) = simulate([(Plant(), Experiment(rate=1000.0, seconds=10.0, torque_noise=0.05, seed=0))], [command])
    assert (np.diff(run_one_way.position[200:]) > 0).all()
    now = run(OnlineEstimator(1000.0, terms), Recording("", time, run_one_way.position, run_one_way.torque))[-1]
    std = np.sqrt(np.einsum("bsii->bsi", now.covariance))[0]
    truth = np.array([0.09, 2.0, 0.35, 0.8, 0.0, 0.0])
    assert np.isfinite(std).all()
    assert (std[:, [3, 4, 5]] > 1.0).all(), std
    assert (std[:, :2] < 0.1 * truth[:2]).all()
    assert (np.abs(now.theta[0] - truth) < 4 * std).all()


@pytest.fixture(scope="module")
def whole(paper_run) -> list[Estimates]:
    """Estimates from all of the paper's run."""
    return run(OnlineEstimator(paper_run.recording.rate), paper_run.recording)


@pytest.mark.slow
def test_a_lost_sample_costs_some_equations_and_nothing_else(paper_run, whole):
    recording = paper_run.recording
    estimator, held = OnlineEstimator(recording.rate), np.r_[0.0, recording.torque[:-1]]
    position = recording.position.copy()
    position[4000:4003] = np.nan
    holed = [
        estimator.take(np.full(1, t), np.full(1, q), np.full(1, u))
        for t, q, u in zip(recording.time, position, held, strict=True)
    ]
    assert all(np.isfinite(now.theta).all() and np.isfinite(now.covariance).all() for now in holed)
    np.testing.assert_allclose(holed[-1].theta[:, :1], whole[-1].theta[:, :1], rtol=2e-3)
    lost = sum(now.usable[0, 0] for now in whole) - sum(now.usable[0, 0] for now in holed)
    assert 0 <= lost < 120


def test_nothing_is_told_across_a_gap(paper_run, whole):
    recording = paper_run.recording
    halves = recording.time < 5.0, recording.time > 5.4
    before, after = (
        Recording("", *(x[part] for x in (recording.time, recording.position, recording.torque))) for part in halves
    )
    gapped = OnlineEstimator(recording.rate)
    run(gapped, before)
    told = pickle.loads(pickle.dumps(gapped))
    now = run(gapped, after)[-1]
    np.testing.assert_allclose(now.theta, whole[-1].theta, rtol=5e-3)
    told.take(np.full(1, 5.2), np.full(1, np.nan), np.zeros(1))
    np.testing.assert_allclose(now.theta, run(told, after)[-1].theta, rtol=1e-12)


@cache
def after_a_payload_was_picked_up(**memory: float) -> Estimates:
    time, position, torque, _ = stick_and_slip(20, 14.0, change=7.0)
    online = OnlineEstimator(500.0, batch=20, **memory)
    for k in range(len(time)):
        now = online.take(np.full(20, time[k]), position[k], torque[k])
    return now


@pytest.mark.parametrize(
    "memory",
    slow.but_first([{"forgetting": 0.997}, {"random_walk": 0.1}]),
    ids=lambda memory: next(iter(memory)),
)
def test_a_payload_picked_up_in_mid_run_is_tracked(memory):
    now, stays = after_a_payload_was_picked_up(**memory), after_a_payload_was_picked_up()
    *_, before = stick_and_slip(20, 14.0, change=7.0)
    after = before + np.array([0.03, 0.6, 0.0, 0.0])
    for s in range(6):
        error = np.median(np.abs(now.theta[:, s, :2] - after[:2]) / after[:2], axis=0)
        assert (error < 0.03).all(), (s, error)
        assert (np.median(np.abs(stays.theta[:, s, :2] - after[:2]) / after[:2], axis=0) > 0.05).all()


def test_stick_teaches_nothing(sticky):
    recording = sticky.recording
    estimates = run(OnlineEstimator(recording.rate, schemes=SCHEMES[:1]), recording)
    used = np.array([now.usable[0, 0] for now in estimates])
    silent = np.array([(now.error[0, 0] == 0) and not now.regressor.any() for now in estimates])
    assert 0.05 < used.mean() < 0.8
    assert silent[~used].all()


def test_smoothing_for_an_encoder_is_longer_the_coarser_it_is():
    widths = [Smoothing.of_encoder(counts, 1000.0).half_width for counts in (0, 1_024_000, 65_536, 8192)]
    assert widths == sorted(widths) and widths[0] < widths[-1]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"schemes": PAPER}, "hamiltonian borrows its inertia"),
        ({"rate": 50.0}, "lower the cutoff or sample faster"),
        ({"forgetting": 1.1}, "forgetting factor cannot be 1.1"),
        ({"prior": 0.0}, "give a positive number"),
        ({"random_walk": -1.0}, "random_walk cannot be -1"),
        ({"terms": ()}, "nothing to estimate"),
    ],
)
def test_bad_options_are_refused(arguments, text):
    with pytest.raises(ValueError, match=text):
        OnlineEstimator(**{"rate": 1000.0, **arguments})
