"""Least squares, cross-validation, standard errors, searches over nonlinear parameters: against first principles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from estimators.regression.balance import Balance
from estimators.regression.fold_fits import solve_without
from estimators.regression.least_squares import (
    Equations,
    Fit,
    compute_jackknife,
    solve,
    solve_gram,
    solve_least_squares,
    weigh_recordings,
)
from estimators.search_hints import make_grid
from estimators.weak_form.nonlinear import list_continuous_parameters, refine_nonlinear, search_by_cross_entropy
from pendulum_env.physics import Samples, Term, effect


def regression(seed: int, rows: int = 300, columns: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns of very different size, y, and the truth behind it."""
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((rows, columns)) * 10.0 ** np.arange(-2, columns - 2)
    theta = rng.standard_normal(columns)
    return phi, phi @ theta + 0.3 * rng.standard_normal(rows), theta


def fitted(phi: np.ndarray, y: np.ndarray, weights: object = 1.0, each: int = 10) -> Fit:
    """The solution, with errors by clusters of so many rows."""
    return solve(Equations(phi, y), weights * np.ones(len(y)), np.arange(len(y)) // each)


def test_solve_minimises_the_weighted_squares():
    phi, y, _ = regression(0)
    weights = np.random.default_rng(1).uniform(0.2, 2, len(y))
    fit = fitted(phi, y, weights)
    expected = np.linalg.solve(phi.T @ (phi * weights[:, None] ** 2), phi.T @ (y * weights**2))
    np.testing.assert_allclose(fit.theta, expected, rtol=1e-9)
    np.testing.assert_allclose(fit.residual, y - phi @ expected, atol=1e-9)
    assert fit.rms == pytest.approx(np.sqrt(np.mean(fit.residual**2)))


@pytest.mark.parametrize("column", range(4))
def test_normal_equations_are_solved_as_by_scipy_where_one_parameter_is_at_a_bound(column):
    phi, y, theta = regression(column)
    rows = np.column_stack([y, phi])
    for side in (-1, 1):
        least, most = np.full(4, -np.inf), np.full(4, np.inf)
        (least if side < 0 else most)[column] = theta[column] - 0.3 * side
        found = solve_gram(rows.T @ rows, least, most)
        np.testing.assert_allclose(found, lsq_linear(phi, y, (least, most), tol=1e-14).x, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_normal_equations_are_solved_as_by_scipy_where_several_parameters_are_at_bounds(seed):
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((60, 5)) @ (np.eye(5) + 0.3 * rng.standard_normal((5, 5)))
    y, least, most = rng.standard_normal(60), np.array([0.0, 0.0, 0.0, -np.inf, -np.inf]), np.full(5, np.inf)
    most[3] = 0.0
    rows = np.column_stack([y, phi])
    expected = lsq_linear(phi, y, (least, most), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(solve_gram(rows.T @ rows, least, most), expected, rtol=1e-6, atol=1e-9)


def test_two_equal_columns_share_what_they_explain_and_the_fit_says_so():
    phi, y, _ = regression(0, columns=2)
    fit, alone = fitted(np.column_stack([phi, phi[:, 1]]), y), fitted(phi, y)
    np.testing.assert_allclose(fit.theta[1:], 0.5 * alone.theta[1])
    assert fit.condition > 1e10


def test_a_jacobian_of_shapes_widens_the_standard_errors_and_leaves_the_parameters():
    phi, y, _ = regression(0)
    jacobian = (phi[:, 2] / 10 + 0.05 * np.random.default_rng(1).standard_normal(len(y)))[:, None]
    limits = {"least": np.full(3, -np.inf), "most": np.full(3, np.inf)}
    balance = replace(
        Balance.from_target(y, np.ones(len(y))), phi=phi[:, :3], by_torque=np.zeros((len(y), 3)), **limits
    )
    plain, fit = (balance.fit(np.arange(len(y)) // 10, own) for own in (None, jacobian))
    np.testing.assert_array_equal(fit.theta, plain.theta)
    assert fit.covariance.shape == (4, 4)
    assert fit.std[2] > 1.5 * plain.std[2]


def test_the_covariance_is_that_of_leaving_out_each_cluster_and_fitting_again():
    phi, y, _ = regression(0)
    clusters = np.sort(np.random.default_rng(2).integers(0, 12, len(y)))
    whole = np.linalg.lstsq(phi, y, rcond=None)[0]
    parts = [np.linalg.lstsq(phi[clusters != c], y[clusters != c], rcond=None)[0] - whole for c in range(12)]
    expected = 11 / 12 * sum(np.outer(part, part) for part in parts)
    found, _ = compute_jackknife(phi, y - phi @ whole, clusters)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-6)


def test_intervals_hold_the_truth_though_few_clusters_tell_of_it():
    """Forty clusters, three of which move the second column: 95 % intervals hold in 90 to 99 %."""
    inside, rng = [], np.random.default_rng(6)
    for _ in range(600):
        clusters = np.repeat(np.arange(40), 10)
        moving = np.isin(clusters, rng.choice(40, 3, replace=False))
        phi = np.column_stack([np.ones(400), moving * rng.standard_normal(40)[clusters]])
        error = 0.3 * rng.standard_normal(40)[clusters] + 0.3 * rng.standard_normal(400)
        fit = solve(Equations(phi, phi @ [1.0, 2.0] + error), np.ones(400), clusters)
        inside.append(abs(fit.theta[1] - 2.0) < 1.96 * fit.std[1])
    assert 0.9 <= np.mean(inside) <= 0.99


def test_one_cluster_alone_gives_errors_all_the_same():
    rng = np.random.default_rng(0)
    phi, noise = rng.normal(size=(200, 2)), 0.1 * rng.normal(size=200)
    assert fitted(phi, phi @ [1.0, 2.0] + noise, each=200).std == pytest.approx(0.1 / np.sqrt(200), rel=0.2)


def loaded(mu: float, noise: float, seed: int = 0, count: int = 2000) -> tuple[Balance, np.ndarray]:
    """Torque of a gear whose friction grows with it, tau = phi theta + mu |tau| s, some of it unexplained."""
    rng = np.random.default_rng(seed)
    phi = np.column_stack([rng.choice([-1.0, 1.0], count) * rng.uniform(1.0, 2.0, count), np.ones(count)])
    theta, sign = np.array([2.0, 0.3]), rng.choice([-1.0, 1.0], count)
    driven = phi @ theta + noise * rng.standard_normal(count)
    torque = driven / (1 - mu * sign * np.sign(driven))
    column, slope = np.abs(torque) * sign, np.sign(torque) * sign
    full = np.column_stack([phi, column])
    by_torque = np.column_stack([np.zeros((count, 2)), slope])
    bounds = np.array([-np.inf, -np.inf, -np.inf]), np.array([np.inf, np.inf, 0.7])
    return Balance(full, torque, by_torque, *bounds, np.ones(count)), np.array([*theta, mu])


@pytest.mark.parametrize("mu", [0.1, 0.3, 0.5])
def test_torque_is_predicted_from_motion_and_not_explained_by_torque(mu):
    balance, truth = loaded(mu, 1.0)
    assert balance.solve() == pytest.approx(truth, rel=0.1, abs=0.03)
    plain = np.linalg.lstsq(balance.phi, balance.y, rcond=None)[0]
    assert plain[2] > balance.solve()[2]  # the more torque explains itself, the smaller is what is left
    clean, truth = loaded(mu, 0.0)
    assert clean.solve() == pytest.approx(truth, rel=1e-6)


def test_a_parameter_that_would_leave_its_bounds_stays_there_and_the_others_make_the_best_of_it():
    balance, _ = loaded(0.3, 0.1)
    *theta, held = replace(balance, most=np.array([np.inf, np.inf, 0.1])).solve()
    others = solve_least_squares(
        (balance.phi / (1 - 0.1 * balance.by_torque[:, 2:]))[:, :2], balance.error([0, 0, 0.1])
    )
    assert held == 0.1 and theta == pytest.approx(others, rel=1e-2)


@pytest.mark.parametrize("most", [np.inf, 0.5])
@pytest.mark.parametrize("twins", [False, True])
def test_each_fold_is_left_out_as_if_it_were_not_there(most, twins):
    phi, y, _ = regression(3)
    phi[:, 3] = phi[:, 2] if twins else phi[:, 3]  # two columns that nothing tells apart
    weights, fold = np.linspace(0.5, 1.0, len(y)), np.arange(len(y)) // 7 % 10
    free = np.full(4, np.inf)
    balance = Balance(phi, y, np.zeros_like(phi), -free, np.array([np.inf, most, np.inf, np.inf]), weights)
    for k, theta in enumerate(solve_without(balance, fold, 10)):
        kept = fold != k
        rows = phi[kept, : 4 - twins] * weights[kept, None], y[kept] * weights[kept]
        found = lsq_linear(*rows, (-free[twins:], balance.most[: 4 - twins]), tol=1e-14).x
        np.testing.assert_allclose(phi @ theta, phi[:, : 4 - twins] @ found, atol=1e-6 * np.abs(y).max())


def test_each_fold_of_a_bent_law_is_left_out_as_well_and_weights_multiply_the_errors():
    balance, _ = loaded(0.2, 0.5)
    fold, early = np.arange(len(balance.y)) // 7 % 10, np.arange(len(balance.y)) < 500
    whole = balance.solve()
    for k, theta in enumerate(solve_without(balance, fold, 10)):
        others = balance[fold != k]
        best, found = (np.sum((others.weights * others.error(own)) ** 2) for own in (others.solve(whole), theta))
        assert len(others.y) * (found / best - 1) / 2 < 0.2  # [nat]
    few = replace(balance, weights=np.where(early, 1.0, 1e-6)).solve()
    assert few == pytest.approx(balance[early].solve(), rel=1e-3, abs=1e-3)


def test_errors_beside_a_parameter_at_its_bound_are_those_of_a_fit_without_it():
    rng = np.random.default_rng(3)
    a = rng.standard_normal(400)
    phi = np.column_stack([a, a + 0.3 * rng.standard_normal(400)])
    y = phi @ [1.0, -0.2] + 0.1 * rng.standard_normal(400)  # the second may not be negative
    nothing, most = np.zeros_like(phi), np.array([np.inf, np.inf])
    balance = Balance(phi, y, nothing, np.array([-np.inf, 0.0]), most, np.ones(400))
    bounded, alone = balance.fit(np.arange(400) // 10), fitted(phi[:, :1], y)
    assert bounded.theta == pytest.approx([alone.theta[0], 0.0])
    assert bounded.std == pytest.approx([alone.std[0], 0.0])


def test_a_fit_of_torque_on_both_sides_scatters_as_it_says():
    """Noise on a torque that is on both sides: the estimates of many data sets scatter by their standard errors."""
    estimates, told = [], []
    for seed in range(60):
        balance, truth = loaded(0.3, 0.0, seed, 600)
        noise = 0.05 * np.random.default_rng(100 + seed).standard_normal(600)
        noisy = replace(balance, phi=balance.phi + balance.by_torque * noise[:, None], y=balance.y + noise)
        assert noisy.error(truth) == pytest.approx(noise, abs=1e-9)
        fit = noisy.fit(np.arange(600) // 10)
        estimates.append(fit.theta)
        told.append(fit.std)
    scatter = np.std(estimates, axis=0) / np.mean(told, axis=0)
    assert np.mean(estimates, axis=0) == pytest.approx(truth, abs=0.01)
    assert np.all((0.6 < scatter) & (scatter < 1.5))


def samples() -> Samples:
    rng = np.random.default_rng(0)
    time = np.arange(600) / 100
    position, velocity = rng.uniform(-3, 3, 600), 2 * rng.standard_normal(600)
    return Samples(time, position, velocity, 4 * rng.standard_normal(600))


def test_cross_entropy_finds_a_minimum_among_many():
    truth = effect("backlash")(gap=0.013, resonance=75.0, damping=12.0, gravity=21.0)
    sought = [parameter.name for parameter in list_continuous_parameters(truth)]

    def logarithms(term: Term) -> np.ndarray:
        return np.log([term.nonlinear_values[name] for name in sought])

    target = logarithms(truth)

    def errors(variants: list[Term]) -> list[float]:
        away = [logarithms(variant) - target for variant in variants]
        return [float(np.sum(d**2) + 0.02 * np.sum(1 - np.cos(25 * d))) for d in away]

    x = samples()
    variants = make_grid(effect("backlash"), x, x.torque)
    found = search_by_cross_entropy(variants, errors)
    assert errors([found])[0] < 0.5 * min(errors(variants))
    np.testing.assert_allclose(logarithms(found), target, atol=0.35)
    assert search_by_cross_entropy(variants, errors) == found


def test_the_quietest_recording_counts_most_and_one_without_equations_not_at_all():
    assert weigh_recordings(np.array([40.0, 4000.0]), np.array([40, 40]), 0.0) == pytest.approx([1.0, 0.1])
    assert weigh_recordings(np.array([40.0, 4000.0]), np.array([40, 40]), 5.0) == pytest.approx([1.0, 0.5])
    assert weigh_recordings(np.array([4.0, 0.0]), np.array([1, 0]), 0.5).tolist() == [1.0, 0.0]


def test_a_nonlinear_parameter_stays_within_its_limits():
    def errors(variants: list[Term]) -> list[np.ndarray]:
        return [np.full(5, own.nonlinear_values["stribeck_velocity"]) for own in variants]

    found = refine_nonlinear(effect("stribeck")(stribeck_velocity=0.05), errors)
    assert found.nonlinear_values["stribeck_velocity"] == effect("stribeck").nonlinear_parameters[0].low
