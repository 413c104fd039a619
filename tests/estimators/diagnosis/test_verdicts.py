"""Verdicts: what is hidden is named and measured, what is not there is not, and what nothing explains is said."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import Diagnosis, diagnose, identify
from estimators.checks.remedies import WrongColumn
from estimators.checks.signs import NegativeParameters
from estimators.decisions.criterion import Criterion
from estimators.diagnosis.experiment import UnreachableAims
from estimators.diagnosis.ranking import Tie
from estimators.diagnosis.suggestion import Aim
from pendulum_env.physics import BASE, effects, library, register
from pendulum_env.recording import Recording
from tests import slow
from tests.cases import (
    CASES,
    NULLS_TRIED,
    PAIR,
    SINGLES,
    SINGLES_TRIED,
    THETA,
    TRANSMISSIONS,
    TWINS,
    diagnosed,
    recorded,
    recording,
)
from tests.motions import record_motion
from tests.terms import CubicDamping


@pytest.mark.parametrize("name", NULLS_TRIED)
def test_where_nothing_is_hidden_nothing_is_selected(name):
    found = diagnosed(name)
    assert found.selected == found.ambiguous == found.unexplained == found.model.effects == ()
    assert {c.verdict for c in found.candidates} <= {"rejected", "not_excited"}


@pytest.mark.parametrize("name", [*SINGLES_TRIED, *PAIR])
def test_what_is_hidden_is_named_alone_and_measured_and_without_it_the_pendulum_itself_is_biased(name):
    found, case = diagnosed(name), CASES[name]
    assert sorted(found.selected) == sorted(case.hidden) and found.unexplained == ()
    best = found.candidates[: len(case.hidden)]
    assert {one.effect for one in best} == set(case.hidden)
    assert all(one.verdict == "selected" and one.error_ratio < 1 / 1.5 for one in best)
    for parameter, truth in (THETA | case.found).items():
        estimate = found.model.estimates[parameter]
        assert abs(estimate.value - truth) < 5 * estimate.std + 0.01 * abs(truth), parameter
        assert estimate.std < 0.03 * abs(truth), parameter
    without, known = found.steps[0].model.estimates, found.model.estimates
    assert max(abs(without[own].value - truth) / known[own].std for own, truth in THETA.items()) > 5
    assert_errors_fall(found)


def assert_errors_fall(found: Diagnosis) -> None:
    """Assert that both held-out errors fall with each step, to the noise."""
    for part in ("train", "holdout"):
        for error in ("torque_rms", "position_rms"):
            course = [getattr(step.errors[part], error) for step in found.steps]
            assert course[-1] < course[0] / 1.5
            assert part == "train" or course == sorted(course, reverse=True)
    assert found.steps[-1].errors["holdout"].torque_rms < 2 * found.floors[""]


FEW = (*TRANSMISSIONS, "stribeck")  # a search among them is quick


@pytest.mark.parametrize(("name", "only"), slow.but_first([("backlash", FEW), *((id, None) for id in TRANSMISSIONS)]))
def test_a_hidden_transmission_is_named_alone_and_errors_fall(name, only):
    found = diagnosed(name, only=only)
    assert found.selected == (name,)
    first, last = (step.errors["holdout"] for step in found.steps)
    assert last.torque_rms < first.torque_rms / 3 and last.position_rms < first.position_rms / 3


def test_every_effect_of_the_library_is_told_when_hidden():
    assert effects().keys() == SINGLES.keys() | TRANSMISSIONS.keys() | TWINS.keys()


@pytest.mark.parametrize("name", slow.but_first(TWINS))
def test_an_offset_and_an_asymmetry_of_dry_friction_are_reported_together(name):
    found = diagnosed(name)
    assert_errors_fall(found)
    assert len(found.selected) == 1
    (group,) = found.ambiguous
    assert set(group) == set(TWINS)
    verdicts = {c.effect: c.verdict for c in found.candidates}
    assert sorted(verdicts[id] for id in TWINS) == ["ambiguous", "selected"]
    assert Tie(group) in found.findings
    assert found.no_experiment == UnreachableAims((Aim(*reversed(group)),)) and found.suggestion is None  # by no torque
    (added,) = [estimate for id, estimate in found.model.estimates.items() if id in TWINS]
    assert abs(added.value) == pytest.approx(0.2, abs=5 * added.std + 0.002)


@pytest.mark.parametrize(("name", "axis"), slow.but_first([("knocks", "time"), ("cubic_damping", "velocity")]))
def test_what_no_effect_of_the_library_explains_is_reported_with_its_place_and_forced_into_none(name, axis):
    found = diagnosed(name)
    assert found.selected == () and axis in {region.axis for region in found.unexplained}
    assert found.suggestion is None  # no experiment would name it
    assert found.steps[-1].errors["holdout"].torque_rms > 2 * found.floors[""]


@pytest.mark.slow
def test_gears_that_are_also_pressed_by_the_weight_are_load_dependent():
    found = diagnosed(["gears 41", "gears 42"], "gears 43")
    assert set(found.selected) == {"load_dependent_friction", "stribeck"}
    estimates = found.model.estimates
    assert estimates["load_dependent_friction"].value == pytest.approx(0.1, rel=0.2)
    assert estimates["load_dependent_friction.output"].value == pytest.approx(0.1, rel=0.3)


@pytest.mark.slow
def test_torque_is_not_explained_by_torque():
    """In creep |tau + w sin q| sgn q' may be the torque itself: gears that eat it all would explain everything."""
    found = diagnosed("creep")
    assert "load_dependent_friction" not in {*found.selected, *(id for group in found.ambiguous for id in group)}


