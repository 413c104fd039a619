"""Moves of the search, on a plant with air drag that another simulator made: each goes towards it and none away."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.data.split import split_recordings
from estimators.data.variants import refine_variants
from estimators.diagnosis.ranking import compute_alternatives, rank_effects
from estimators.diagnosis.untested import UntestedRange
from estimators.selection.candidates import find_best_variant
from estimators.selection.evidence import Evidence
from estimators.selection.links import leave_limits
from estimators.selection.policies import ADD, EXCITE, NEED, SWAP
from estimators.selection.search import search
from estimators.selection.state import SearchState
from pendulum_env.physics import BASE, effect
from pendulum_env.recording import Recording
from tests.cases import recorded
from tests.motions import record_motion

EFFECTS = ("quadratic_drag", "spring", "viscous_asymmetry", "torque_offset")
DRAG, SPRING, ASYMMETRY, OFFSET = (effect(id)() for id in EFFECTS)
RIGHT = (*BASE, DRAG)


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    plant = Plant(effects={"quadratic_drag": {"drag": 0.05}})
    recordings = recorded(plant, Experiment(rate=500.0, seconds=10.0, seed=4))
    return Evidence.from_data(*split_recordings(recordings), library={id: effect(id) for id in EFFECTS})


def test_nothing_else_is_possible_in_its_place(evidence):
    odds = compute_alternatives(evidence, RIGHT, DRAG)
    assert odds["quadratic_drag"] > 0.99 and sum(odds.values()) == pytest.approx(1.0)


def test_each_recording_has_weights_of_its_own_be_it_fitted_or_held_out(evidence):
    recording = evidence.train.recordings[0]
    apart = Evidence.from_data(*split_recordings([recording], [replace(recording, name="another")]))
    assert len(set(apart.densities.bootstrap.of_block.tolist())) == 2
    assert len(set(evidence.densities.bootstrap.of_block.tolist())) == 1  # the end of one recording is no other


def test_a_straight_spring_that_turns_gravity_round_gives_way_to_one_that_hardens():
    """Where the swing is small both fit alike, and only one of them leaves the weight what it is."""
    run = record_motion(lambda q, v: 0.1 * v + 0.5 * q**3, size=0.8)
    evidence = Evidence.from_data(*split_recordings([run]), library={"spring": effect("spring")})
    straight, hardening = (trial.terms for trial in refine_variants(evidence.train, BASE, effect("spring")))
    assert (
        evidence.fits.fit_model(straight).estimates["gravity"].value < 0
        and not evidence.decide(hardening, straight, SWAP).passed
    )
    assert find_best_variant(evidence, BASE, effect("spring")).terms == hardening
    assert evidence.fits.fit_model(hardening).estimates["gravity"].value == pytest.approx(2.0, rel=0.01)


def test_a_long_lag_with_hardly_any_inertia_imitates_an_inertia_behind_a_short_lag():
    """J v' + b v behind 1 / (1 + T s) is b T v' + b v behind 1 / (1 + J/b s): inertia and its noise tell them apart."""
    inertia, viscous, coulomb, lag = 3e-4, 2e-3, 0.01, 2e-3
    time, rates, sizes = np.arange(0.0, 20.0, 0.005), np.array([2.1, 5.3, 17.0]), np.array([12.0, 7.0, 1.5])
    position = 30 * time - np.cos(np.outer(time, rates)) @ (sizes / rates)
    wave = np.outer(time + 0.0025, rates)  # in the middle of each step, as torque is held
    v, a = 30 + np.sin(wave) @ sizes, np.cos(wave) @ (sizes * rates)
    jerk = -np.sin(wave) @ (sizes * rates**2)
    torque = inertia * a + viscous * v + coulomb + lag * (inertia * jerk + viscous * a)
    torque += 1e-4 * np.random.default_rng(1).standard_normal(len(time))
    evidence = Evidence.from_data(*split_recordings([Recording(time, position, torque, name="motor")]))
    short, long = ((*BASE, effect("actuator_lag")(own)) for own in (lag, inertia / viscous))
    assert evidence.fits.fit_model(short).estimates["inertia"].value == pytest.approx(inertia, rel=0.02)
    assert evidence.fits.fit_model(long).estimates["inertia"].value == pytest.approx(viscous * lag, rel=0.3)
    assert evidence.decide(short, BASE, ADD).passed
    assert not evidence.decide(long, BASE, ADD).passed


def test_an_effect_is_excited_by_the_torque_over_the_least_that_three_standard_errors_show(evidence):
    """The coefficient of a constant torque is that torque."""
    (gate,) = evidence.decide((*RIGHT, OFFSET), RIGHT, EXCITE).gates
    offset = evidence.fits.fit_with_std((*RIGHT, OFFSET)).model.estimates["torque_offset"]
    recorded_rms = float(np.sqrt(np.mean(evidence.train.data.torque.applied**2)))
    assert recorded_rms / gate.value == pytest.approx(3 * offset.std, rel=0.3)
    assert gate.passed == (gate.value > gate.limit == evidence.criterion.least_excitation)


def test_two_periods_of_an_encoder_error_in_a_turn_are_named_and_no_cogging_beside_them():
    (run,) = simulate([(Plant(), Experiment(rate=500.0, seconds=10.0, seed=5))])
    reading = run.exact_position + 0.02 * np.sin(2 * run.exact_position + 0.7)
    library = {
        id: effect(id) for id in ("encoder_eccentricity", "cogging", "gravity_tilt", "position_dependent_friction")
    }
    parts = split_recordings([Recording(run.time, reading, run.torque, name="tilted disc")])
    found = search(Evidence.from_data(*parts, library=library))
    assert [step.added for step in found.steps] == [None, "encoder_eccentricity"]
    estimates = found.steps[-1].model.estimates
    assert estimates["encoder_eccentricity.order"].value == 2.0
    assert estimates["encoder_eccentricity.sin"].value == pytest.approx(0.02 * np.cos(0.7), abs=5e-4)
    assert estimates["encoder_eccentricity.cos"].value == pytest.approx(0.02 * np.sin(0.7), abs=5e-4)


def test_an_end_of_the_range_where_contacts_were_seen_was_tested(evidence):
    (recording,) = evidence.train.recordings
    found = search(Evidence.from_data(*split_recordings([recording]), library={"hard_stop": effect("hard_stop")}))
    ((unmet,), _), ((met,), _) = (rank_effects(found, found.terms, has_contacts=own) for own in (False, True))
    assert isinstance(unmet.reason, UntestedRange)
    assert not isinstance(met.reason, UntestedRange) and not met.decision.passed


def make_run_at_constant_speed(seed: int) -> Recording:
    """Return a motion that accelerates for 10 s, then runs at constant speed; torque is exact, its encoder coarse."""
    rng, period = np.random.default_rng(seed), 0.005
    time = period * np.arange(5000)
    wave = sum(np.sin(2 * np.pi * rate * time + rng.uniform(0, 6)) for rate in rng.uniform(0.3, 2.0, 4))
    v = 3.0 + 0.6 * np.clip(11.0 - time, 0, 1) * np.asarray(wave)
    q = np.append(0.0, np.cumsum(period * (v[1:] + v[:-1]) / 2))
    torque = 0.02 * np.append(np.diff(v), 0.0) / period + 0.01 * (v + np.append(v[1:], v[-1])) / 2 + 0.05
    count = 2 * np.pi / 16384
    return Recording(time, count * np.round(q / count + 0.2 * rng.standard_normal(len(q))), torque, name=f"run {seed}")


def test_a_payload_of_minus_the_inertia_gains_nothing_by_removing_the_encoders_noise():
    evidence = Evidence.from_data(*split_recordings([make_run_at_constant_speed(1)], [make_run_at_constant_speed(2)]))
    lost = (*BASE, effect("payload_change")(16.0))
    inertia, change = (
        evidence.fits.fit_model(lost).estimates[name].value for name in ("inertia", "payload_change.inertia")
    )
    assert inertia == pytest.approx(0.02, rel=0.01) and change < -0.8 * inertia
    assert not evidence.decide(lost, BASE, SWAP).passed


def test_a_play_without_a_gap_is_an_elastic_joint():
    elastic = {"Jm": 0.03, "bl_k": 60.0, "bl_d": 0.12}
    runs = recorded(Plant(effects={"joint_flexibility": elastic}), Experiment(rate=500.0, seconds=8.0, seed=6))
    evidence = Evidence.from_data(*split_recordings(runs))
    state = SearchState(evidence, BASE, BASE)
    for gap, link in ((1e-4, "joint_flexibility"), (1e-2, "backlash")):
        found = leave_limits(state, state.with_terms((*BASE, effect("backlash")(gap, 31.6, 2.0, 33.0))))
        assert found.terms[-1].id == link


def test_an_effect_beside_an_unexplained_rest_explains_most_of_the_torque_not_of_the_motion():
    """Two tones through a drive with a dead zone make a slow third: most of the motion error, not of torque."""
    time = np.arange(15_000) / 500.0
    requested = 0.7 * np.sin(2 * np.pi * 0.35 * time + 1.0) + 0.5 * np.sin(2 * np.pi * 1.7 * time + 2.0)
    applied = np.sign(requested) * np.maximum(np.abs(requested) - 0.08, 0.0)
    experiment = Experiment(rate=500.0, seconds=30.0, seed=1, counts=32_768)
    (run,) = recorded(Plant(0.03, 0.8, 0.05, 0.08), experiment, commands=[applied])
    noise = 0.004 * np.random.default_rng(1).standard_normal(len(time))
    evidence = Evidence.from_data(*split_recordings([replace(run, torque=requested + noise)]))
    trial = find_best_variant(evidence, BASE, effect("periodic_disturbance"))
    assert trial is not None
    terms, limit = trial.terms, evidence.criterion.needed_share
    assert terms[-1].nonlinear_values["frequency"] == pytest.approx(2 * np.pi, abs=0.05)
    assert not evidence.residuals.is_noise(terms) and min(evidence.motion.compute_shares(terms, BASE)) > limit
    assert evidence.decide(terms, BASE, ADD).passed and not evidence.decide(terms, BASE, NEED).passed
