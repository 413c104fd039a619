import numpy as np
import pytest

from benchmarks import six_joint
from robots.arms import arm_base
from robots.arms.model import ArmModel
from robots.arms.standard import make_pseudo_inertia, nearest_body, standard_parameters


def model(body, standard, noise=0.0):
    base = body.combine @ standard
    std = 1e-3 * np.maximum(np.abs(base), 1e-2)
    base = base + noise * std * np.random.default_rng(0).normal(size=len(base))
    rest = np.ones(2 * len(body.joints))
    return ArmModel.build(arm_base(body), np.append(base, rest), np.append(std, 0.01 * rest))


def test_links_have_the_base_parameters_that_were_found_and_are_bodies(six):
    standard = six.standard_values
    standard[:60] *= np.repeat([1.1, 0.9, 1.2, 1.0, 0.8, 1.1], 10)  # heavier and lighter links than the file's
    standard[60:] = six_joint.ROTORS[:6]
    truth = model(six, standard, noise=1.0)
    found = np.array([estimate.value for estimate in standard_parameters(truth).values()])
    base, std = truth.theta[: len(six.base)], [truth.estimates[name].std for name in six.names]
    assert np.sqrt(np.mean(((six.combine @ found - base) / std) ** 2)) < 1.0
    assert nearest_body(truth).exists
    for link in found[:60].reshape(6, 10):
        assert np.linalg.eigvalsh(make_pseudo_inertia(link)).min() > 0
    assert (found[60:] > 0).all()


def test_what_the_torque_does_not_tell_is_as_in_the_file(six):
    standard = six.standard_values
    standard[60:] = six_joint.ROTORS[:6]
    found = standard_parameters(model(six, standard))
    for joint, mass in zip(six_joint.JOINTS, six_joint.MASSES, strict=False):
        assert found[f"m@{joint}"].value == pytest.approx(mass, rel=0.1)


@pytest.mark.slow
def test_base_parameters_that_no_body_has_are_not_followed(six):
    standard = six.standard_values
    standard[60:] = six_joint.ROTORS[:6]
    standard[59] = -0.01  # Izz of the flange
    found = nearest_body(model(six, standard))
    link = np.array([estimate.value for estimate in found.parameters.values()])[50:60]
    assert np.linalg.eigvalsh(make_pseudo_inertia(link)).min() >= 0
    assert found.distance > 100  # 0.01 kg m^2 at least, of which a thousandth is the standard error
    assert not found.exists and found.farthest
