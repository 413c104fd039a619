"""Standard errors of parameters include that of a delay of the torque, which is estimated with them."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.checks.alignment import Alignment
from estimators.data.fit_data import FitData
from estimators.data.fits import compute_parameter_changes, fit_terms
from estimators.data.standard_errors import widen_by_constant, widen_by_timing
from estimators.data.timing import Timing
from estimators.signals.channel import Channel
from pendulum_env.physics import BASE, Estimate, Model, effect
from pendulum_env.recording import TorqueConstant
from tests.cases import recorded

DELAY, STD = 0.004, 0.0005  # [s], of the torque, and the error of its estimate
K = 0.873  # [N m/A]


def time_recording(law: Alignment, delay: float) -> FitData:
    """Return the data of a recording whose torque is logged late, corrected by a delay with an error of `law`."""
    recording = recorded(Plant(), Experiment(rate=500.0, seconds=12.0, excitation="multisine", seed=3))[0]
    late = replace(recording, torque=np.roll(recording.torque, 2))
    own = replace(law, channel=replace(law.channel, delay=delay))
    corrected = replace(own.apply(late), is_checked=True)
    return FitData((corrected,), (corrected,), timing=Timing((law, law), (late.name, late.name), (late, late)))


LATE = Alignment(Channel(DELAY), STD, 0.0)


def test_errors_grow_by_the_change_of_the_parameters_under_another_delay():
    data = time_recording(LATE, DELAY)
    train = data.parts[0]
    model = fit_terms(train, BASE)[0]
    widened = widen_by_timing(model, data, train)
    first, second = (fit_terms(time_recording(LATE, DELAY + change).parts[0], BASE)[0] for change in (-STD, STD))
    for name in ("inertia", "gravity", "viscous", "coulomb"):
        change = np.sqrt(widened.estimates[name].std ** 2 - model.estimates[name].std ** 2)
        difference = abs(second.estimates[name].value - first.estimates[name].value) / 2
        assert change == pytest.approx(difference, rel=0.2, abs=0.2 * model.estimates[name].std)
    assert widened.estimates["inertia"].std > 2 * model.estimates["inertia"].std
    assert [own.value for own in widened.estimates.values()] == [own.value for own in model.estimates.values()]
    np.testing.assert_allclose(np.sqrt(np.diag(widened.covariance)), [own.std for own in widened.estimates.values()])


def test_an_exact_delay_has_no_error():
    data = time_recording(replace(LATE, delay_std=0.0), DELAY)
    model = fit_terms(data.parts[0], BASE)[0]
    assert widen_by_timing(model, data, data.parts[0]) is model


@pytest.mark.parametrize("timing", [Timing((Alignment(Channel(), np.inf, np.inf),), ("run",)), Timing()])
@pytest.mark.parametrize("rate", [100.0, 500.0])
@pytest.mark.parametrize("hidden", [{}, {"stribeck": {"strib_d": 0.4, "strib_v": 0.3}}], ids=["base", "stribeck"])
def test_torque_in_time_may_be_late_by_what_the_data_allow(hidden, rate, timing):
    """The error is that of a fit with a free delay, and at most that of a delay of one sample."""
    noise = {"torque_noise": 0.1, "counts": 4096}
    experiment = Experiment(rate=rate, seconds=12.0, excitation="two_tone", seed=3, **noise)
    recording = recorded(Plant(effects=hidden), experiment)[0]
    data = FitData((recording,), timing=timing)
    train, terms = data.parts[0], (*BASE, *(effect(id)(stribeck_velocity=0.3) for id in hidden))
    model = fit_terms(train, terms)[0]
    widened = widen_by_timing(model, data, train)
    rates = np.concatenate([w.rates.narrow @ w.samples.torque for w in train.data.windows])
    jacobian, _ = train.maker.nonlinear_jacobian(model.terms, model.theta)
    rows = train.equations(model.terms)
    free = rows.fit(train.layout.clusters, np.column_stack([jacobian, rates]), model.theta)
    sample = compute_parameter_changes(train, model, rates / rate)
    for k, (name, estimate) in enumerate(widened.estimates.items()):
        own = model.estimates[name].std
        assert own <= estimate.std <= 1.01 * np.hypot(own, sample[name])
        assert estimate.std == pytest.approx(min(free.std[k], np.hypot(own, sample[name])), rel=0.3)
    growth = [estimate.std / model.estimates[name].std for name, estimate in widened.estimates.items()]
    assert max(growth) > 1.1


def test_parameters_change_together_with_the_torque_constant():
    """Five per cent of the constant are five of every torque, and of no ratio of two parameters."""
    terms = (*BASE, effect("stribeck")(stribeck_velocity=0.5))
    model = Model.build(terms, [0.1, 2.0, 0.4, 0.9, 0.3], 1e-6, **{"stribeck.stribeck_velocity": 0.01})
    wider = widen_by_constant(model, TorqueConstant(K, 0.05 * K, "A"))
    assert wider.estimates["gravity"].std == pytest.approx(0.05 * 2.0, rel=1e-3)
    assert wider.estimates["stribeck.stribeck_velocity"].std == 0.01  # a speed
    assert np.array(wider.correlation)[0, 1:5] == pytest.approx(1.0, abs=1e-3) and wider.correlation[0][5] == 0.0
    assert wider.torque_constant == Estimate(K, 0.05 * K, "N m/A")
