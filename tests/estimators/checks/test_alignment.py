"""Time between torque and motion: what a log does to torque is found, and no physics is taken for it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from benchmarks.independent_plant import Experiment, Plant, random_case
from estimators.checks.alignment import NO_ALIGNMENT, Alignment, TorqueTiming
from estimators.checks.channel import estimate_alignment, estimate_alignments, predict_log
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.data.timing import Timing
from estimators.decisions.criterion import Criterion
from estimators.signals.channel import Channel
from estimators.signals.differentiation import has_white_noise
from pendulum_env.physics import BASE
from pendulum_env.physics.actuation import ActuatorLag, DeadTime, TorqueSaturation
from pendulum_env.physics.library import effect
from pendulum_env.recording import Recording, read_recording
from robots.arms import arm_base
from tests import slow
from tests.cases import TRUTH, recorded
from tests.notes import list_notes
from tests.two_link import body
from tests.two_link import record_arm as arm_recorded

KINDS = ("two_tone", "multisine", "chirp", "prbs", "steps")


def run(excitation: str, rate: float, seed: int = 3, **effects: dict[str, float]) -> Recording:
    """12 s of a plant with hidden effects, with a usual encoder and noise on the torque."""
    experiment = Experiment(rate=rate, seconds=12.0, excitation=excitation, seed=seed, counts=65_536)
    return recorded(Plant(effects=effects), experiment)[0]


def logged_late(recording: Recording, samples: int) -> Recording:
    torque = np.concatenate([np.full(samples, recording.torque[0]), recording.torque[: len(recording) - samples]])
    return replace(recording, torque=torque)


def logged_filtered(recording: Recording, time_constant: float) -> Recording:
    keep = np.exp(-1 / (recording.rate * time_constant))
    return replace(recording, torque=lfilter([1 - keep], [1, -keep], recording.torque))


LATE = [*zip(KINDS, (1, 5, 10, 30, 3), strict=True), ("multisine", 60), ("chirp", 150), ("steps", 100)]


@pytest.mark.parametrize(("excitation", "samples"), slow.but_first(LATE))
def test_torque_that_is_logged_late_is_found_to_a_fifth_of_a_sample(excitation, samples):
    found = estimate_alignment([logged_late(run(excitation, 1000.0), samples)])
    assert found.is_late
    assert found.lag == 0
    assert found.delay == pytest.approx(1e-3 * samples, abs=2e-4)
    assert 0 < found.delay_std < 1e-4
    assert found.finding.is_late and found.finding.delay.value == found.delay


@pytest.mark.parametrize("rate", [100.0, 130.0])
def test_an_encoder_slower_than_its_log_is_no_delay_and_biases_nothing(rate):
    clean = run("multisine", 500.0)
    sampled = np.floor(clean.time * rate + 1e-9) / rate  # known only in rows: the encoder reads between them
    held = CubicSpline(clean.time, clean.position)(sampled)
    recording = read_recording({"time": clean.time, "position": held, "torque": clean.torque})
    assert recording.rate == pytest.approx(rate, rel=1e-5)
    assert not estimate_alignment([recording]).is_late
    model, _ = fit_terms(RegressionData.from_recordings([recording]), BASE)
    for estimate, true in zip(model.estimates.values(), TRUTH, strict=True):
        assert abs(estimate.value - true) < 3 * estimate.std


@pytest.mark.parametrize("time_constant", [0.003, 0.01])
def test_torque_that_is_logged_through_a_filter_is_found_where_it_steps(time_constant):
    found = estimate_alignment([logged_filtered(run("prbs", 1000.0), time_constant)])
    assert found.is_late
    assert found.delay == 0
    assert found.lag == pytest.approx(time_constant, rel=0.05)
    assert found.finding.delay is None and found.finding.lag is not None


def add_noise(recording: Recording, std: float) -> Recording:
    noise = std * np.random.default_rng(0).standard_normal(len(recording))
    return replace(recording, torque=recording.torque + noise)


def test_slow_torque_does_not_tell_a_filter_from_a_delay_and_both_are_said():
    experiment = Experiment(rate=1000.0, seconds=12.0, seed=3, counts=65_536, torque_noise=0.0)
    filtered = add_noise(logged_filtered(recorded(Plant(), experiment)[0], 0.003), 0.02)
    finding = estimate_alignment([filtered]).finding
    assert finding.rival_lag.value == pytest.approx(0.003, abs=2e-4)
    assert finding.delay.value == pytest.approx(0.0025, abs=2e-4)  # of the filter, from sample to sample


def test_the_noise_of_slow_torque_tells_that_a_filter_has_passed_it():
    filtered = logged_filtered(run("two_tone", 1000.0), 0.003)  # with its noise
    found = estimate_alignment([filtered])
    assert found.lag == pytest.approx(0.003, abs=1e-4)
    assert not found.rival_lag
    data = RegressionData.from_recordings([found.apply(filtered)])
    residual = fit_terms(data, BASE)[1].residual
    floor = data.data.windows[0].noise.compute_std(TRUTH[0])
    assert float(np.sqrt(np.mean(residual**2))) == pytest.approx(floor, rel=0.1)


@pytest.mark.parametrize(("excitation", "rate"), [("two_tone", 100.0), ("two_tone", 1000.0), ("prbs", 1000.0)])
def test_white_noise_is_told_from_noise_that_an_inverse_filter_amplified(excitation, rate):
    experiment = Experiment(rate=rate, seconds=20.0, excitation=excitation, seed=3, torque_noise=0.0)
    clean, law = recorded(Plant(), experiment)[0].torque, Channel(lag=3 / rate)
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(clean))
    response = law.remove_filter(np.eye(1, 201, 100)[0], 1 / rate)
    amplified = law.remove_filter(noise, 1 / rate)
    assert not has_white_noise(clean + amplified, response)
    assert has_white_noise(clean + noise, response) or rate == 100.0  # where the torque changes as fast as noise
    smoothing = np.array([0.25, 0.5, 0.25])
    assert has_white_noise(noise, smoothing) and not has_white_noise(np.convolve(noise, smoothing), smoothing)


def test_a_resting_recording_has_no_windows_and_takes_part(recording_at_rest):
    late = [logged_late(run("multisine", 500.0, seed), 5) for seed in (3, 4)]
    found = estimate_alignment([*late, recording_at_rest])
    assert found.delay == pytest.approx(0.01, abs=4e-4)


@pytest.fixture
def recording_at_rest() -> Recording:
    time = np.arange(2000) / 500.0
    torque = 0.1 * np.random.default_rng(0).standard_normal(len(time))
    return read_recording({"time": time, "position": 1e-3 * (time > 2.0), "torque": torque})


def test_a_dead_time_beside_a_correction_is_the_excess_of_its_delay():
    late = replace(estimate_alignment([logged_late(run("multisine", 500.0), 5)]), delay_std=1e-4)
    timing = Timing((late,), ("run",)).reduce_delays("", 0.004, 2e-4)
    (shorter,) = timing.alignments
    assert shorter.delay == pytest.approx(late.delay - 0.004)
    assert shorter.delay_std == 2e-4
    assert not timing.alignments[0].beats(NO_ALIGNMENT)  # other windows cannot be compared


def run_relay(rate: float = 200.0, substeps: int = 50) -> Recording:
    """8 s of a joint without gravity under a constant torque that changes its sign, by implicit steps of friction."""
    inertia, viscous, coulomb, step = 0.016, 0.08, 0.26, 1.0 / (rate * substeps)
    torque = 0.42 * (-1.0) ** np.floor(np.arange(8 * rate) / (0.1 * rate))
    position, velocity, positions = 0.0, 0.0, []
    for command in torque:
        positions.append(position)
        for _ in range(substeps):
            free = velocity + step / inertia * (command - viscous * velocity)
            velocity = np.sign(free) * max(abs(free) - step * coulomb / inertia, 0.0)
            position += step * velocity
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(torque))
    return read_recording({"time": np.arange(len(torque)) / rate, "position": positions, "torque": torque + noise})


def test_square_torque_that_switches_at_reversals_is_found_late():
    late = logged_late(run_relay(), 1)
    found = estimate_alignment([late], is_model=True)  # friction would explain torque of half a period earlier
    assert found.delay == pytest.approx(5e-3, abs=5e-4)


def test_a_delay_of_one_joint_is_not_that_of_all():
    recording = arm_recorded(seconds=6.0, rate=250.0)
    torque = recording.torque.copy()
    torque[3:, 0] = recording.torque[:-3, 0]
    found = estimate_alignment([replace(recording, torque=torque)], list(arm_base(body())))
    assert found.joint == recording.names[0]
    assert found.delay == pytest.approx(3 / 250.0, abs=1e-3)


def test_a_delay_and_a_filter_are_found_together():
    found = estimate_alignment([logged_filtered(logged_late(run("prbs", 1000.0), 5), 0.01)])
    assert found.delay == pytest.approx(0.005, abs=5e-4)
    assert found.lag == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize("excitation", slow.but_first(["pd_loop", *KINDS]))
def test_torque_in_time_is_left_alone(excitation):
    recording = run(excitation, 500.0)
    found = estimate_alignment([recording])
    assert not found.is_found
    assert found.finding is None
    assert found.delay_std < 2e-4
    assert found.apply(recording) is recording


@pytest.mark.parametrize(("plant", "few"), [("pendulum", 0.08), ("arm", 0.05)])
def test_a_delay_below_a_tenth_of_a_sample_is_none_and_one_of_more_is_corrected(plant, few):
    if plant == "arm":
        recording, beside = arm_recorded(seconds=6.0, rate=250.0), list(arm_base(body()))
    else:
        recording, beside = run("multisine", 250.0), []
    motion = CubicSpline(recording.time, recording.position)
    on_time, early, late = (
        replace(recording, position=motion(recording.time + share / recording.rate)) for share in (0.0, few, 0.6)
    )
    for one in (on_time, early):
        found = estimate_alignment([one], beside)
        assert not found.is_found and found.finding is None and found.apply(one) is one
    found = estimate_alignment([late], beside)
    assert found.is_late and found.finding is not None
    assert found.delay == pytest.approx(0.6 / 250.0, abs=0.02 / 250.0)
    assert found.apply(late) is not late


@pytest.mark.parametrize("share", [0.15, 0.2])
def test_held_torque_that_is_late_by_less_than_a_controller_makes_it_was_not_sampled(share):
    arm = arm_recorded(seconds=6.0, rate=250.0)
    found = estimate_alignment(
        [replace(arm, position=CubicSpline(arm.time, arm.position)(arm.time + share / 250.0))], arm_base(body())
    )
    assert (
        found.finding.is_late
        and not found.finding.is_sampled
        and found.delay == pytest.approx(share / 250.0, abs=0.05 / 250.0)
    )


@pytest.mark.parametrize(
    "effect",
    slow.but(
        ["encoder_eccentricity", "load_dependent_friction"],
        ["joint_flexibility", "presliding", "encoder_eccentricity", "load_dependent_friction"],
    ),
)
def test_no_effect_of_the_plant_makes_torque_look_logged_late(effect):
    rng = np.random.default_rng(12)
    cases = [random_case(rng, (effect,), excitation=kind, rate=500.0, seconds=8.0) for kind in ("two_tone", "steps")]
    assert not any(estimate_alignment(recorded(case.plant, case.train)).is_late for case in cases)


def test_a_drive_with_a_dead_time_is_the_law_of_a_log_that_is_ahead_and_both_are_named():
    recording = run("multisine", 1000.0, dead_time={"dead_n": 12.0})
    found = estimate_alignment([recording])
    assert found.is_found
    assert not found.is_late
    assert found.delay == pytest.approx(-0.012, abs=2e-4)
    assert not found.finding.is_late
    assert found.apply(recording) is recording  # the drive is part of the plant


def test_torque_that_is_late_is_timed_beside_friction_that_it_presses():
    """As friction follows the torque, the log that has one late has the other late as well."""
    rubs, term = run("pd_loop", 500.0, load_dependent_friction={"load_mu": 0.3}), effect("load_dependent_friction")()
    assert not estimate_alignment([rubs], [term]).is_late
    for samples in (1, 2):
        found = estimate_alignment([logged_late(rubs, samples)], [term])
        assert found.is_late and found.delay_std < 1e-4
        assert found.delay == pytest.approx(2e-3 * samples, abs=4 * found.delay_std)


def every_few(fast: Recording, every: int) -> Recording:
    """A log that leaves out all but one of every few rows."""
    return replace(fast, time=fast.time[::every], position=fast.position[::every], torque=fast.torque[::every])


def test_a_log_of_every_few_samples_of_a_controller_holds_torque_that_was_sampled():
    fast, every = run("pd_loop", 500.0), 10
    slow_log = every_few(fast, every)
    found = estimate_alignment([slow_log])
    assert found.channel.is_sampled and found.json()["sampled"] and found.finding.is_sampled
    assert found.delay == pytest.approx((every - 1) * 0.001, abs=3e-4)  # half a sample, less that of the controller
    assert not estimate_alignment([fast]).is_late
    rubs = run("pd_loop", 500.0, load_dependent_friction={"load_out": 0.5})  # gears that rub under load
    assert estimate_alignment([every_few(rubs, every)]).delay == pytest.approx(0.009, abs=3e-4)
    theta, plain = (
        fit_terms(RegressionData.from_recordings([one]), BASE)[0].theta for one in (found.apply(slow_log), slow_log)
    )
    np.testing.assert_allclose(theta, TRUTH, rtol=0.005)
    assert abs(plain[0] / TRUTH[0] - 1) > 0.015  # taken for held


def test_sampled_torque_is_late_by_half_a_sample_though_that_hardly_helps_to_predict():
    """A hundred rows a second of a servo: nothing says so but that a delay is surely some, and about half a sample."""
    fast = run("two_tone", 1000.0)
    noisy = replace(fast, torque=fast.torque + np.random.default_rng(0).normal(0.0, 0.3, len(fast)))
    found = estimate_alignment([every_few(noisy, 10)])
    assert found.channel == Channel(0.005, 0.0, True) and found.is_half_sample
    assert found.finding == TorqueTiming(is_late=True, is_sampled=True)
    other = every_few(noisy, 5)  # of another period
    np.testing.assert_array_equal(
        found.apply(other).torque, Alignment(Channel(0.0025, 0.0, True), 1e-9, 0.0).apply(other).torque
    )
    assert not estimate_alignment([noisy]).is_found


def test_recordings_that_alone_may_be_half_a_sample_late_do_not_overrule_what_they_show_together():
    """Every fifth row of a controller is late by two fifths of a sample; together two logs tell that from a half."""
    fast = [run("pd_loop", 1000.0, seed) for seed in (5, 7)]
    noise = [np.random.default_rng(seed).normal(0.0, 0.14, len(own)) for seed, own in zip((5, 7), fast, strict=True)]
    logs = [every_few(replace(own, torque=own.torque + e), 5) for own, e in zip(fast, noise, strict=True)]
    assert all(estimate_alignment([log]).is_half_sample for log in logs)
    for found in estimate_alignments(logs):
        assert not found.is_half_sample and abs(found.delay - 0.002) < 2 * found.delay_std < 0.0005


@pytest.mark.parametrize("seed", slow.but_first(range(8)))
def test_held_torque_that_is_a_whole_sample_late_is_never_half_a_sample_late(seed):
    late = logged_late(run("two_tone", 100.0, seed), 1)
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, len(late))
    found = estimate_alignment([replace(late, position=late.position + noise)])
    assert not found.is_half_sample and (not found.is_late or found.delay + found.lag > 0.007)


def test_what_one_recording_tells_of_the_log_is_said_of_all_unless_another_contradicts():
    told, untold = (every_few(run(kind, 500.0, seed), 5) for kind, seed in (("pd_loop", 3), ("two_tone", 4)))
    brief = untold.slice(0, 120)
    nothing = estimate_alignment([brief])
    assert not nothing.is_found and nothing.delay_std == np.inf and estimate_alignment([told]).is_late
    assert [one.delay for one in estimate_alignments([told, brief])] == pytest.approx([0.004, 0.004], abs=3e-4)
    in_time = run("pd_loop", 500.0, 5)
    assert [one.is_late for one in estimate_alignments([told, in_time])] == [True, False]


def test_one_recording_that_contradicts_does_not_take_the_timing_of_the_log_from_the_others():
    """Two tell it, one is too brief, and of one the drive acts late, on which the log has no influence."""
    told = [every_few(run("pd_loop", 500.0, seed), 5) for seed in (3, 5)]
    brief = every_few(run("two_tone", 500.0, 4), 5).slice(0, 120)
    dead = every_few(run("two_tone", 500.0, 6, dead_time={"dead_n": 20.0}), 5).slice(0, 300)
    assert estimate_alignment([dead]).delay < -0.03
    assert [one.delay for one in estimate_alignments([*told, brief, dead])] == pytest.approx([0.004] * 4, abs=3e-4)


def test_corrected_torque_is_that_which_acted():
    good = run("prbs", 500.0)
    late = replace(logged_late(good, 5), temperature=good.position)
    mended = estimate_alignment([late]).apply(late)
    kept = len(mended)
    np.testing.assert_array_equal(mended.temperature, mended.position)  # whatever else was recorded goes along
    assert len(good) - 7 < kept < len(good)
    np.testing.assert_array_equal(mended.time, good.time[:kept])
    assert np.sqrt(np.mean((mended.torque - good.torque[:kept]) ** 2)) < 0.05 * np.std(good.torque)
    assert any(
        note.startswith("aligned: delay 10") or note.startswith("aligned: delay 9.9") for note in list_notes(mended)
    )
    sharp = estimate_alignment([filtered := logged_filtered(good, 0.01)]).apply(filtered)
    assert np.sqrt(np.mean((sharp.torque - good.torque[1:]) ** 2)) < 0.05 * np.std(good.torque)


def test_nothing_reaches_across_a_gap():
    good = run("multisine", 500.0)
    gap = slice(2900, 3100)
    late = logged_late(good, 5)
    kept = {name: np.delete(getattr(late, name), gap) for name in ("time", "position", "torque")}
    holey = replace(late, **kept, starts=(0, 2900))
    found = estimate_alignment([holey])
    assert found.delay == pytest.approx(0.01, abs=2e-4)
    mended = replace(found, channel=replace(found.channel, delay=0.01)).apply(holey)
    acted = dict(zip(good.time.tolist(), good.torque.tolist(), strict=True))
    assert len(mended.segments) == 2
    np.testing.assert_allclose(mended.torque, [acted[t] for t in mended.time.tolist()], atol=1e-12)


def test_a_delay_does_not_take_the_place_of_the_inertia_of_a_motor():
    """Through a coarse encoder, the lag J / b of the speed behind the torque is clearer than the acceleration."""
    inertia, viscous, coulomb, step, rng = 1e-3, 0.15, 0.05, 1e-4, np.random.default_rng(2)
    recordings = []
    for phase in rng.uniform(0.0, 6.0, 2):
        velocity = position = 0.0
        rows = []
        for k in range(120_000):
            if k % 40 == 0:  # the torque is held for 4 ms
                time = k * step
                torque = 1.2 * np.sin(3.1 * time + phase) + 0.8 * np.sin(9.7 * time)
                rows.append((time, np.round(position * 2048 / (2 * np.pi)) * 2 * np.pi / 2048, torque))
            pushed = velocity + step * (torque - viscous * velocity) / inertia
            velocity = float(np.sign(pushed) * max(abs(pushed) - step * coulomb / inertia, 0.0))
            position += step * velocity
        recordings.append(Recording(*np.array(rows).T, name=f"phase-{phase:.1f}"))
    assert not any(alignment.is_found for alignment in estimate_alignments(recordings))


@pytest.mark.parametrize("seed", slow.but_first((3, 4)))
def test_the_answer_of_a_controller_to_its_encoder_is_noise_in_a_log_of_every_tenth_row(seed):
    """The answer in a row acts for a tenth of the time to the next; ten others, which no row has, act as well."""
    plant = Plant(inertia=0.03, gravity=1.0, viscous=0.05, coulomb=0.1)
    loop = {"excitation": "pd_loop", "counts": 16_384, "torque_noise": 0.003, "gains": (12.0, 0.6)}
    fast = recorded(plant, Experiment(rate=1000.0, seconds=30.0, seed=seed, **loop))[0]
    log = every_few(fast, 10)
    found = estimate_alignment([log])
    assert found.channel.is_sampled and found.delay == pytest.approx(0.0045, abs=1e-4)
    data = RegressionData.from_recordings([found.apply(log)])
    fit = fit_terms(data, BASE)[0]
    structure = data.layout.structure("", data.residual(BASE, fit.theta), fit.theta[0])
    assert structure.z_score < Criterion.z_score
    assert structure.rms == pytest.approx(data.floors[""], rel=0.1)
    np.testing.assert_allclose(fit.theta, (0.03, 1.0, 0.05, 0.1), rtol=0.01)


@pytest.mark.parametrize("seed", slow.but_first((3, 4)))
def test_a_filter_is_not_underestimated_because_a_shorter_one_amplifies_less_noise(seed):
    """The noise is a tenth of the torque of a pendulum's motion of two tones, filtered with it."""
    experiment = Experiment(rate=200.0, seconds=20.0, seed=seed, excitation="two_tone", torque_noise=0.1)
    found = estimate_alignment([logged_filtered(recorded(Plant(), experiment)[0], 0.008)], is_model=True)
    assert abs(found.lag - 0.008) < found.lag_std < 1.5e-4


