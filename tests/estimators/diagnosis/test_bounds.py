"""Fits within what a body can be, columns of known parameters, and the simplest part of an effect."""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.independent_plant import Plant
from estimators import diagnose
from estimators.data.fits import fit_terms, fit_within_laws
from estimators.data.regression_data import RegressionData
from estimators.diagnosis.conclusion import NoKnownEffect
from estimators.diagnosis.ranking import Imitation
from estimators.weak_form.columns import list_bounds
from pendulum_env.physics import BASE
from pendulum_env.physics.limits import limit_term, release_term
from pendulum_env.physics.potential import GravityTilt, Spring
from pendulum_env.physics.table import FrictionBySpeed, TorqueByAngle
from pendulum_env.recording import Recording
from tests import slow
from tests.cases import recorded, run

OF_ANGLE = ("cogging", "coulomb_asymmetry", "gravity_tilt", "spring", "torque_offset")
FEW = ("friction_drift", "payload_change", "periodic_disturbance", "stribeck", "torque_offset")


def drifting(seed: int, dry: Callable[[float], float], seconds: int = 20, noise: float = 2e-4, rate: int = 250):
    """Record a pendulum of inertia 0.12, gravity 2.6 and viscous 0.25 under several sines, its dry friction over time.

    Moreau's implicit step in plain arithmetic; it shares no code with the packages.
    """
    rng, substeps = np.random.default_rng(seed), 20
    h = 1 / rate / substeps
    time = np.arange(seconds * rate) / rate
    phases, frequencies = rng.uniform(0, 2 * np.pi, 8), rng.uniform(0.15, 3.5, 8)
    torque = np.sin(2 * np.pi * np.outer(time, frequencies) + phases).sum(axis=1)
    torque *= 7.0 / np.abs(torque).max()
    q = v = 0.0
    position = []
    for t, tau in zip(time.tolist(), torque.tolist(), strict=True):
        position.append(q)
        for _ in range(substeps):
            w = v + h * (tau - 2.6 * np.sin(q) - 0.25 * v) / 0.12
            v = float(np.sign(w)) * max(abs(w) - h * dry(t) / 0.12, 0.0)
            q += h * v
    return Recording(time, np.array(position) + rng.normal(0, noise, len(time)), torque, name=f"run {seed}")


@pytest.mark.parametrize("seed", slow.but_first([300, 310, 340]))
def test_dry_friction_that_falls_is_found_although_a_free_fit_makes_it_negative_in_the_end(seed):
    law = lambda t: 0.55 - 0.01 * t  # noqa: E731
    found = diagnose([drifting(seed, law)], [drifting(seed + 1, law)], only=FEW)
    assert found.selected == ("friction_drift",)
    values = {name: own.value for name, own in found.model.estimates.items()}
    assert values["coulomb"] >= 0 and values["viscous"] >= 0
    for t in (0.0, 10.0, 20.0):
        faded = np.exp(-t / values["friction_drift.warm_up"])
        assert values["coulomb"] + values["friction_drift.coulomb"] * faded == pytest.approx(law(t), abs=0.02)


@pytest.mark.parametrize("seed", slow.but_first([401, 411, 421]))
def test_dry_friction_that_rises_along_a_line_is_a_drift(seed):
    """A straight line is an exponential of any long time: only its value and its slope are determined."""
    law = lambda t: 0.35 + 0.008 * t  # noqa: E731
    found = diagnose([drifting(seed, law, 40, 2e-5)], [drifting(seed + 1, law, 40, 2e-5)], only=FEW)
    assert found.selected == ("friction_drift",) and not found.unexplained
    coulomb, fading = (found.model.estimates[name] for name in ("coulomb", "friction_drift.coulomb"))
    warm_up = found.model.estimates["friction_drift.warm_up"].value
    for t in (0.0, 20.0, 40.0):
        assert coulomb.value + fading.value * np.exp(-t / warm_up) == pytest.approx(law(t), abs=0.02)


