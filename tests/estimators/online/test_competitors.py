"""Models in two steps, the running model's columns first, are regularised least squares in all columns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from estimators.online.binning import Bins, ModelRows, PlantBins
from estimators.online.competitors import CompetingModels, solve_each_within_bounds
from estimators.online.settings import ONLINE
from estimators.online.work import complete
from estimators.regression.recursive import PRIOR
from estimators.signals.measurements import Smoothing
from pendulum_env.physics import BASE
from pendulum_env.physics.library import effect

PLANT = PlantBins(("",), 1e-3, 10, Smoothing(2))
SLICES = (ONLINE.bins.history + 1) * 5  # of 2 ms


def make_bins(series: np.ndarray, y: np.ndarray, slices: np.ndarray | None = None) -> Bins:
    """Bins of one joint; without slices, the past torque is zero."""
    count = len(y)
    slices = np.zeros((count, SLICES)) if slices is None else slices
    names, links = np.full(count, ""), np.zeros((count, 0))
    return Bins(series, y, PLANT, names, links, np.ones(count), slices, np.full(count, np.nan))


def bins_of(count: int, seed: int) -> Bins:
    """Bins of ten samples of a motion and a torque that have nothing to do with each other."""
    rng = np.random.default_rng(seed)
    time = 0.01 * np.arange(count)[:, None] + 0.001 * np.arange(13)
    w = rng.uniform(3, 12, 3)
    angle = w[:, None, None] * time
    position, velocity = np.sin(angle).sum(0), (w[:, None, None] * np.cos(angle)).sum(0)
    series = np.array([time, position, velocity, rng.normal(size=time.shape)])
    return make_bins(series, rng.normal(size=count))


@pytest.mark.parametrize(("id", "shapes"), [("cogging", [{"order": 3.0}, {"order": 7.0}]), ("quadratic_drag", [{}])])
def test_each_variant_is_least_squares_in_all_columns(id, shapes):
    """Also if families go on with another grid, with all that they have learnt."""
    variants = [effect(id)(**shape) for shape in shapes]
    parts = [bins_of(120, 0), bins_of(40, 1), bins_of(40, 2)]
    models = complete(CompetingModels.fit(BASE, parts[0], [variants]))
    for part in parts[1:]:
        densities, squares = complete(models.take(part))
        models = complete(models.refine(part, {id: variants}))
    for variant, theta in zip(variants, models.compute_theta(models.models[1]), strict=True):
        columns = sum(len(term.columns) for term in (*BASE, variant))
        rows = [part.evaluate_rows([*BASE, variant]) for part in parts]
        phi, y = np.concatenate([one.phi[:, 0] for one in rows]), np.concatenate([one.y[:, 0] for one in rows])
        expected = np.linalg.solve(phi.T @ phi + np.eye(columns) / PRIOR, phi.T @ y)
        np.testing.assert_allclose(theta[:columns], expected, rtol=1e-6, atol=1e-9)
    assert densities.shape == squares.shape == (40, 2)


def test_an_error_is_predicted_to_scatter_as_least_squares_has_it():
    """The density of one more error is Student's t with scale^2 (1 + phi' P phi), P that of all columns."""
    variant = effect("cogging")(order=5.0)
    first, then = bins_of(80, 2), bins_of(1, 3)
    models = complete(CompetingModels.fit(BASE, first, [[variant]]))
    square = float(models.square[1])
    (densities,), _ = complete(models.take(then))
    phi = first.evaluate_rows([*BASE, variant]).phi[:, 0]
    new = then.evaluate_rows([*BASE, variant])
    spread = np.linalg.inv(phi.T @ phi + np.eye(phi.shape[1]) / PRIOR)
    theta = spread @ phi.T @ first.y
    unsure = 1 + new.phi[0, 0] @ spread @ new.phi[0, 0]
    error = float(new.y[0, 0] - new.phi[0, 0] @ theta)
    nu = 4.0
    expected = -0.5 * np.log(square * unsure) - (nu + 1) / 2 * np.log1p(error**2 / (nu * square * unsure))
    assert densities[1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("count", [1, 2])
def test_parameters_within_bounds_are_those_of_bounded_least_squares(count):
    rng = np.random.default_rng(count)
    for _ in range(50):
        rows, y = rng.normal(size=(12, count)) @ rng.normal(size=(count, count)), rng.normal(size=12)
        least, most = np.zeros(count), np.where(rng.random(count) < 0.5, 0.1, np.inf)
        theta, _ = solve_each_within_bounds((rows.T @ rows)[None], (rows.T @ y)[None], least[None], most[None])
        expected = lsq_linear(rows, y, (least, most)).x
        np.testing.assert_allclose(rows @ theta[0], rows @ expected, atol=1e-5)


def bins_of_gear(first: int, last: int, output: float, share: float) -> Bins:
    """Bins of a gear with friction 0.2 of the torque and a share of the weight; the motor mostly drives."""
    rng = np.random.default_rng(6)
    time = 0.01 * np.arange(last)[:, None] + 0.001 * np.arange(13)
    position, velocity = -np.cos(2 * time) + 0.3 * np.sin(5 * time), 2 * np.sin(2 * time) + 1.5 * np.cos(5 * time)
    way, weight = np.sign(velocity), 2.0 * np.sin(position)
    left = weight * share + 0.4 * velocity + (0.5 + output * np.abs(weight)) * way
    load = left / (1.0 - 0.2 * way * np.sign(left)) + 0.1 * rng.normal(size=(last, 1))  # tau = left + 0.2 |tau| way
    kept = ~np.any(np.diff(way, axis=1), axis=1)
    kept[:first] = False
    series, y = np.array([time, position, velocity, load])[:, kept], load[kept, 2:-1].mean(axis=1)
    return make_bins(series, y)


@pytest.mark.parametrize("output", [0.0, 0.1])
def test_friction_that_grows_with_the_torque_is_unbiased_by_noise_of_the_torque_and_within_its_bounds(output):
    terms, gear = BASE[1:], effect("load_dependent_friction")(weight=2.0)
    models = complete(CompetingModels.fit(terms, bins_of_gear(0, 300, output, 1.0), [[gear]]))
    complete(models.take(bins_of_gear(300, 3000, output, 1.0)))
    gravity, viscous, coulomb, mu, of_output = models.compute_theta()[1]
    assert of_output >= 0.0
    np.testing.assert_allclose([gravity, viscous, coulomb, mu], [2.0, 0.4, 0.5, 0.2], rtol=0.05)
    assert of_output == pytest.approx(output, abs=0.02)
    added = complete(
        CompetingModels.fit((*terms, gear), bins_of_gear(0, 3000, output, 1.0))
    )  # once it is in the running model
    np.testing.assert_allclose(added.y_on_base[0, :4], [2.0, 0.4, 0.5, 0.2], rtol=0.05)


def test_torque_is_not_explained_by_itself():
    """Where the motor drives all motion, friction that grows with the torque only scales the other parameters."""
    terms, gear = BASE[1:], effect("load_dependent_friction")(weight=2.0)
    models = complete(CompetingModels.fit(terms, bins_of_gear(0, 300, 0.0, 0.0), [[gear]]))
    densities, _ = complete(models.take(bins_of_gear(300, 600, 0.0, 0.0)))
    assert abs(np.diff(densities.sum(axis=0))) < 3.0  # [nat]


def test_a_law_that_passes_next_to_nothing_of_the_torque_gains_nothing_by_that():
    """At a constant speed and torque, far beyond its limit, a saturation leaves next to no error of what it passes."""
    rng, parts = np.random.default_rng(4), []
    for part in (bins_of(100, 4), bins_of(40, 5)):
        series = part.series.copy()
        series[1:3], series[3] = 2.0, 3.0 + 0.05 * rng.normal(size=(len(part.y), 1))
        parts.append(replace(part, series=series, y=series[3, :, 0]))
    models = complete(CompetingModels.fit(BASE, parts[0], [[effect("torque_saturation")(limit=0.6, roundness=0.2)]]))
    densities, _ = complete(models.take(parts[1]))
    assert densities[:, 1].sum() <= densities[:, 0].sum()


def of_model(count: int, seed: int, theta: np.ndarray) -> Bins:
    """Bins of the base model with noise of the torque."""
    part = bins_of(count, seed)
    noise = 0.05 * np.random.default_rng(seed).normal(size=count)
    return replace(part, y=part.evaluate_rows(BASE).phi[:, 0] @ theta + noise)


def test_equations_beyond_their_singularity_are_not_linearised():
    """With friction of 0.99 or 1.98 of the torque, dy / dtau is 0.01 or -0.98: the fit would run away."""
    rows = ModelRows(np.ones((3, 1)), np.full(3, 2.0), np.full((3, 1), 0.99), np.ones(3))
    for theta, is_linearised in ((0.5, True), (1.0, False), (2.0, False)):
        error, _ = rows.predict(np.array([theta]))
        phi, y = rows.linearise(np.array([theta]), error)
        assert (phi != rows.phi).all() == is_linearised and (y != rows.y).all() == is_linearised


def test_models_with_forgetting_gain_after_a_change_of_parameters_and_lose_little_before():
    theta = np.array([0.1, 2.0, 0.4, 0.9])
    models = complete(CompetingModels.fit(BASE, of_model(200, 0, theta), memories=[50.0]))
    before, _ = complete(models.take(of_model(100, 1, theta)))
    after, _ = complete(models.take(of_model(100, 2, theta * [1.0, 1.3, 1.0, 1.0])))
    gains = [densities[:, 1].sum() - densities[:, 0].sum() for densities in (before, after)]
    assert abs(gains[0]) < 3.0 and gains[1] > 30.0  # [nat]


@pytest.mark.parametrize(("limit", "gains"), [(1e3, True), (0.6, False)])
def test_models_with_forgetting_gain_nothing_where_the_law_passes_almost_none_of_the_torque(limit, gains):
    """Of a saturation far beyond its limit; the torque of the motion changes."""
    rng, parts, saturation = np.random.default_rng(4), [], effect("torque_saturation")(limit=limit, roundness=0.2)
    for count, scale in ((100, 1.0), (60, 1.5)):
        part = bins_of(count, 4)
        series = part.series.copy()
        series[3] = scale * (2.0 * series[2] + 3.0 * np.sign(series[2])) + 0.05 * rng.normal(size=(count, 1))
        parts.append(replace(part, series=series, y=series[3, :, 2:-1].mean(axis=1)))
    models = complete(CompetingModels.fit((*BASE, saturation), parts[0], memories=[20.0]))
    densities, _ = complete(models.take(parts[1]))
    assert (densities[:, 1].sum() > densities[:, 0].sum() + 1.0) == gains


def test_weights_of_a_late_torque_are_those_of_a_lag_and_a_delay():
    """Mean over a bin of the torque after T u' = tau(t - d) - u, integrated in small steps."""
    rng, step, lag, delay = np.random.default_rng(7), 1e-5, 0.013, 0.0047
    slices = rng.normal(size=SLICES)
    torque = np.repeat(slices, round(PLANT.slice_length * PLANT.period / step))
    late = np.r_[np.full(round(delay / step), torque[0]), torque][: len(torque)]
    lagged, value = np.empty(len(torque)), torque[0]
    for k, command in enumerate(late):
        middle = command + (value - command) * np.exp(-0.5 * step / lag)
        lagged[k], value = middle, command + (value - command) * np.exp(-step / lag)
    expected = lagged[-round(PLANT.duration / step) :].mean()
    (weights,) = PLANT.compute_late_weights(delay, lag)
    assert weights @ slices == pytest.approx(expected, abs=1e-5)
    assert weights.sum() == pytest.approx(1.0)