MULTISINE = Experiment(rate=1000.0, seconds=12.0, excitation="multisine", seed=3, counts=65_536)


@pytest.mark.parametrize(
    ("hidden", "effect"),
    [({"actuator_lag": {"lag_T": 0.02}}, ActuatorLag(0.02)), ({"dead_time": {"dead_n": 10}}, DeadTime(0.01))],
    ids=["lag", "dead time"],
)
def test_a_log_is_predicted_by_its_delay_and_that_of_its_actuator_together(hidden, effect):
    late = logged_late(recorded(Plant(effects=hidden), MULTISINE)[0], 4)
    law = Alignment(Channel(0.004), 1e-4, 0.0)
    true, *others = predict_log([late], [([law], [effect]), ([law], []), ([NO_ALIGNMENT], [])])
    assert all(true.beats(other) for other in others)


def test_each_recording_of_a_log_is_predicted_with_its_own_delay():
    logs = [logged_late(recorded(Plant(), replace(MULTISINE, seed=seed))[0], n) for seed, n in ((4, 4), (5, 9))]
    first, second = (Alignment(Channel(delay), 1e-4, 0.0) for delay in (0.004, 0.009))
    true, *others = predict_log(logs, [([first, second], []), ([first, first], []), ([NO_ALIGNMENT, second], [])])
    assert all(true.beats(other) for other in others)


def test_a_saturation_that_removes_the_torque_predicts_no_log():
    late = logged_late(recorded(Plant(), MULTISINE)[0], 4)
    law = Alignment(Channel(0.004), 1e-4, 0.0)
    assert predict_log([late], [([law], []), ([law], [TorqueSaturation(0.001, 0.1)])]) == []