@pytest.mark.slow
def test_torque_of_one_size_does_not_show_saturation():
    """A law that scales it only changes units, and flattens its noise, which must not count as an explanation."""
    found = diagnosed("two levels")
    assert found.selected == ()
    assert found.model.estimates["inertia"].value == pytest.approx(0.0895, rel=0.02)


@pytest.mark.slow
def test_a_lag_as_short_as_a_sample_is_never_taken_for_a_delay_without_a_word():
    found = diagnosed("short lag")
    assert len(found.selected) == 1
    assert "actuator_lag" in found.selected or ("dead_time", "actuator_lag") in found.ambiguous
    if "actuator_lag" in found.selected:
        assert found.model.estimates["actuator_lag.time_constant"].value == pytest.approx(0.002, rel=0.05)


def test_a_users_own_effect_is_found_like_any_other(monkeypatch):
    monkeypatch.setattr(library, "_registered", {})

    register(CubicDamping)
    found = diagnose([recording("cubic_damping")])
    assert found.selected == ("cubic_damping",) and found.unexplained == ()
    assert found.model.estimates["cubic_damping"].value == pytest.approx(0.01, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "reach"), [(0.7, 0.8), (0.35, 0.3)])
def test_a_wide_swing_that_was_held_out_tells_a_spring_from_an_offset(scale, reach):
    """In small swings they look the same; in very small ones no wide swing is predicted well, and both are told."""
    narrow, wide = recording(f"scale {scale}"), recording("wide")
    assert np.ptp(narrow.position) < reach
    assert np.ptp(wide.position) > 2.0
    found = diagnosed(f"scale {scale}", "wide")
    if scale < 0.7:
        open_effects = {id for own in found.findings for id in (*(own.rivals or ()), *getattr(own, "effects", ()))}
        assert "spring" in open_effects or found.suggestion is not None
        assert found.unexplained  # in what was held out
    else:
        assert found.selected == ("spring",)
    assert "spring" not in diagnosed(f"scale {scale}").selected


@pytest.mark.slow
def test_a_lag_is_named_where_the_torque_is_switched_and_its_log_has_no_noise():
    """What a lag leaves at the switches is no noise of the log, however like it looks."""
    usual = {"rate": 250.0, "seconds": 10.0, "counts": 65_536, "torque_noise": 0.0}
    experiments = (Experiment(excitation=kind, seed=k, **usual) for k, kind in enumerate(("steps", "prbs")))
    found = diagnosed(recorded(Plant(effects={"actuator_lag": {"lag_T": 0.012}}), *experiments))
    assert found.selected == ("actuator_lag",) and found.unexplained == ()
    lag = found.model.estimates["actuator_lag.time_constant"]
    assert lag.value == pytest.approx(0.012, abs=max(5 * lag.std, 2e-4))


