"""Bare motors in a speed loop: the controller answers cogging, and a lag of the torque may fit its answer."""

from math import copysign, sin

import numpy as np
import pytest

from estimators.checks.alignment import Alignment
from estimators.checks.channel import estimate_alignment, estimate_alignments
from estimators.checks.closed_loop import find_feedback, have_one_frequency
from estimators.data.split import split_recordings
from estimators.selection.candidates import find_best_variant
from estimators.selection.evidence import Evidence
from estimators.selection.policies import ADD, DETERMINE_LAG
from estimators.selection.search import search
from estimators.signals.channel import Channel
from pendulum_env.physics import BASE, effect
from pendulum_env.physics.potential import Cogging
from pendulum_env.recording import Recording

INERTIA, VISCOUS, COULOMB = 1e-4, 1.5e-3, 0.01  # [kg m^2], [N m s/rad], [N m]
RATE, STEPS, SECONDS = 500.0, 16, 8.0  # samples, steps of integration and of control in each, length [s]


def record(
    seed: int,
    lag: float,
    cogging: float,
    bandwidth: float,
    wave: str = "square",
    counts: int = 8192,
    order: int = 12,
) -> Recording:
    """Simulate a motor whose speed follows a square wave or sine under a PI controller; the log holds the command."""
    rng = np.random.default_rng(seed)
    frequency, top, step = rng.uniform(0.3, 1.2), rng.uniform(5.0, 8.0), 1.0 / (RATE * STEPS)
    gain, q, v, acting, integral = INERTIA * bandwidth, 0.0, 0.0, 0.0, 0.0
    position, torque = [], []
    for k in range(int(SECONDS * RATE * STEPS)):
        sine = sin(2 * np.pi * frequency * k * step)
        error = top * (copysign(1.0, sine) if wave == "square" else sine) - v
        integral += 0.3 * bandwidth * gain * error * step
        command = gain * error + integral
        acting = acting + (command - acting) * step / lag if lag else command
        if k % STEPS == 0:
            position.append(q)
            torque.append(command)
        push = acting - VISCOUS * v + cogging * (sin(order * q + 1.0) + 0.4 * sin(2 * order * q + 2.0))
        moved, friction = v + step * push / INERTIA, step * COULOMB / INERTIA
        v = moved - min(max(moved, -friction), friction)  # friction stops at zero
        q += step * v
    noise = rng.normal(0.0, 1e-4, len(torque))
    encoder = 2 * np.pi / counts
    time = np.arange(len(torque)) / RATE
    return Recording(time, np.round(np.array(position) / encoder) * encoder, np.array(torque) + noise, name=f"{seed}")


def evaluate(lag: float, cogging: float, bandwidth: float, seed: int) -> Evidence:
    """Return the evidence of two recordings, with both laws of the torque's time as its library."""
    parts = split_recordings(*([record(own, lag, cogging, bandwidth)] for own in (seed, seed + 1)))
    return Evidence.from_data(*parts, library={id: effect(id) for id in ("actuator_lag", "dead_time")})


@pytest.mark.parametrize("seed", [1, 3])
def test_an_answer_to_cogging_is_no_lag(seed):
    evidence = evaluate(0.0, COULOMB, 60.0, seed)
    (gate,) = evidence.decide((*BASE, effect("actuator_lag")(0.02)), BASE, DETERMINE_LAG).gates
    assert not gate.passed  # the torque of the cogging is left
    delayed = find_best_variant(evidence, BASE, effect("dead_time")).terms
    assert evidence.decide(delayed, BASE, ADD).passed  # by its gain
    assert search(evidence).terms == evidence.fits.base


def test_a_lag_in_the_loop_is_found():
    evidence = evaluate(0.02, 0.0, 20.0, 3)
    found = search(evidence)
    assert evidence.residuals.has_feedback
    assert [step.added for step in found.steps] == [None, "actuator_lag"]
    assert found.steps[-1].model.estimates["actuator_lag.time_constant"].value == pytest.approx(0.02, rel=0.1)
    assert found.steps[-1].model.estimates["inertia"].value == pytest.approx(INERTIA, rel=0.1)


def test_torque_of_a_closed_loop_is_timed_where_all_but_noise_is_explained():
    """The controller answers cogging, which smooth laws leave: a free delay fits its answer, by 20 ms and more."""
    recordings = [record(seed, 0.0, COULOMB, 60.0, "sine") for seed in (1, 2)]
    assert find_feedback(recordings) and not have_one_frequency(recordings)
    for beside in ([], [Cogging(12.0, 24.0)]):
        found = estimate_alignment(recordings, beside)
        assert found.is_late and found.delay == pytest.approx(0.5 / RATE, abs=0.25 / RATE)  # set within a sample


def test_an_answer_to_cogging_is_found_with_a_coarse_encoder():
    """Between two samples the motor moves by less than a count, in eight samples by more."""
    assert find_feedback([record(1, 0.0, 0.5 * COULOMB, 40.0, "sine", 1024)])


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_an_answer_to_cogging_under_one_sine_is_no_delay(seed):
    """Alone, a recording of one sine may fit a delay of many samples to the answer, as few columns do."""
    laws = estimate_alignments([record(own, 0.0, 0.6 * COULOMB, 34.0, "sine", 16384, 4) for own in (seed, seed + 1)])
    assert laws[0] == laws[1] and 0.0 <= laws[0].delay < 1.0 / RATE


def test_motion_of_one_frequency_determines_no_lag():
    recording = record(2, 0.01, 0.0, 60.0, "sine")
    assert have_one_frequency([recording]) and not estimate_alignment([recording]).is_found
    evidence = Evidence.from_data(*split_recordings([recording]), library={"actuator_lag": effect("actuator_lag")})
    (gate,) = evidence.decide((*BASE, effect("actuator_lag")(0.02)), BASE, DETERMINE_LAG).gates
    assert gate.name == "frequencies" and not gate.passed
    assert [step.added for step in search(evidence).steps] == [None]


@pytest.mark.parametrize(("lag", "seed"), [(0.012, 7), (0.025, 5)])
def test_an_effect_that_takes_the_place_of_the_inertia_is_no_first_effect(lag, seed):
    """Torque that is timed wrongly leaves a residual, of which a saturation explains more by a fraction of the inertia.

    The correction of a lag that one of two logs does not have turns steps of the torque into spikes.
    """
    wrong, right = (record(own, 0.0, 0.0, 60.0, "square", 4096) for own in (seed, seed + 1))
    moved = Alignment(Channel(0.0, lag, False), 1e-4, 1e-4).apply(wrong)
    library = {"torque_saturation": effect("torque_saturation")}
    found = search(Evidence.from_data(*split_recordings([moved, right]), library=library))
    assert found.steps[-1].added is None and not found.evidence.residuals.is_noise(found.terms)
