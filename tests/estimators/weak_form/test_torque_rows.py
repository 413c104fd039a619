"""What is recorded is predicted from the motion: a law of the torque by itself explains nothing of it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.regression_data import RegressionData
from estimators.data.split import split_recordings
from estimators.regression.balance import Balance, compute_least_square
from estimators.search_hints import make_grid
from estimators.selection.evidence import Evidence
from estimators.weak_form.columns import is_torque_dependent
from estimators.weak_form.preparation import prepare_windows
from estimators.weak_form.torque_rows import TorqueRows
from pendulum_env.filters import filter_lag
from pendulum_env.physics import BASE, Column, NonlinearParameter, Samples, Term, effects
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.limits import limit_term
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.physics.term import Memory
from pendulum_env.recording import Recording
from tests.cases import recorded


@dataclass(frozen=True)
class Squashed(Term):
    """A user's bend of the torque, tau / (1 + |tau| / L)."""

    limit: float = 3.0

    id = "squashed"
    law = "tau - tau / (1 + |tau| / L)"
    kind = "actuation"
    nonlinear_parameters = (NonlinearParameter("limit", "N m", 0.3, 100.0),)

    @property
    def fixed(self) -> tuple[Column, ...]:
        return (Column("squashed", "1", force=lambda x: x.torque - x.torque / (1 + np.abs(x.torque) / self.limit)),)


@dataclass(frozen=True)
class TwoLags(Term):
    """A user's filter of the torque, of second order."""

    time_constant: float = 0.02

    id = "two_lags"
    law = "tau - tau_b with T tau_b' = tau_a - tau_b and T tau_a' = tau - tau_a"
    kind = "actuation"
    nonlinear_parameters = (NonlinearParameter("time_constant", "s", 1e-3, 1.0),)

    @property
    def fixed(self) -> tuple[Column, ...]:
        return (Column("two_lags", "1", force=lambda x: x.torque - x.memory["two_lags"][0]),)

    def trace(self, x: Samples, command: np.ndarray, period: float) -> Memory:
        keep = np.exp(-period / self.time_constant)
        return (filter_lag(filter_lag(command, keep, command[0]), keep, command[0]),)


LAWS = {kind.id: kind for kind in (*effects().values(), Squashed, TwoLags) if is_torque_dependent(kind())}


@pytest.fixture(scope="module")
def regression() -> TorqueRows:
    return TorqueRows(
        prepare_windows(recorded(Plant(), Experiment(rate=500.0, seconds=6.0, seed=1, excitation="pd_loop")))
    )


def unpredicted(balance: Balance, theta: np.ndarray) -> np.ndarray:
    """What parameters leave of the torque as it was recorded [N m]."""
    return (balance.unfiltered or balance).error(theta)


