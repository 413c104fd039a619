"""Estimation sample by sample: equal to estimation from the whole recording, sure of itself as far as it may be."""

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.online import Diagnoser, Estimates, OnlineEstimator, stream_recording
from estimators.online.recursion import RECURSIONS, SquareRootLeastSquares
from estimators.regression.recursive import PRIOR, compute_history
from estimators.schemes import six
from estimators.schemes.six import PAPER, SCHEMES, Integral, LowPass
from estimators.signals.measurements import add_states, choose_smoothing, measure, measure_segments
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.physics import BASE, effect
from tests import slow
from tests.cases import TRUTH
from tests.feeding import feed
from tests.terms import Clipped, Table

MORE = (
    *SCHEMES,
    six.scheme("energy", operator=Integral(None)),
    six.scheme("filtered_dynamic", operator=LowPass(order=2)),
    six.scheme("filtered_dynamic", operator=LowPass(cutoff=60.0), guard=0.05),
    six.scheme("dynamic", guard=None),
)


@pytest.mark.parametrize(
    "more",
    slow.but_first(
        [
            [effect("torque_saturation")(limit=6.0), effect("stribeck")(0.6), effect("cogging")(order=7.0)],
            [effect("payload_change")(moment=4.0), effect("load_dependent_friction")()],
        ]
    ),
    ids=["saturation", "payload"],
)
def test_online_equals_offline(more, paper_run):
    """To 1e-9: theta and P of the recursion, for every scheme, at several moments."""
    terms, smoothing = (*BASE, *more), choose_smoothing(paper_run)
    online = OnlineEstimator(paper_run.rate, terms, MORE, smoothing=smoothing)
    estimates = list(stream_recording(online, paper_run))
    (whole,) = measure_segments(paper_run)
    points = np.array([1500, 4000, 9000])
    for s, scheme in enumerate(MORE):
        equations, usable = scheme.regression(whole, terms)
        course = compute_history(equations, usable, points)
        for k, point in enumerate(points):
            now = estimates[point + smoothing.reach + online.delay]
            assert now.index[0] == point
            np.testing.assert_allclose(now.theta[0, s], course.theta[k], rtol=1e-9, atol=1e-12)
            covariance = course.root[k] @ course.root[k].T
            scale = np.sqrt(np.outer(*2 * [np.diag(covariance)]))
            np.testing.assert_allclose(now.P[0, s] / scale, covariance / scale, atol=1e-9)


def test_a_recording_of_another_rate_number_or_length_is_refused(paper_run):
    with pytest.raises(ValueError, match="1000 Hz, not 500 Hz: pass rate=1000"):
        stream_recording(OnlineEstimator(500.0), paper_run)
    with pytest.raises(ValueError, match="1 recordings for 2 pendulums"):
        stream_recording(OnlineEstimator(1000.0, batch=2), paper_run)
    with pytest.raises(ValueError, match="10000 and 5000 rows"):
        stream_recording(Diagnoser(1000.0, batch=2), [paper_run, paper_run.slice(0, 5000)])


@pytest.mark.parametrize(
    ("options", "close"),
    [
        ({}, 1e-8),
        ({"forgetting": 0.998, "prior": 1e9}, 1e-5),  # where ours is still far from returning to P(0)
    ],
    ids=["all", "forgetting"],
)
def test_filterpys_kalman_filter_finds_the_same_theta_and_covariances(options, close):
    (run,) = simulate([(Plant(), Experiment(rate=500.0, seconds=2.5, seed=1))])
    both = [feed(OnlineEstimator(500.0, counts=COUNTS, recursion=name, **options), run) for name in RECURSIONS]
    for k in (700, 1249):
        ours, theirs = (estimates[k] for estimates in both)
        np.testing.assert_allclose(theirs.theta, ours.theta, rtol=close)
        np.testing.assert_allclose(theirs.error, ours.error, rtol=100 * close, atol=close)
        for mine, other in ((ours.P, theirs.P), (ours.covariance, theirs.covariance)):
            scale = np.sqrt(np.einsum("bsii->bsi", mine))
            scale = scale[..., None] * scale[..., None, :]
            np.testing.assert_allclose(other / scale, mine / scale, atol=close)


