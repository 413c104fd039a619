import numpy as np
import pytest

from benchmarks.two_link import TwoLink
from estimators.arms.identification import ARM_SCHEMES, identify_arm
from estimators.arms.online import ArmEstimator
from estimators.schemes import six
from estimators.schemes.six import Integral
from tests.two_link import recorded

ARM = TwoLink()


@pytest.fixture(scope="module")
def recording():
    return recorded(seconds=5.0, rate=500.0, scale=(5.0, 2.5), noise=0.01)


@pytest.mark.parametrize("scheme", ARM_SCHEMES, ids=lambda scheme: scheme.id)
def test_online_and_offline_agree(body, recording, scheme):
    online = ArmEstimator(body, 500.0, scheme=scheme)
    for sample in zip(recording.time, recording.position, recording.torque, strict=True):
        online.update(*sample)
    truth = np.concatenate([body.values, np.ravel(np.column_stack([ARM.viscous, ARM.coulomb]))])
    some = np.abs(truth) > 1e-9
    assert np.abs(online.state.theta[some] / truth[some] - 1).max() < 0.02
    offline = identify_arm(recording, body, schemes=[scheme])[scheme.id].model.theta
    assert np.allclose(online.state.theta, offline, rtol=0.02, atol=2e-3)
    assert online.model.estimates["coulomb@elbow"].value == pytest.approx(ARM.coulomb[1], rel=0.02)


def test_each_row_is_used_once_but_for_those_of_the_first_and_last_moments(body, recording):
    online = ArmEstimator(body, 500.0, scheme=six.scheme("hamiltonian"), prior=1e12)
    for sample in zip(recording.time, recording.position, recording.torque, strict=True):
        online.update(*sample)
    offline = identify_arm(recording, body, schemes=[six.scheme("hamiltonian")])["hamiltonian"]
    information = np.diag(np.linalg.inv(online.state.P))
    rows = information[[7, 9]].sum()  # a Coulomb column is +-1 on each row of its joint
    assert 0.9 * offline.used[0] < rows < 1.001 * offline.used[0]


def test_nothing_is_told_across_a_gap_or_a_sample_that_is_no_number(body, recording):
    whole, cut, apart = (ArmEstimator(body, 500.0) for _ in range(3))
    for k, sample in enumerate(zip(recording.time, recording.position, recording.torque, strict=True)):
        whole.update(*sample)
        cut.update(*(sample if k != 1250 else (sample[0], sample[1], np.array([np.nan, 0.0]))))
        if k != 1250:
            apart.update(*sample)
    assert np.array_equal(cut.state.theta, apart.state.theta)
    assert not np.array_equal(cut.state.theta, whole.state.theta)
    assert np.allclose(cut.state.theta, whole.state.theta, rtol=0.02, atol=2e-3)


def test_samples_that_make_no_sense_are_refused_at_once(body):
    online = ArmEstimator(body, 500.0)
    online.update(0.0, np.zeros(2), np.zeros(2))
    with pytest.raises(ValueError, match=r"2 joints has as many positions and torques, not those of shapes \(3,\)"):
        online.update(0.002, np.zeros(3), np.zeros(2))
    with pytest.raises(ValueError, match="a sample of 0 s comes after one of 0 s: reset where time begins anew"):
        online.update(0.0, np.zeros(2), np.zeros(2))
    with pytest.raises(ValueError, match=r"samples come every 0.004 s, not at 500 Hz: pass rate="):
        online.update(0.004, np.zeros(2), np.zeros(2))


def test_schemes_that_cannot_run_so_are_refused(body):
    for scheme in (six.scheme("hamiltonian", borrows="dynamic"), six.scheme("energy", operator=Integral(None))):
        with pytest.raises(ValueError, match="cannot run on an arm"):
            ArmEstimator(body, 500.0, scheme=scheme)