@pytest.mark.parametrize("id", LAWS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_a_law_that_only_makes_the_torque_smaller_explains_nothing_of_it(regression: TorqueRows, id: str, share: float):
    """Of a model whose motion takes no torque, all that was recorded is left, whatever becomes of it on the way."""
    recorded = regression.data.torque.recorded
    for term in make_grid(LAWS[id], regression.data.samples, recorded):
        balance = regression.equations((*BASE, term))
        theta = np.where(balance.of_torque, np.minimum(balance.most, share), 0.0)
        left = np.linalg.norm(unpredicted(balance, theta))
        assert left > 0.9 * np.linalg.norm(recorded), term  # all but what the least slope of an equation hides


def test_a_law_that_removes_nearly_all_torque_predicts_less_than_the_pendulum_without_it():
    """A coarse encoder has much noise of the motion, which must not stand for the torque."""
    recordings = recorded(Plant(), Experiment(rate=500.0, seconds=8.0, seed=1, excitation="pd_loop", counts=1000))
    evidence = Evidence.from_data(*split_recordings(recordings))
    tiny = effects()["torque_saturation"](0.002 * float(np.abs(recordings[0].torque).max()))
    assert evidence.densities.compute((*BASE, tiny)).sum() < evidence.densities.compute(BASE).sum()


def test_a_bent_torque_is_solved_for_what_was_recorded(regression: TorqueRows):
    """Half of a limit is the torque of artanh 1/2: as much of it as the law takes has been recorded, not less."""
    limit = 2.0 * float(np.abs(regression.data.torque.recorded).max())
    term = effects()["torque_saturation"](limit)
    balance = regression.equations((*BASE, term))
    theta = regression.fits.solve(BASE)
    need = regression.data.equations(BASE).phi @ theta
    exact = regression.data.torque.recorded - limit * np.arctanh(need / limit)
    np.testing.assert_allclose(unpredicted(balance, theta), exact, atol=5e-3 * limit)


def test_torque_behind_a_lag_is_predicted_with_its_lead(regression: TorqueRows):
    """(1 + T d/dt) of a torque that is a function of the motion, here of gravity alone."""
    term = effects()["actuator_lag"](0.03)
    balance = regression.equations((*BASE, term))
    theta = np.array([0.0, 2.0, 0.0, 0.0])
    (w,) = regression.data.windows
    rate = np.cos(w.samples.position) * w.samples.velocity
    led = 2.0 * (w.averages.narrow @ (np.sin(w.samples.position) + 0.03 * rate))
    np.testing.assert_allclose(unpredicted(balance, theta), regression.data.torque.recorded - led, atol=5e-3)


def test_a_lag_of_a_torque_that_is_none_leaves_what_the_joint_needs(regression: TorqueRows):
    """A free swing, held out: nothing is taken away, and nothing is blown up."""
    (w,) = regression.data.windows
    free = Recording(w.recording.time, w.recording.position, np.zeros(len(w.recording)), name="free")
    own = TorqueRows(prepare_windows([free]))
    theta = np.array([0.09, 2.0, 0.36, 0.9])
    lagging, plain = (own.equations(terms).error(theta) for terms in ((*BASE, effects()["actuator_lag"](0.03)), BASE))
    np.testing.assert_allclose(lagging, plain, rtol=1e-9)


def test_a_filter_that_makes_the_torque_smaller_counts_by_what_was_recorded():
    """A hum on the torque channel: a lag leaves less of it, and explains nothing."""
    (run,) = recorded(Plant(), Experiment(rate=500.0, seconds=8.0, seed=2))
    hum = 3.0 * np.sin(2 * np.pi * 15.0 * run.time)
    evidence = Evidence.from_data(*split_recordings([replace(run, torque=run.torque + hum)]))
    lag, base = (*BASE, effects()["actuator_lag"](0.01)), tuple(BASE)
    assert np.std(evidence.train.residual(lag)) < 0.9 * np.std(evidence.train.residual(base))
    assert evidence.densities.compute(lag).sum() < evidence.densities.compute(base).sum()


@pytest.mark.parametrize("known", [{}, {"gravity": (2.1, 2.1)}, {"gravity": (0.0, 0.0), "coulomb": (0.8, 0.8)}])
@pytest.mark.parametrize("id", ["stribeck", "friction_drift", "cogging"])
def test_beside_a_linear_model_variants_compare_by_their_exact_errors(
    regression: TorqueRows, id: str, known: dict[str, tuple[float, float]]
):
    variants = make_grid(effects()[id], regression.data.samples, regression.data.torque.recorded)[:6]
    base = tuple(limit_term(term, known) for term in BASE)
    weights = regression.fits.weights(base)
    for variant, error in zip(variants, regression.compare(base, variants), strict=True):
        terms = (*base, variant)
        rows = regression.regressor.assemble(terms, regression.regressor.list_term_columns(terms), weights)
        exact = compute_least_square(rows)
        assert error == pytest.approx(np.sqrt(exact / (weights @ weights)), rel=1e-9)


@pytest.mark.parametrize("last", [GravityTilt(), Stribeck(0.4)], ids=["tilt", "stribeck"])
@pytest.mark.parametrize("count", [1, 2])
def test_fits_without_a_fold_are_least_squares_without_its_rows(last: Term, count: int):
    plant = Plant(effects={"stribeck": {"strib_d": 0.4, "strib_v": 0.4}})
    runs = recorded(plant, *[Experiment(seed=k, seconds=12.0, rate=500.0) for k in range(count)])
    rows = RegressionData.from_recordings(runs).torque
    terms = (*BASE, last)
    fits, equations = rows.fit_folds(terms), rows.equations(terms)
    weighted = equations.slopes(fits.theta) * equations.weights[:, None]
    error = equations.error(fits.theta) * equations.weights
    for k, theta in enumerate(fits.theta_without_fold):
        kept = rows.layout.scored.fold != k
        step = np.linalg.lstsq(weighted[kept], error[kept], rcond=None)[0]
        np.testing.assert_allclose(theta, fits.theta + step, rtol=1e-6, atol=1e-9)
