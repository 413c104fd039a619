"""The one iteration of nonlinear least squares, on curves with a known answer."""

import numpy as np
import pytest

from estimators.regression.gauss_newton import LocalErrors, StopRule, choose_least, gauss_newton

TIME = np.linspace(0.0, 2.0, 40)
TRUE, START = np.array([2.0, -1.5]), np.array([0.5, 0.0])
ALL = StopRule(50, (1e-6, 1.0), of_cost=1e-12)


def decay(most: float = np.inf, least: float = -np.inf, noise: float = 0.0):
    """Errors of a exp(b t) at a of at most `most` and b of at least `least`, and trials of steps from there."""
    measured = TRUE[0] * np.exp(TRUE[1] * TIME) + noise * np.random.default_rng(0).standard_normal(len(TIME))

    def error(place):
        return place[0] * np.exp(place[1] * TIME) - measured

    def near(place):
        own = np.exp(place[1] * TIME)
        slopes, left = np.column_stack([own, place[0] * TIME * own]), error(place)
        bounds = np.array([False, place[1] <= least]), np.array([place[0] >= most, False])
        return LocalErrors(place, float(left @ left), left, slopes, *bounds)

    def best(near, steps):
        places = [near.known + share * step for step in steps for share in (1.0, 0.2)]
        places = [np.array([min(a, most), max(b, least)]) for a, b in places]
        return choose_least(places, [float(error(place) @ error(place)) for place in places])

    return near, best


@pytest.mark.parametrize("start", [(0.5, 0.0), (5.0, -4.0)])
def test_a_wrong_start_leads_to_the_minimum(start):
    assert gauss_newton(np.array(start), *decay(), ALL) == pytest.approx(TRUE, rel=1e-6)


@pytest.mark.parametrize(("at", "limits", "side"), [(0, {"most": 1.5}, -1.0), (1, {"least": -1.0}, 1.0)])
def test_a_parameter_at_its_bound_stays_there_and_the_others_are_the_best_beside_it(at, limits, side):
    (near, best), (bound,) = decay(**limits), limits.values()
    found = gauss_newton(START, near, best, ALL)
    assert found[at] == bound
    local = near(found)
    slope = local.slopes[:, 1 - at]
    assert abs(slope @ local.error) < 1e-3 * np.linalg.norm(slope) * np.linalg.norm(local.error)
    assert side * (local.slopes[:, at] @ local.error) > 0  # beyond the bound, the error would be lower


def test_it_ends_where_a_step_is_short_against_standard_errors_or_gains_little():
    near, best = decay(noise=0.1)
    turns = []

    def counted(place):
        turns.append(near(place).cost)
        return near(place)

    closest = gauss_newton(START, counted, best, ALL)
    every = len(turns)
    for rule in (
        StopRule(50, ALL.dampings, by_offset=True),
        StopRule(50, ALL.dampings, of_cost=0.01),
        StopRule(2, ALL.dampings),
    ):
        turns.clear()
        found = gauss_newton(START, counted, best, rule)
        assert len(turns) < every
        assert near(found).cost < 1.02 * near(closest).cost or len(turns) == 2