def test_dry_friction_that_stays_shows_no_drift():
    found = diagnose([drifting(1, lambda t: 0.45)], [drifting(2, lambda t: 0.45)], only=FEW)
    assert found.selected == () and not found.unexplained


def test_bounds_are_those_of_a_body_unless_a_table_shares_friction_or_a_user_sets_others():
    least, most = list_bounds(BASE)
    np.testing.assert_array_equal(least, [0, -np.inf, 0, 0])
    assert np.isinf(most).all()
    np.testing.assert_array_equal(list_bounds([*BASE, FrictionBySpeed()])[0][:4], [0, -np.inf, -np.inf, -np.inf])
    np.testing.assert_array_equal(list_bounds([*BASE, TorqueByAngle()])[0][:4], least)
    own = {"coulomb": (-1.0, 5.0), "viscous": (-np.inf, 5.0), "inertia": (-0.1, -0.1)}
    least, most = list_bounds([limit_term(term, own) for term in BASE])
    np.testing.assert_array_equal(least, [-0.1, -np.inf, 0, -1])
    np.testing.assert_array_equal(most, [-0.1, np.inf, 5, 5])


def prescribed(
    inertia=0.05, viscous=0.2, coulomb=0.1, extra=lambda q, v: 0.0, seed=0, levels=(0.3, 0.7, 1.5), rounds=3
):
    """Compute the torque of a motion at several constant speeds both ways, in some rounds of 18 s."""
    rng, rate = np.random.default_rng(seed), 200.0
    steps = np.repeat(np.repeat(levels, 2) * np.tile([1.0, -1.0], len(levels)), int(3 * rate))
    weights = np.hanning(42)
    velocity = np.convolve(np.tile(steps, rounds), weights / weights.sum(), mode="same")
    time = np.arange(len(velocity)) / rate
    position = np.cumsum(velocity) / rate
    torque = inertia * np.gradient(velocity, time) + viscous * velocity + coulomb * np.sign(velocity)
    torque = torque + extra(position, velocity) + 0.005 * rng.standard_normal(len(time))
    return Recording(time, position + 1e-5 * rng.standard_normal(len(time)), torque, name=f"speeds {seed}")


def test_a_parameter_is_kept_at_zero_with_an_error_if_noise_put_it_there_and_without_if_the_data_ask_for_less():
    free = fit_within_laws(RegressionData.from_recordings([prescribed(coulomb=0.0)]), BASE)["coulomb"]
    little = prescribed(coulomb=-free.value - free.std)
    (noise, _), alone = (
        fit_terms(data := RegressionData.from_recordings([little]), BASE),
        fit_within_laws(data, BASE)["coulomb"],
    )
    assert alone.value == pytest.approx(-free.std, rel=0.2)
    assert noise["coulomb"].value == 0 and not noise["coulomb"].at_bound
    assert noise["coulomb"].std == pytest.approx(alone.std, rel=0.05)
    data = RegressionData.from_recordings([prescribed(coulomb=-0.1)])
    assert fit_within_laws(data, BASE)["coulomb"].value == pytest.approx(-0.1, abs=0.01)
    bounded = fit_terms(data, BASE)[0]
    assert bounded["coulomb"].value == 0 and bounded["coulomb"].at_bound
    assert bounded["viscous"].value > 0


@pytest.mark.parametrize(("seed", "only"), slow.but_first([(0, OF_ANGLE), (0, None), (1, None), (2, None)]))
def test_an_offset_is_no_spring_without_stiffness_even_at_very_small_noise(seed, only):
    runs = [prescribed(extra=lambda q, v: 0.012, seed=10 * seed + k, rounds=1) for k in (1, 2)]
    found = diagnose(runs[:1], runs[1:], fixed={"gravity": 0.0}, only=only)
    (group,) = found.effects
    assert set(group) == {"torque_offset", "coulomb_asymmetry"} and not found.unexplained
    assert found.model.estimates[found.selected[0]].value == pytest.approx(0.012, abs=0.001)


