"""Models in two steps, the running model's columns first, are regularised least squares in all columns."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.online.competitors import Bins, CompetingModels
from estimators.regression.recursive import PRIOR
from pendulum_env.physics import BASE
from pendulum_env.physics.library import effect


def bins_of(count: int, seed: int) -> Bins:
    """Bins of ten samples of a motion and a torque that have nothing to do with each other."""
    rng = np.random.default_rng(seed)
    time = 0.01 * np.arange(count)[:, None] + 0.001 * np.arange(13)
    w = rng.uniform(3, 12, 3)
    angle = w[:, None, None] * time
    position, velocity = np.sin(angle).sum(0), (w[:, None, None] * np.cos(angle)).sum(0)
    series = np.array([time, position, velocity, rng.normal(size=time.shape)])
    return Bins(series, rng.normal(size=count), 1e-3, np.full(count, ""), np.zeros((count, 0)), np.ones(count))


@pytest.mark.parametrize(("id", "shapes"), [("cogging", [{"order": 3.0}, {"order": 7.0}]), ("quadratic_drag", [{}])])
def test_each_variant_is_least_squares_in_all_columns(id, shapes):
    """Also if families go on with another grid, with all that they have learnt."""
    variants = [effect(id)(**shape) for shape in shapes]
    parts = [bins_of(120, 0), bins_of(40, 1), bins_of(40, 2)]
    models = CompetingModels(BASE, parts[0], [variants])
    for part in parts[1:]:
        densities, errors = models.take(part)
        models = models.refine(part, {id: variants})
    for variant, theta in zip(variants, models.theta_of(models.models[1]), strict=True):
        columns = sum(len(term.columns) for term in (*BASE, variant))
        rows = [part.rows([*BASE, variant]) for part in parts]
        phi, y = np.concatenate([one.phi[:, 0] for one in rows]), np.concatenate([one.y[:, 0] for one in rows])
        expected = np.linalg.solve(phi.T @ phi + np.eye(columns) / PRIOR, phi.T @ y)
        np.testing.assert_allclose(theta[:columns], expected, rtol=1e-6, atol=1e-9)
    assert densities.shape == (40, 2) and errors.shape == (40,)


def test_an_error_is_predicted_to_scatter_as_least_squares_has_it():
    """The density of one more error is Student's t with scale^2 (1 + phi' P phi), P that of all columns."""
    variant = effect("cogging")(order=5.0)
    first, then = bins_of(80, 2), bins_of(1, 3)
    models = CompetingModels(BASE, first, [[variant]])
    square = float(models.square[1])
    (densities,), _ = models.take(then)
    phi = first.rows([*BASE, variant]).phi[:, 0]
    new = then.rows([*BASE, variant])
    spread = np.linalg.inv(phi.T @ phi + np.eye(phi.shape[1]) / PRIOR)
    theta = spread @ phi.T @ first.y
    unsure = 1 + new.phi[0, 0] @ spread @ new.phi[0, 0]
    error = float(new.y[0, 0] - new.phi[0, 0] @ theta)
    nu = 4.0
    expected = -0.5 * np.log(square * unsure) - (nu + 1) / 2 * np.log1p(error**2 / (nu * square * unsure))
    assert densities[1] == pytest.approx(expected, rel=1e-6)


def test_a_law_that_passes_next_to_nothing_of_the_torque_gains_nothing_by_that():
    """At a constant speed and torque, far beyond its limit, a saturation leaves next to no error of what it passes."""
    rng, parts = np.random.default_rng(4), []
    for part in (bins_of(100, 4), bins_of(40, 5)):
        series = part.series.copy()
        series[1:3], series[3] = 2.0, 3.0 + 0.05 * rng.normal(size=(len(part.y), 1))
        parts.append(replace(part, series=series, y=series[3, :, 0]))
    models = CompetingModels(BASE, parts[0], [[effect("torque_saturation")(limit=0.6, roundness=0.2)]])
    densities, _ = models.take(parts[1])
    assert densities[:, 1].sum() <= densities[:, 0].sum()
