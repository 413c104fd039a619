import numpy as np
import pytest

from estimators.arms.excitation import design_excitation
from estimators.regression.equations import IdentificationError


def test_the_motion_keeps_the_limits_of_the_file_and_its_derivatives_agree(six):
    motion = design_excitation(six, tries=5, rng=np.random.default_rng(1))
    time = np.linspace(0, motion.period, 4001)
    q, v, a = motion(time)
    low, high = six.position_limits
    assert (q > low).all() and (q < high).all()
    assert (np.abs(v) < six.velocity_limits).all()
    assert (np.abs(motion.torque(time[::20])) < six.torque_limits).all()
    assert np.abs(np.gradient(q, time, axis=0) - v)[2:-2].max() < 1e-3
    assert np.abs(np.gradient(v, time, axis=0) - a)[2:-2].max() < 1e-2
    assert np.allclose(q[0], q[-1])


def known(motion):
    """Log determinant of the links' information, from finely sampled rows [nat]."""
    phi = motion.body.torque(*motion(np.linspace(0, motion.period, 1000))).reshape(-1, len(motion.body.base))
    return np.linalg.slogdet(phi.T @ phi).logabsdet


def test_more_tries_teach_more_and_single_sines_are_worse_conditioned(six):
    few, many = (design_excitation(six, tries=tries) for tries in (10, 200))
    assert (known(many) - known(few)) / len(six.base) > 0.3  # standard errors fall by a seventh on the average
    assert design_excitation(six, harmonics=1, tries=2).condition > 2 * many.condition


def test_a_motion_that_needs_too_much_torque_is_refused(six):
    with pytest.raises(IdentificationError, match="allow less speed or angle, or more torque"):
        design_excitation(six, period=0.02, harmonics=1, max_speed=6.0, tries=2)