def test_a_spring_that_pulls_is_a_spring_and_the_offset_that_is_part_of_it_is_rejected_as_such():
    runs = [prescribed(extra=lambda q, v: 0.012 + 0.02 * q, seed=k, rounds=1) for k in (1, 2)]
    found = diagnose(runs[:1], runs[1:], fixed={"gravity": 0.0}, only=["spring", "torque_offset", "stribeck"])
    assert found.selected == ("spring",)
    assert found.model.estimates["spring.stiffness"].value == pytest.approx(0.02, abs=0.001)
    offset = next(one for one in found.candidates if one.effect == "torque_offset")
    assert offset.verdict == "rejected" and offset.reason == Imitation("spring")


SMALL, LARGE = ({"excitation": "filtered_noise", "scale": scale, "torque_noise": 0.002} for scale in (0.08, 0.15))


CABLE = [
    *[(0, 0.03, LARGE, LARGE), (1, 0.03, LARGE, LARGE), (2, 0.03, LARGE, LARGE), (3, 0.0, LARGE, LARGE)],
    *[(1, 0.03, SMALL, SMALL), (1, 0.03, SMALL, LARGE)],
]
NEAR = ((0, 0.03, LARGE, LARGE, (*OF_ANGLE, "payload_change")), (1, 0.03, SMALL, LARGE, (*OF_ANGLE, "payload_change")))


@pytest.mark.parametrize(
    ("seed", "second", "fitted", "held_out", "only"), slow.but(NEAR, [*NEAR, *((*one, None) for one in CABLE)])
)
def test_a_cable_is_a_torque_by_angle_where_gravity_is_known_to_be_none(seed, second, fitted, held_out, only):
    """0.10 sin q is no gravity then, and no payload that was picked up before the motion.

    Within 2.2 rad, under a small torque, a spring that softens draws the sine beside the second wave. A large torque
    turns the joint to angles that a recording with a small one does not show: a wandering torque would explain these.
    """
    cable = {"cogging": {"cog_n": 2, "cog_s": -second * np.cos(0.4), "cog_c": -second * np.sin(0.4)}}
    plant = Plant(0.02, 0.10, 0.05, 0.08, cable)
    runs = recorded(plant, *(run(3 * seed + k, 25.0, 200.0, **some) for k, some in ((1, fitted), (2, held_out))))
    found = diagnose(runs[:1], runs[1:], fixed={"gravity": 0.0}, only=only)
    assert found.selected == () and found.tables == ("torque_by_angle",)
    assert found.model.estimates["gravity"].value == 0
    assert NoKnownEffect(("torque_by_angle",)) in (*found.findings, found.no_experiment)


def test_a_known_value_is_kept_to_the_last_digit_so_that_it_violates_no_bound():
    data = RegressionData.from_recordings([prescribed(extra=lambda q, v: 0.3 * np.sin(q))])
    for value in np.random.default_rng(0).uniform(0.1, 20.0, 20).tolist():
        known = [limit_term(term, {"gravity": (value, value)}) for term in BASE]
        fits = data.maker.fit_folds((*known, GravityTilt()))
        np.testing.assert_array_equal(fits.theta[1], value)
        np.testing.assert_array_equal(fits.theta_without_fold[:, 1], value)


def test_known_parameters_are_released_and_bounds_stay():
    fixed = limit_term(Spring(), {"spring.stiffness": (0.1, 0.1), "spring.preload": (0.0, 1.0)})
    assert fixed.list_angle_functions("") == ("one",)
    stiffness, preload = release_term(fixed).columns
    assert not stiffness.is_known and (preload.least, preload.most) == (0.0, 1.0)
    assert release_term(fixed).list_angle_functions("") == ("line", "one")
    assert all(release_term(term) is term for term in BASE)