@pytest.mark.parametrize("id", slow.but_first(["actuator_lag", "presliding", "dead_time", "joint_flexibility"]))
def test_terms_with_memory_are_estimated_with_the_others(id, paper_run):
    """The base parameters, as offline to what happens within a sample."""
    terms = (*BASE, effect(id)())
    smoothing = choose_smoothing(paper_run)
    now = feed(OnlineEstimator(paper_run.rate, terms, SCHEMES, smoothing=smoothing), paper_run)[-1]
    assert np.isfinite(now.theta).all()
    for s, scheme in enumerate(SCHEMES):
        equations, usable = scheme.regression(add_states(measure(paper_run, smoothing), terms), terms)
        course = compute_history(equations, usable, np.array([len(equations.y) - 1]))
        np.testing.assert_allclose(now.theta[0, s, :4], course.theta[0, :4], rtol=5e-3)


def test_a_law_that_is_no_formula_is_estimated_as_the_formula_it_holds(paper_run):
    recording = paper_run.slice(0, 4000)
    tables, formulas = (
        feed(OnlineEstimator(recording.rate, (*BASE, kind()), MORE), recording)[-1] for kind in (Table, Clipped)
    )
    assert np.abs(tables.theta[0, :, 4]).max() > 1e-3
    np.testing.assert_allclose(tables.theta, formulas.theta, rtol=1e-9, atol=1e-12)


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


@pytest.mark.parametrize(
    ("terms", "options", "samples", "close"),
    [
        (BASE, {}, 2000, 1e-9),
        ((*BASE, effect("presliding")(), Table()), {}, 2000, 1e-9),
        (BASE, {"recursion": "KalmanFilter"}, 600, 1e-5),
    ],
    ids=["base", "table", "kalman"],
)
def test_many_are_estimated_as_one_a_reset_forgets_one_of_them_and_a_copy_goes_on_alike(
    terms, options, samples, close, paper_run
):
    def estimator(batch: int = 1) -> OnlineEstimator:
        return OnlineEstimator(paper_run.rate, terms, MORE, batch=batch, counts=COUNTS, **options)

    both, last = estimator(2), 2 * samples
    early = feed(both, [paper_run] * 2, 0, samples)[-1]
    theta, spread = early.theta.copy(), early.state.compute_P().copy()
    both.reset(np.array([False, True]))
    copy = pickle.loads(pickle.dumps(both))
    after = feed(both, [paper_run] * 2, samples, last)[-1]
    steady, fresh = feed(estimator(), paper_run, 0, last)[-1], feed(estimator(), paper_run, samples, last)[-1]
    for b, alone in enumerate((steady, fresh)):
        np.testing.assert_allclose(after.theta[b], alone.theta[0], rtol=close)
        scale = np.sqrt(np.einsum("sii->si", alone.P[0]))
        scale = scale[..., None] * scale[:, None]
        np.testing.assert_allclose(after.P[b] / scale, alone.P[0] / scale, atol=close)
    np.testing.assert_allclose(after.covariance[0], steady.covariance[0], rtol=1e3 * close)
    np.testing.assert_array_equal(feed(copy, [paper_run] * 2, samples, last)[-1].theta, after.theta)
    np.testing.assert_array_equal(early.theta, theta)  # as it was handed out
    np.testing.assert_array_equal(early.state.compute_P(), spread)


def test_nothing_is_told_across_a_gap_or_a_lost_sample(paper_run):
    whole = feed(OnlineEstimator(paper_run.rate), paper_run)[-1]
    before, after = paper_run.slice(0, 5000), paper_run.slice(5400, 10_000)
    gapped = OnlineEstimator(paper_run.rate)
    feed(gapped, before)
    lost = pickle.loads(pickle.dumps(gapped))
    now = feed(gapped, after)[-1]
    np.testing.assert_allclose(now.theta, whole.theta, rtol=5e-3)
    assert now.time[0] == pytest.approx(after.time[-1] - gapped.delay / paper_run.rate)
    lost.take(np.full(1, 5.2), np.full(1, np.nan), np.zeros(1))
    np.testing.assert_allclose(now.theta, feed(lost, after)[-1].theta, rtol=1e-12)


@cache
def stick_and_slip(runs: int, seconds: float, change: float | None = None) -> list:
    """Many runs of an independent simulator."""
    heavier = {} if change is None else {"payload_change": {"pay_I": 0.03, "pay_mgl": 0.6, "pay_t": change}}
    experiment = Experiment(rate=500.0, seconds=seconds, torque_noise=0.05)
    return simulate([(Plant(effects=heavier), replace(experiment, seed=seed)) for seed in range(runs)])


