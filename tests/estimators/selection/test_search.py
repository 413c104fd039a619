"""The search where its first step misleads, on recordings of a simulator that shares no model code."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import diagnose
from estimators.data.split import split_recordings
from estimators.selection.candidates import find_best_variant, refit_nonlinear, release_parameters
from estimators.selection.evidence import Evidence
from estimators.selection.moves import add_pair
from estimators.selection.path import confirm_steps
from estimators.selection.physical import find_bound_violations
from estimators.selection.policies import CHANGE_FORM
from estimators.selection.search import SearchResult, search
from estimators.selection.state import SearchState
from estimators.selection.tables import add_beside_table
from pendulum_env.physics import BASE, effect
from pendulum_env.physics.terms import list_ids
from tests.cases import recorded

SPOT = {"spot_f": 1.0, "spot_q": 0.3, "spot_w": 0.2}


Effects = dict[str, dict[str, float]]


def two_runs(hidden: Effects, rate: float = 200.0, seconds: float = 10.0, excitation: str = "multisine"):
    """Return a recording to fit and one to hold out of a plant with hidden effects."""
    experiments = (Experiment(rate, seconds, excitation, seed=seed) for seed in (2, 3))
    return recorded(Plant(effects=hidden), *experiments)


def searched(hidden: Effects, *experiment: Any) -> tuple[SearchResult, list[str | None], float]:
    """What was found, what it adds, and the share of the held-out torque error that is left."""
    train, test = two_runs(hidden, *experiment)
    found = search(Evidence.from_data(*split_recordings([train], [test])))
    steps = found.steps
    old, new = (step.errors["holdout"].torque_rms for step in (steps[0], steps[-1]))
    return found, [step.added for step in steps[1:]], new / old


@pytest.mark.slow
def test_an_effect_is_found_that_held_out_data_only_bear_out_beside_another():
    hidden = {"torque_offset": {"offset": -0.4}, "hard_stop": {"wall_hi": 0.9, "wall_k": 60.0}}
    _, found, left = searched(hidden, 500.0)
    assert set(found) == set(hidden) and left < 0.05


def test_two_effects_that_hide_each_other_are_found_together_and_one_alone_has_no_partner():
    """Friction that grows with the load, beside the peak at low speed: each alone leaves most of the other."""
    both = {"load_dependent_friction": {"load_mu": 0.3}, "stribeck": {"strib_d": 0.4, "strib_v": 0.4}}
    library = {id: effect(id) for id in (*both, "quadratic_drag", "torque_offset")}
    for hidden in (both, {"stribeck": both["stribeck"]}):
        train, test = two_runs(hidden, 500.0)
        evidence = Evidence.from_data(*split_recordings([train], [test]), library=library)
        pair = add_pair(SearchState(evidence, BASE, BASE))
        assert pair is None if len(hidden) == 1 else list_ids(pair.effects) == both.keys()


@pytest.mark.slow
def test_play_is_found_beside_what_decides_on_which_side_of_it_the_link_lies():
    play = {"Jm": 0.045, "bl_gap": 0.012, "bl_k": 300.0, "bl_d": 0.8}
    selection, found, left = searched({"backlash": play, "torque_offset": {"offset": 0.25}}, 500.0, 9.0)
    assert found == ["backlash", "torque_offset"] and left < 0.15  # by chance of contacts, 0.05 or 0.11
    told = selection.steps[-1].model.estimates
    assert told["backlash.gap"].value == pytest.approx(0.012, rel=0.05)
    assert told["torque_offset"].value == pytest.approx(-0.25, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "table"),
    [
        ({"friction_spot": SPOT, "torque_offset": {"offset": 0.2}}, "friction_by_angle"),
        ({"random_walk_torque": {"walk_rms": 0.4}, "cogging": {"cog_n": 9.0, "cog_s": 0.2}}, "torque_by_time"),
    ],
)
def test_what_a_table_hides_is_found_beside_it(hidden, table):
    selection, found, _ = searched(hidden)
    assert found == list(hidden)[1:]
    assert selection.table is not None and selection.table.id == table


@pytest.mark.slow
def test_a_motor_whose_gain_fades_is_given_no_name():
    """A battery that empties: the torque at the joint falls short of what is recorded, by more and more."""
    first, second = (
        replace(run, torque=run.torque / (1 - 0.25 * (1 - np.exp(-run.time / 5.0)))) for run in two_runs({}, 200.0, 8.0)
    )
    selection = search(Evidence.from_data(*split_recordings([first], [second])))
    assert [step.added for step in selection.steps] == [None]
    assert selection.table is not None and selection.table.id == "gain_by_time"


@pytest.mark.parametrize(("later", "explained"), [(9.0, (0.9, 1.0)), (14.0, (0.0, 0.05))])
def test_what_explains_one_recording_and_not_the_next_explains_little(later, explained):
    """A tone that shakes the joint, and is another one by the next day."""
    first, second = (
        replace(run, torque=run.torque - 0.5 * np.sin(tone * run.time))
        for run, tone in zip(two_runs({}, 200.0, 8.0), (9.0, later), strict=True)
    )
    evidence = Evidence.from_data(*split_recordings([first], [second]))
    trial = find_best_variant(evidence, BASE, effect("periodic_disturbance"))
    assert trial.fitted_rms < 0.1
    least, most = explained
    assert least <= evidence.shares.compute_of_torque(trial.terms, BASE) <= most


@pytest.mark.slow
def test_a_drive_that_clips_deep_is_named_by_its_limit():
    """A limit of the current at a third of what the controller asks for: no tanh is like that."""
    hidden = {"torque_saturation": {"sat": 3.0, "sat_law": 1.0}}
    selection, found, left = searched(hidden, 250.0, 8.0, "pd_loop")
    assert found == ["torque_saturation"] and left < 0.1
    term = find_best_variant(selection.evidence, selection.evidence.fits.base, effect("torque_saturation")).terms[-1]
    assert term.limit == pytest.approx(3.0, rel=0.05) and term.roundness < 0.5


def knowing(effects: Effects, *library: str) -> Evidence:
    """What there is to fit of a plant, with some effects of the library."""
    recordings = recorded(Plant(effects=effects), Experiment(rate=500.0, seconds=10.0, seed=4))
    return Evidence.from_data(*split_recordings(recordings), library={id: effect(id) for id in library})


@pytest.mark.parametrize(("exponent", "unusual"), [(1.0, True), (2.0, False)])
def test_another_form_refines_an_effect_if_the_effect_has_it(exponent, unusual):
    evidence = knowing(
        {"stribeck": {"strib_d": 0.45, "strib_v": 0.8, "strib_p": exponent}}, "stribeck", "torque_offset"
    )
    usual = refit_nonlinear(evidence, find_best_variant(evidence, BASE, effect("stribeck")).terms)
    (free,) = release_parameters(evidence, usual)
    assert evidence.decide(free, usual, CHANGE_FORM).passed == unusual
    for longer, terms in (((*free, effect("torque_offset")()), usual), (usual, BASE)):  # more than another form
        assert not evidence.decide(longer, terms, CHANGE_FORM).passed


def test_beside_a_table_an_effect_is_named_unless_another_table_predicts_more():
    for hidden, named in (({"quadratic_drag": {"drag": 0.05}}, True), ({"cubic_damping": {"cubic": 0.008}}, False)):
        evidence = knowing(hidden, "quadratic_drag")
        (table,) = (kind for kind in evidence.tables if kind.id == "torque_by_angle")
        terms = find_best_variant(evidence, BASE, table).terms
        found = add_beside_table(SearchState(evidence, BASE, terms)).terms[len(terms) :]
        assert [term.id for term in found] == ["quadratic_drag"] * named
    spare = (*BASE, effect("spring")(), effect("quadratic_drag")())
    evidence = knowing({"quadratic_drag": {"drag": 0.05}}, "quadratic_drag", "spring")
    assert [step.added for step in confirm_steps(SearchState(evidence, BASE, spare))] == [None, "quadratic_drag"]


def test_no_body_has_a_link_of_negative_inertia():
    terms = (*BASE, effect("joint_flexibility")())
    assert not find_bound_violations(terms, np.array([0.09, 2.0, 0.35, 0.8, 0.05]))
    ((column, value),) = find_bound_violations(terms, np.array([0.09, 2.0, 0.35, 0.8, -0.05]))
    assert (column.name, value) == ("joint_flexibility", -0.05)


@pytest.mark.slow
def test_a_law_that_imitates_another_does_not_fit_where_the_joint_moves_otherwise():
    """Cubic damping looks like quadratic drag in each recording alone, with another coefficient in each."""
    slow, fast = (Experiment(rate=250.0, seconds=12.0, seed=seed, scale=scale) for seed, scale in ((2, 0.6), (3, 1.2)))
    model = (*BASE, effect("quadratic_drag")())
    for hidden, right in (({"cubic_damping": {"cubic": 0.006}}, False), ({"quadratic_drag": {"drag": 0.03}}, True)):
        train, test = recorded(Plant(effects=hidden), slow, fast)
        evidence = Evidence.from_data(*split_recordings([train], [test]))
        assert evidence.residuals.is_noise(model) == right
        assert evidence.residuals.is_noise_in(evidence.train, evidence.train.residual(model))


def test_a_short_lag_is_not_exchanged_with_the_time_constant_of_the_joint():
    """A lag of 20 ms before J = 0.02 kg m^2 and b = 0.4 N m s/rad: 50 ms and less inertia fit nearly as well."""
    plant = Plant(0.02, 0.3, 0.4, 0.05, {"actuator_lag": {"lag_T": 0.02}})
    fitted, held_out = recorded(plant, *(Experiment(1000.0, 15.0, "multisine", seed=seed) for seed in (2, 3)))
    model = diagnose(fitted, held_out, only=["actuator_lag"]).model
    assert model["actuator_lag.time_constant"].value == pytest.approx(0.02, rel=0.05)
    assert model["inertia"].value == pytest.approx(0.02, rel=0.05)
