"""Logs as they come: torque that is late, turned round or jumps, motion that is short, rests or is struck."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import align, diagnose, identify
from estimators.checks.alignment import TorqueTiming
from estimators.checks.remedies import WrongColumn
from estimators.data.model_errors import compute_errors
from estimators.data.split import add_contacts, make_contact_finder, split_recordings
from estimators.diagnosis.caveats import FewWindows
from estimators.diagnosis.untested import UntestedRange
from estimators.selection.evidence import Evidence
from estimators.weak_form.contacts import count_contacts
from estimators.weak_form.floors import compute_noise_floor
from estimators.weak_form.preparation import prepare_windows
from pendulum_env.physics import BASE, Term, effect
from pendulum_env.recording import Recording
from tests import slow
from tests.cases import BLOW, CASES, DRAG_AND_TILT, THETA, WALLS, diagnosed, make_plain_model, recorded, recording


@pytest.mark.slow
def test_torque_that_jumps_every_sample_is_not_taken_for_noise():
    clean, spoiled = (diagnosed(name) for name in ("jumpy", "jumpy, drag and tilt"))
    assert clean.selected == () and clean.floors[""] < 0.05
    assert set(spoiled.selected) == set(DRAG_AND_TILT)


@pytest.mark.parametrize("name", slow.but_first(["stribeck", "paper's encoder", "filtered noise"]))
def test_torque_that_is_logged_a_sample_late_is_corrected_and_becomes_no_effect(name):
    """As in a log that appends state and torque after each step: the torque has acted by then."""
    good = recording(name)
    late = Recording(good.time[1:], good.position[1:], good.torque[:-1], name="late")
    found = diagnosed([late])
    assert found.selected == tuple(CASES[name].hidden)
    assert found.unexplained == ()
    assert found.alignments[0].delay == pytest.approx(1 / good.rate, rel=0.1)
    assert found.findings[0].is_corrected
    assert any(isinstance(own, TorqueTiming) and own.is_late for own in identify([late], effects_of(name)).findings)
    assert not any(isinstance(own, TorqueTiming) for own in identify([good], effects_of(name)).findings)


@pytest.mark.slow
def test_torque_that_is_late_beside_a_large_effect_is_timed_beside_it():
    """Cogging hides what 2.5 samples do; a motor that follows a reference is logged so by its bus."""
    plant = Plant(effects={"cogging": {"cog_n": 21.0, "cog_s": 0.25}})
    gains = {"excitation": "pd_loop", "gains": (35.0, 1.2)}
    runs = recorded(plant, *(Experiment(1000.0, 10.0, seed=seed, torque_noise=0.01, **gains) for seed in (2, 3)))
    logs = [Recording(r.time[2::2], r.position[2::2], r.torque[:-2:2], name=r.name) for r in runs]  # every other sample
    assert not align(logs[:1]).alignments[0].is_late
    found = diagnosed(logs[:1], logs[1:], only=["cogging", "stribeck"])
    assert found.selected == ("cogging",) and not found.unexplained
    assert found.alignments[0].delay == pytest.approx(0.0025, abs=1e-4)  # 2 ms, and half of what each is held for


@pytest.mark.slow
def test_friction_with_a_state_that_looks_like_late_torque_is_told_from_it():
    runs = [recording(f"bristles {seed}") for seed in (1, 2)]
    assert not align(runs[:1]).alignments[0].is_late  # it explains too little of the residual
    found = diagnosed("bristles 1", "bristles 2")
    assert found.selected == ("presliding",)
    assert not any(one.is_found for one in found.alignments)
    assert not any(isinstance(own, TorqueTiming) for own in found.findings)
    late = [replace(r, time=r.time[8:], position=r.position[8:], torque=r.torque[:-8]) for r in runs]
    assert [one.delay for one in diagnosed(late[:1], late[1:]).alignments] == pytest.approx([0.008] * 2, abs=5e-4)


def effects_of(name: str) -> tuple[Term, ...]:
    return (*BASE, *(effect(id)() for id in CASES[name].hidden))


def test_torque_of_the_other_sign_is_told():
    r = recording("paper's encoder")
    turned = Recording(r.time, r.position, -r.torque, name="turned")
    assert any(isinstance(own, WrongColumn) and own.inertia is not None for own in identify([turned]).findings)
    found = diagnosed([turned])
    assert found.selected == ()
    assert found.unexplained[0].cause.column == "torque"


@pytest.mark.slow
def test_of_a_damped_stop_to_one_side_the_other_side_is_left_open():
    found = diagnosed("lower stop")
    assert found.selected == ("hard_stop",) and "hard_stop.upper" not in found.model.estimates
    truth = {"hard_stop.stiffness": 60.0, "hard_stop.lower": -0.9, "hard_stop.damping_time": 0.3 / 60.0}
    assert {name: found.model.estimates[name].value for name in truth} == pytest.approx(truth, rel=0.03)
    (untested,) = (own for own in found.findings if isinstance(own, UntestedRange))
    assert untested.high.value == pytest.approx(recording("lower stop").position.max(), abs=0.02)


def test_actions_drawn_at_random_raise_no_alarm():
    found = diagnosed("random")
    assert found.selected == found.unexplained == ()
    estimates = found.model.estimates
    assert all(abs(estimates[name].value - truth) < 0.15 * truth for name, truth in THETA.items())


@pytest.mark.slow
def test_stops_that_turn_the_joint_round_within_a_few_samples_are_found():
    found = diagnosed("bouncing")
    assert found.selected == ("hard_stop",)
    stops = found.model.terms[-1].nonlinear_values
    assert (stops["lower"], stops["upper"]) == pytest.approx(WALLS, abs=0.05)
    base, last = found.steps[0].errors["holdout"], found.steps[-1].errors["holdout"]
    assert last.torque_rms < 0.3 * base.torque_rms
    assert last.position_rms < 0.1 * base.position_rms
    (windows,) = prepare_windows([recording("bouncing")]).windows
    floor = compute_noise_floor([windows], 0.03)
    assert found.floors[""] == pytest.approx(floor, rel=0.1)  # however wrong the base model is


@pytest.mark.slow
def test_of_one_blow_that_turns_the_joint_round_nothing_is_learnt():
    struck = recording("struck")
    struck = replace(struck, torque=struck.torque - BLOW)
    prepared = split_recordings([struck])
    assert add_contacts(prepared, BASE) is prepared
    found = diagnosed([struck])
    assert found.selected == ()
    assert found.unexplained
    find_contacts = make_contact_finder(prepared, BASE)
    assert sum(count_contacts(find_contacts(part).data) for part in prepared) == 1  # it was seen


def test_the_ringing_of_a_transmission_is_followed_into_the_end_that_is_held_out():
    """The link swings on for seconds: where a recording is split, the state at the cut is known from before."""
    link = 0.06
    flexibility = effect("joint_flexibility")(resonance=19.0, damping=0.8, gravity=2 / link)
    model = make_plain_model().add(flexibility, link)
    rng, time = np.random.default_rng(0), np.arange(5000) / 500
    torque = 3 * np.sin(12.07 * time + 1) + 3 * np.sin(2.25 * time + 2)
    position = model.simulate(2e-3, torque, 0.0, 0.0).position[:-1, 0]
    noisy = Recording(time, np.round(position, 6), torque + 0.02 * rng.standard_normal(5000), name="ringing")
    train, holdout = split_recordings([noisy])
    assert compute_errors(train, model).torque_rms < 0.05
    assert compute_errors(holdout, model).torque_rms < 0.05
    assert compute_errors(holdout, model).position_rms < 0.01


def test_half_a_second_of_motion_is_diagnosed_with_a_caveat_and_nothing_is_named():
    found = diagnosed("short")
    assert found.selected == ()
    assert any(isinstance(own, FewWindows) for own in found.findings)


def test_a_recording_without_motion_changes_nothing_beside_a_good_one():
    good = recording("filtered noise")
    still = Recording(good.time[:2000], np.zeros(2000), np.full(2000, 0.01), name="still")
    alone, beside = (
        Evidence.from_data(*split_recordings(those)).fits.fit(BASE).model for those in ([good], [still, good])
    )
    assert beside.theta == pytest.approx(alone.theta, rel=1e-6)


def test_a_log_that_is_mostly_at_rest_is_split_where_it_moves():
    moving = recording("moving")
    rest = 3 * len(moving)
    time = np.arange(len(moving) + rest) / moving.rate
    position = np.r_[np.full(rest, moving.position[0]), moving.position]
    train, holdout = split_recordings([Recording(time, position, np.r_[np.zeros(rest), moving.torque], name="rests")])
    whole, _ = split_recordings([moving], [moving])
    assert len(train.data.weights) + len(holdout.data.weights) == pytest.approx(len(whole.data.weights), rel=0.03)
    assert len(holdout.data.weights) == pytest.approx(0.3 * len(whole.data.weights), rel=0.05)


def test_where_windows_are_too_few_to_hold_some_out_shorter_ones_are_taken(monkeypatch):
    brief = recording("brief")
    monkeypatch.setattr("estimators.data.split.choose_half_width", lambda *_: 0.08)
    few = len(prepare_windows([brief], [0.08]).weights)
    train, holdout = split_recordings([brief])
    assert few < 20 and min(len(part.data.weights) for part in (train, holdout)) >= 10


def test_a_given_effect_counts_where_torque_is_timed():
    """Cogging is in the base model: the base of a joint alone would hide the delay of four milliseconds."""
    experiment = Experiment(rate=500.0, seconds=12.0, excitation="multisine", seed=3, counts=65_536)
    run = recorded(Plant(effects={"cogging": {"cog_n": 12, "cog_s": 0.3, "cog_c": 0.0}}), experiment)[0]
    late = replace(run, torque=np.concatenate([np.full(2, run.torque[0]), run.torque[:-2]]))
    found = diagnose(late, base=(*BASE, effect("cogging")(order=12.0)), only=("stribeck",))
    assert found.selected == () and found.alignments[0].delay == pytest.approx(0.004, abs=1e-4)