def coverage(now: Estimates) -> np.ndarray:
    """Share of runs whose 95 % interval holds the truth (S, P)."""
    std = np.sqrt(np.einsum("bsii->bsi", now.covariance))
    return (np.abs(now.theta - TRUTH) < 1.96 * std).mean(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("forgetting", [1.0, 0.998])
def test_intervals_hold_the_truth_as_often_as_they_say(forgetting):
    """200 seeded runs: 90 to 99 %, for every scheme on average over its parameters; also after many memories."""
    estimates = feed(OnlineEstimator(500.0, batch=200, forgetting=forgetting), stick_and_slip(200, 20.0))
    for now in (estimates[4000], estimates[-1]):
        share = coverage(now)
        assert (share > 0.86).all(), share
        assert ((share.mean(axis=1) > 0.90) & (share.mean(axis=1) < 0.99)).all(), share


@pytest.mark.slow
def test_what_cannot_be_told_is_not_said_to_be_known():
    """Turning one way only, dry friction and an offset of the torque are the same, and no stop is reached."""
    terms = (*BASE, effect("torque_offset")(), effect("hard_stop")(upper=1e3))
    command = np.repeat(np.random.default_rng(0).uniform(3.0, 6.0, 100), 100)
    (one_way,) = simulate([(Plant(), Experiment(rate=1000.0, seconds=10.0, torque_noise=0.05, seed=0))], [command])
    assert (np.diff(one_way.position[200:]) > 0).all()
    now = feed(OnlineEstimator(1000.0, terms), one_way)[-1]
    std = np.sqrt(np.einsum("bsii->bsi", now.covariance))[0]
    truth = np.r_[TRUTH, 0.0, 0.0]
    assert np.isfinite(std).all()
    assert (std[:, [3, 4, 5]] > 1.0).all(), std
    assert (std[:, :2] < 0.1 * truth[:2]).all()
    assert (np.abs(now.theta[0] - truth) < 4 * std).all()


@pytest.mark.parametrize("recursion", slow.but_first(list(RECURSIONS)))
def test_torque_that_follows_the_direction_of_motion_determines_nothing(recursion):
    """Zeros, and dry friction of the size of the torque, solve all equations until the torque has a second size."""
    command = np.r_[np.full(1000, 4.0), 4.0 + 2.0 * np.sin(np.arange(1000) / 50.0)]
    (run,) = simulate([(Plant(), Experiment(rate=500.0, seconds=4.0, torque_noise=0.02, seed=0))], [command])
    estimates = feed(OnlineEstimator(500.0, recursion=recursion), run)
    assert np.isinf(estimates[990].std).all() and not estimates[990].is_known.any()
    assert np.isfinite(estimates[-1].std).all()
    assert (np.abs(estimates[-1].theta[0] - TRUTH) < 4 * estimates[-1].std[0]).all()


@pytest.mark.parametrize("memory", slow.but_first([{"forgetting": 0.997}, {}]), ids=str)
def test_a_payload_picked_up_in_mid_run_is_tracked_by_who_forgets(memory):
    theta = feed(OnlineEstimator(500.0, batch=20, **memory), stick_and_slip(20, 14.0, change=7.0))[-1].theta
    after = TRUTH + np.array([0.03, 0.6, 0.0, 0.0])
    error = np.median(np.abs(theta / after - 1), axis=0)[:, :2]
    assert (error < 0.03).all() if memory else (error > 0.05).all()


def test_stick_teaches_nothing(sticky):
    estimates = feed(OnlineEstimator(sticky.rate, schemes=SCHEMES[:1]), sticky)
    used = np.array([now.usable[0, 0] for now in estimates])
    silent = np.array([(now.error[0, 0] == 0) and not now.regressor.any() for now in estimates])
    assert 0.05 < used.mean() < 0.8
    assert silent[~used].all()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"schemes": PAPER}, "hamiltonian borrows its inertia"),
        ({"rate": 50.0}, r"schemes=\['dynamic', 'energy', 'hamiltonian'\]"),
        ({"forgetting": 1.1}, "forgetting is 1.1"),
        ({"prior": 0.0}, "give a positive number"),
        ({"terms": ()}, "nothing to estimate"),
    ],
)
def test_bad_options_are_refused(arguments, text):
    with pytest.raises(ValueError, match=text):
        OnlineEstimator(**{"rate": 1000.0, **arguments})
