"""Multiple shooting with the link that nobody measures, on recordings of a simulator that shares no model code."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.model_errors import compute_errors
from estimators.data.regression_data import RegressionData
from estimators.data.split import split_recordings
from estimators.selection.evidence import Evidence
from estimators.selection.refits import refit_by_likelihood
from estimators.selection.search import SearchResult
from estimators.simulation.multiple_shooting import compute_state_slopes, estimate, prepare_segments
from estimators.weak_form.point import Point
from pendulum_env.physics import BASE, Model, effect
from pendulum_env.recording import Recording
from tests.cases import recorded

MOTOR, LINK = 0.02, 0.06  # [kg m^2]
GAP, STIFFNESS, DAMPING = 0.015, 400.0, 0.6
BASIC = {"inertia": MOTOR + LINK, "gravity": 2.0, "viscous": 0.35, "coulomb": 0.8}
SHAPE = {"gap": GAP, "resonance": np.sqrt(STIFFNESS / LINK), "damping": DAMPING / LINK, "gravity": 2.0 / LINK}
TRUE = {**BASIC, "backlash": LINK, **{f"backlash.{name}": value for name, value in SHAPE.items()}}


def model(theta: np.ndarray, **shape: float) -> Model:
    return Model.build((*BASE, effect("backlash")(**shape)), theta)


START = model(np.array([0.078, 1.95, 0.34, 0.85, 0.065]), gap=0.012, resonance=65.0, damping=15.0, gravity=31.0)


@pytest.fixture(scope="module")
def loose() -> RegressionData:
    play = {"Jm": MOTOR, "bl_gap": GAP, "bl_k": STIFFNESS, "bl_d": DAMPING}
    experiment = Experiment(rate=1000.0, seconds=6.0, seed=4, torque_noise=0.02, excitation="multisine")
    return RegressionData.from_recordings(recorded(Plant(**BASIC, effects={"backlash": play}), experiment))


@pytest.fixture(scope="module")
def found(loose: RegressionData) -> Model:
    return estimate(loose.data.windows, START)


def test_a_wrong_start_leads_to_the_link_and_its_play(found: Model):
    for name, value in TRUE.items():
        tolerance = 0.1 if name == "backlash.damping" else 0.02
        assert found.estimates[name].value == pytest.approx(value, rel=tolerance), name
        assert 0 < found.estimates[name].std < 0.05 * value, name


def test_an_error_of_rounding_in_the_recording_does_not_change_the_fit(loose: RegressionData, found: Model):
    (recording,) = (windows.recording for windows in loose.data.windows)
    rounded = 1 + 1e-12 * np.random.default_rng(1).standard_normal((2, len(recording)))
    other = Recording(recording.time, recording.position * rounded[0], recording.torque * rounded[1], name="rounded")
    again = estimate(RegressionData.from_recordings([other]).data.windows, START)
    for name, estimated in found.estimates.items():
        assert again.estimates[name].value == pytest.approx(estimated.value, abs=0.25 * estimated.std), name


def test_a_link_that_is_watched_leaves_less_unexplained_than_one_that_is_carried_along(loose: RegressionData):
    true = model(np.array([*BASIC.values(), LINK]), **SHAPE)
    carried, watched = compute_errors(loose, true), compute_errors(loose.with_link_states(true), true)
    assert watched.torque_rms < 0.2 * carried.torque_rms
    assert watched.position_rms < carried.position_rms


def test_a_link_is_watched_behind_a_command_that_is_late_and_in_a_short_part(loose: RegressionData):
    true = model(np.array([*BASIC.values(), LINK]), **SHAPE)
    late = Model.build((*true.terms, effect("dead_time")(dead_time=0.002)), true.theta)
    assert (
        compute_errors(loose.with_link_states(late), late).position_rms
        > 2 * compute_errors(loose.with_link_states(true), true).position_rms
    )
    (recording,) = (windows.recording for windows in loose.data.windows)
    short = Recording(
        *(series[:900] for series in (recording.time, recording.position, recording.torque)), name="short"
    )
    part = RegressionData.from_recordings([short], part=(0.7, 1.0)).with_link_states(true)
    assert np.isfinite(compute_errors(part, true).torque_rms)


ELASTIC = {"Jm": 0.03, "bl_k": 22.0, "bl_d": 0.05}
SWINGING = {**BASIC, "inertia": 0.09, "joint_flexibility": 0.06}
SWINGING |= {"joint_flexibility.resonance": np.sqrt(22.0 / 0.06), "joint_flexibility.damping": 0.05 / 0.06}
SWINGING |= {"joint_flexibility.gravity": 2.0 / 0.06}


@pytest.fixture(scope="module")
def elastic() -> SearchResult:
    """A model with a link that is watched, fitted to windows along its motion."""
    runs = (Experiment(rate=500.0, seconds=9.0, seed=seed, excitation="multisine") for seed in (5, 6))
    train, unseen = recorded(Plant(**BASIC | {"inertia": 0.09}, effects={"joint_flexibility": ELASTIC}), *runs)
    evidence = Evidence.from_data(*split_recordings([train], [unseen]))
    shape = {name.split(".")[1]: value for name, value in SWINGING.items() if "." in name}
    terms = (*BASE, effect("joint_flexibility")(**shape))
    linear = [value for name, value in SWINGING.items() if "." not in name]
    linked = evidence.fits.make_step(Model.build(terms, np.array(linear)), added="joint_flexibility")
    evidence = evidence.with_fits(evidence.fits.with_link(linked))
    return SearchResult(
        evidence, [evidence.fits.fit_with_std(BASE), evidence.fits.fit_with_std(terms, added="joint_flexibility")]
    )


def test_along_the_motion_of_a_link_windows_tell_the_joint_by_itself(elastic: SearchResult):
    found, evidence = elastic.steps[-1].model, elastic.evidence
    for name in BASIC:
        assert 0 < found.estimates[name].std < 0.05 * SWINGING[name], name
    left = evidence.residuals.holdout_residual(elastic.terms)  # which corrects parameters within their uncertainty
    assert np.sqrt(np.mean(left**2)) < 1.01 * elastic.steps[-1].errors["holdout"].torque_rms


def test_what_tells_of_a_link_tells_its_standard_errors(elastic: SearchResult):
    found = refit_by_likelihood(elastic).steps[-1].model
    for name, value in SWINGING.items():
        estimate = found.estimates[name]
        assert 0 < estimate.std < 0.1 * value, name
        assert abs(estimate.value - value) < 4 * estimate.std, name


def test_where_the_link_meets_no_contact_slopes_by_states_are_tangents(elastic: SearchResult):
    """Parameters tell little that other states would not: a secant's error of a percent passes for news of them."""
    point = Point.from_model(elastic.steps[-1].model)
    (shooting,) = prepare_segments(elastic.evidence.train.data.windows, point)
    _, (slopes,) = compute_state_slopes(shooting, [point], shooting.states[None])
    step = 1e-8 * np.eye(4)[:, :, None]
    more, less = (shooting.errors([point], (shooting.states + sign * step)[None])[0] for sign in (1, -1))
    tangents = np.moveaxis(more - less, 0, 2) / 2e-8
    assert np.linalg.norm(slopes - tangents) < 1e-3 * np.linalg.norm(tangents)