def test_what_predicts_most_of_it_is_named_though_the_residual_passes_for_noise():
    """Prediction of other data speaks louder than a test of noise, which has to know how large that is."""
    blind = Criterion(z_score=1e9, misfit_ratio=1e9)
    assert diagnosed("stribeck", criterion=blind).selected == ("stribeck",)
    assert diagnosed("paper's encoder", criterion=blind).selected == ()


def test_a_spring_that_hardens_is_one_and_gravity_stays_what_it_is():
    """A cable gets stiffer as it winds: a straight spring, less a gravity that pulls up, imitates it."""
    cable = record_motion(lambda q, v: 0.5 * q**3 + 0.1 * v)
    found = diagnosed(cable, only=["spring", "stribeck", "hard_stop", "cogging"])
    assert found.selected == ("spring",) and not found.unexplained
    for name, true in (("spring.cubic", 0.5), ("gravity", 2.0), ("inertia", 0.09)):
        own = found.model.estimates[name]
        assert abs(own.value - true) < 4 * own.std < 0.02 * true
    assert found.model.estimates["spring.stiffness"].value == 0.0
    findings = identify([cable], [*BASE, "spring"], "energy").findings
    assert NegativeParameters(("gravity", "spring.stiffness")) in findings
    assert not any(isinstance(finding, WrongColumn) for finding in findings)


def test_friction_that_bends_down_over_speed_is_no_drag():
    found = diagnosed(record_motion(lambda q, v: 0.2 * np.arcsinh(v / 0.4)), only=["quadratic_drag"])
    assert found.selected == () and found.unexplained


def test_friction_that_drives_is_said_of_what_is_found():
    found = diagnosed(record_motion(lambda q, v: 0.3 * np.sign(v) * np.exp(-np.abs(v / 1.5))), only=["gravity_tilt"])
    viscous = found.model.estimates["viscous"]
    assert viscous.value == 0 and viscous.at_bound  # no body has less, and the data ask for it
    assert NegativeParameters(("viscous",)) in found.findings


def test_clipped_torque_at_a_low_rate_leaves_noise_and_no_delay():
    """A clip has no slope by the torque, and delays none: errors stay finite, and the log is in time."""
    plant = Plant(effects={"torque_saturation": {"sat": 3.0, "sat_law": 1.0}})
    runs = recorded(plant, Experiment(rate=500.0, seconds=12.0, seed=3))
    found = diagnose(runs, only=["torque_saturation", "actuator_lag", "dead_time"])
    assert found.selected == ("torque_saturation",) and found.unexplained == ()
    assert not found.data.timing.has_moved
    for name, truth in (THETA | {"torque_saturation.limit": 3.0}).items():
        estimate = found.model.estimates[name]
        assert abs(estimate.value - truth) < 4 * estimate.std, name


@pytest.mark.parametrize("lead", [1.0, 1e-3])  # [m/rad], of the screw that a joint turns
def test_a_joint_that_slides_in_millimetres_has_the_friction_of_the_screw_that_drives_it(lead):
    hidden = {"stribeck": {"strib_d": 0.3, "strib_v": 0.4}}
    plant = Plant(0.02, gravity=0.0, viscous=0.05, coulomb=0.5, effects=hidden)
    (run,) = recorded(plant, Experiment(counts=100_000, torque_noise=2e-3, scale=0.5))
    slide = Recording(run.time, lead * run.position, run.torque / lead, name="slide")
    found = diagnosed([slide], only=["stribeck", "quadratic_drag", "viscous_asymmetry"])
    assert found.selected == ("stribeck",) and not found.unexplained
    estimates = found.model.estimates
    assert estimates["stribeck.stribeck_velocity"].value == pytest.approx(0.4 * lead, rel=0.05)
    assert estimates["coulomb"].value == pytest.approx(0.5 / lead, rel=0.02)
