"""Weak-form equations: clear of stick, exact on sampled data, honest about noise."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, simulate
from estimators.checks.alignment import Alignment
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.data.split import add_contacts
from estimators.regression.least_squares import IdentificationError
from estimators.signals.channel import Channel
from estimators.signals.differentiation import estimate_position_noise, estimate_white_noise
from estimators.weak_form.averages import WindowAverages
from estimators.weak_form.contacts import count_contacts
from estimators.weak_form.floors import compute_absorbed_noise, compute_noise_floor
from estimators.weak_form.preparation import calibrate_noise, choose_half_width, prepare_windows
from estimators.weak_form.torque_windows import TorqueWindows, join_windows
from estimators.weak_form.window_columns import WindowColumns, WindowTorque
from estimators.weak_form.windows import cut
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Gravity, Inertia, Term, Viscous, effect
from pendulum_env.recording import Recording
from tests.cases import TRUTH, WALLS, make_recording, recorded, recording


@pytest.fixture(scope="module")
def sticky_runs() -> list[SimulatedRecording]:
    """Weak excitation through encoders and noise of all kinds: the joint rests a fair share of the time."""
    experiments = [
        Experiment(rate=1000, seconds=8, scale=0.45),
        Experiment(rate=200, seconds=16, scale=0.45, counts=65_536, torque_noise=0.05),
        Experiment(rate=500, seconds=8, scale=0.45, counts=8192),
        Experiment(rate=500, seconds=8, excitation="multisine", scale=0.7, seed=2),
    ]
    return simulate([(Plant(), experiment) for experiment in experiments])


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("half_width", [None, 0.05])
def test_windows_never_touch_stick_or_a_reversal_and_a_turn_by_friction_is_no_knock(sticky_runs, which, half_width):
    run = sticky_runs[which]
    (windows,) = prepare_windows([make_recording(run)], half_width and [half_width]).windows
    reach = len(windows.kernel) // 2
    assert 0.02 < np.mean(~run.sliding)
    assert len(windows.centers) >= 20
    for center in windows.centers:
        window = slice(center - reach - 1, center + reach + 2)
        assert run.sliding[window].all()
        assert abs(np.sign(run.velocity[window]).sum()) == 2 * reach + 3
        assert np.all(np.sign(windows.samples.velocity[window]) == np.sign(run.velocity[window]))
    assert len(windows.stick.turning) > 0
    assert count_contacts(knocked(RegressionData.from_recordings([make_recording(run)]))) == 0


def drifting(rate: float, seconds: float, inertia: float, seed: int = 0) -> Recording:
    """A free inertia that drifts one way under a torque that is new at every sample and held until the next."""
    rng, period = np.random.default_rng(seed), 1 / rate
    torque = 0.3 * rng.standard_normal(round(rate * seconds))
    a = torque / inertia
    v = 5 + np.r_[0, np.cumsum(a)[:-1]] * period
    q = np.r_[0, np.cumsum(v * period + 0.5 * a * period**2)[:-1]]
    return Recording(period * np.arange(len(q)), q, torque, name="drifting")


@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_equations_are_exact_on_a_free_inertia_whatever_torque_is_held(rate):
    recording = drifting(rate, 5.0, inertia=0.09)
    data = prepare_windows([recording], [max(0.02, 2 / rate)])
    equations = data.equations((Inertia(),))
    assert np.std(equations.y) > 0.02
    np.testing.assert_allclose(0.09 * equations.phi[:, 0], equations.y, atol=1e-7)


def test_equations_of_a_smooth_motion_with_friction_are_exact_to_the_order_of_the_window():
    """I q'' + b q' = 0 has the solution q = 1 - exp(-b t / I)."""
    time = np.arange(2000) / 1000
    q = 1 - np.exp(-4 * time)
    data = prepare_windows([Recording(time, 3 * q, np.zeros(2000), name="coasting")], [0.01])
    equations = data.equations((Inertia(), Viscous()))
    error = equations.phi @ [0.1, 0.4]
    assert np.abs(error).max() < 2e-4 * np.abs(0.1 * equations.phi[:, 0]).max()


NOISY = {
    "fine": Experiment(rate=1000, seconds=8, seed=1),
    "coarse": Experiment(rate=500, seconds=8, counts=16_384, seed=2),
    "slow": Experiment(rate=200, seconds=12, counts=65_536, torque_noise=0.05, seed=3),
    "noisy": Experiment(rate=1000, seconds=8, counts=8192, torque_noise=0.1, excitation="filtered_noise", seed=4),
    "analogue": Experiment(rate=500, seconds=8, counts=None, position_noise=2e-5, torque_noise=0.005, seed=5),
}


@pytest.fixture(scope="module")
def noisy_runs() -> dict[str, SimulatedRecording]:
    return dict(zip(NOISY, simulate([(Plant(), experiment) for experiment in NOISY.values()]), strict=True))


@pytest.mark.parametrize("name", NOISY)
def test_the_residual_of_the_true_model_is_the_noise_that_was_predicted(noisy_runs, name):
    data = prepare_windows([make_recording(noisy_runs[name])])
    equations = data.equations(BASE)
    residual = equations.y - equations.phi @ TRUTH
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(compute_noise_floor(data.windows, TRUTH[0]), rel=0.3)


@pytest.mark.parametrize(("speed", "half_width"), [(16.0, 0.08), (24.0, 0.11), (30.0, 0.16)])
def test_windows_as_long_as_a_turn_have_no_error_beyond_the_noise_that_was_predicted(speed, half_width):
    """A pendulum that never stands still, under the torque that its motion w t + A sin w t needs."""
    time, rng, (inertia, gravity, viscous) = np.arange(8000) / 1000, np.random.default_rng(0), (0.017, 0.6, 0.04)
    swing = gravity / inertia / speed**2

    def turn(t: Array) -> Array:
        return speed * t + swing * np.sin(speed * t)

    middle = time + 0.5e-3  # of the sample over which the torque is held
    velocity = speed * (1 + swing * np.cos(speed * middle))
    acceleration = -swing * speed**2 * np.sin(speed * middle)
    torque = inertia * acceleration + gravity * np.sin(turn(middle)) + viscous * velocity
    noisy = turn(time) + 1e-4 * rng.standard_normal(8000), torque + 0.003 * rng.standard_normal(8000)
    data = prepare_windows([Recording(time, *noisy)], [half_width])
    equations = data.equations((Inertia(), Gravity(), Viscous()))
    residual = equations.y - equations.phi @ [inertia, gravity, viscous]
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(compute_noise_floor(data.windows, inertia), rel=0.3)


def test_white_noise_is_measured_beside_a_smooth_signal_and_its_steps():
    time = np.arange(5000) / 1000
    signal = 3 * np.sin(5 * time) + (time > 2) - 2 * (time > 3)
    noisy = signal + 0.02 * np.random.default_rng(0).standard_normal(5000)
    assert estimate_white_noise(noisy) == pytest.approx(0.02, rel=0.05)
    assert estimate_white_noise(np.round(signal / 1e-3) * 1e-3) == pytest.approx(1e-3 / np.sqrt(12), rel=0.3)


def test_a_joint_at_rest_hides_no_noise_of_its_encoder():
    """Most of the time it rests; then it creeps, whatever became of the whole steps when the clock was made even."""
    time = np.arange(4000) / 200
    count, creep = 2 * np.pi / 4096, np.maximum(time - 15.0, 0.0) ** 2 / 20
    counted = np.round(creep / count) * count
    uneven = time + 0.3 / 200 * np.sin(40 * time)
    for read in (counted, np.interp(time, uneven, np.round(np.interp(uneven, time, creep) / count) * count)):
        assert 0.7 < estimate_position_noise(read) / (count / np.sqrt(12)) < 1.3
    assert estimate_position_noise(np.zeros(100)) == 0.0


def test_windows_grow_with_the_coarseness_of_the_encoder():
    experiments = [Experiment(rate=1000, seconds=5, counts=count) for count in (None, 65_536, 8192, 1024)]
    widths = [choose_half_width(run) for run in recorded(Plant(), *experiments)]
    assert widths == sorted(widths) and widths[0] < widths[-1]


def test_windows_of_several_recordings_share_equations_but_no_cluster():
    parts = [cut(run, 0.012) for run in recorded(Plant(), *(Experiment(500, 6, seed=seed) for seed in range(2)))]
    data = join_windows(parts)
    equations = data.equations(BASE)
    first = len(parts[0].centers)
    assert len(equations.y) == len(data.weights) == first + len(parts[1].centers)
    assert not set(data.clusters[:first]) & set(data.clusters[first:])
    assert np.all(np.diff(data.clusters) >= 0)
    np.testing.assert_array_equal(equations.y[:first], join_windows(parts[:1]).equations(BASE).y)


@pytest.fixture(scope="module")
def coarse() -> SimulatedRecording:
    (run,) = simulate([(Plant(), Experiment(rate=500, seconds=8, counts=4096))])
    return run


def test_averages_of_joined_recordings_are_those_of_each_however_dense_its_windows(sticky_runs):
    one, other = prepare_windows([make_recording(run) for run in sticky_runs[:2]]).windows
    for parts in (
        (one, other),
        (one.center_at_every_sample(), other),
        (one.center_at_every_sample(), other.center_at_every_sample()),
    ):
        series = [np.sin(3 * w.recording.time) for w in parts]
        joined = WindowAverages.join([w.averages for w in parts])
        apart = [w.averages.narrow @ own for w, own in zip(parts, series, strict=True)]
        np.testing.assert_allclose(joined.narrow @ np.concatenate(series), np.concatenate(apart), atol=1e-12)


@pytest.mark.parametrize("derive", [np.gradient, lambda q: np.diff(q, prepend=q[0])], ids=["central", "backward"])
def test_a_velocity_that_was_computed_from_the_position_changes_nothing(coarse, derive):
    plain = make_recording(coarse)
    other = replace(plain, velocity=derive(plain.position) * plain.rate)
    one, two = (join_windows([cut(own, 0.02)]).equations(BASE) for own in (plain, other))
    np.testing.assert_array_equal(one.phi, two.phi)


def test_a_recording_that_rests_is_refused_with_what_to_do():
    time = np.arange(2000) / 500
    with pytest.raises(IdentificationError, match=r"resting: only 0 stretches .* clear of stick.* record longer"):
        prepare_windows([Recording(time, np.zeros(2000), 0.3 * np.sin(time), name="resting")])


@pytest.mark.slow
def test_a_moment_while_the_joint_rests_is_not_known_better_than_the_rest_lasts():
    time = np.arange(5000) / 500
    command = 3 * np.sin(12 * time) + 3 * np.sin(2.3 * time)
    paused = np.where((time > 2.5) & (time < 5.0), 0.0, command)
    plant = Plant(effects={"payload_change": {"pay_t": 4.0, "pay_I": 0.04, "pay_mgl": 0.0}})
    runs = recorded(plant, *[Experiment(seed=1, seconds=10.0, rate=500.0)] * 2, commands=[command, paused])
    terms = (*BASE, effect("payload_change")(moment=4.0))
    moving, resting = (fit_terms(RegressionData.from_recordings([run]), terms)[0] for run in runs)
    assert moving.estimates["payload_change.moment"].std < 0.05
    assert 0.5 < resting.estimates["payload_change.moment"].std < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("coarse", [{"position_noise": 2e-4, "counts": None}, {"torque_noise": 0.2}])
def test_what_noise_makes_neighbouring_windows_share_is_no_structure(coarse):
    """Encoder noise turns the sign from window to window, torque noise keeps it: neither is told as something there."""
    experiments, shared = (Experiment(rate=500, seconds=10, seed=seed, **coarse) for seed in range(6)), []
    for run in recorded(Plant(coulomb=0.1), *experiments):
        prepared = RegressionData.from_recordings([run])
        model, fit = fit_terms(prepared, BASE)
        shared.append(prepared.layout.structure("", fit.residual, model.estimates["inertia"].value)[1])
        without = prepared.layout.structure(
            "", fit.residual + 3 * fit.rms * np.sin(0.05 * np.arange(len(fit.residual))), 0.09
        )
        assert without[1] > 10  # what goes on from window to window is
    assert np.abs(np.mean(shared)) < 2 and np.max(np.abs(shared)) < 4.5


def test_a_residual_smaller_than_the_noise_of_its_windows_has_no_structure():
    """Encoder noise turns the sign from window to window: where there is less of it, less is to be taken away."""
    (run,) = recorded(Plant(coulomb=0.1), Experiment(rate=500, seconds=10, position_noise=2e-4, counts=None))
    prepared = RegressionData.from_recordings([run])
    model, fit = fit_terms(prepared, BASE)
    small = prepared.layout.structure("", 0.1 * fit.residual, model.estimates["inertia"].value)
    assert abs(small.z_score) < 4.5


@pytest.mark.parametrize("loop", [{}, {"excitation": "pd_loop", "gains": (35.0, 1.2)}])
def test_windows_and_their_noise_are_the_same_for_any_zero_of_the_position(loop):
    """A position that is a quarter turn off leaves all of gravity to the tilt, not to the inertia."""
    (run,) = recorded(Plant(), Experiment(rate=500, seconds=10, seed=4, **loop))
    other = Recording(run.time, run.position + np.pi / 2, run.torque)
    assert choose_half_width(run) == choose_half_width(other)
    first, second = (RegressionData.from_recordings([log]) for log in (run, other))
    assert second.inertias(BASE)[""] == pytest.approx(first.inertias(BASE)[""], rel=1e-3)
    assert second.floors[""] == pytest.approx(first.floors[""], rel=1e-3)


def test_motion_of_one_frequency_keeps_its_inertia_though_tilted_gravity_fits_better():
    """Around a level arm cos q replaces an acceleration with the noise of the encoder, without a wrong zero."""
    time = np.arange(10_000) / 500
    q = np.pi / 2 + 0.3 * np.sin(2 * np.pi * time + 1.0)
    v, a = 0.6 * np.pi * np.cos(2 * np.pi * time + 1.0), -1.2 * np.pi**2 * np.sin(2 * np.pi * time + 1.0)
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(time))
    torque = 0.09 * a + 2.0 * np.sin(q) + 0.35 * v + 0.8 * np.sign(v) + noise
    step = 2 * np.pi / 20_000
    run = Recording(time, np.round(q / step) * step, torque)
    assert RegressionData.from_recordings([run]).inertias(BASE)[""] == pytest.approx(0.09, rel=0.03)


def test_the_score_has_blocks_of_the_length_of_its_data():
    (run,) = recorded(Plant(), Experiment(rate=500, seconds=8))
    counts = [len(RegressionData.from_recordings([run], block=block).layout.scored.of_block) for block in (1.0, 0.5)]
    assert counts == [8, 16]


def knocked(prepared: RegressionData, terms: Sequence[Term] = BASE) -> TorqueWindows:
    return add_contacts((prepared, prepared), terms)[0].data


def test_a_turn_that_no_friction_makes_is_kept_where_a_stop_is_met():
    bouncing = recording("bouncing")
    prepared = RegressionData.from_recordings([bouncing])
    (before,), (after,) = prepared.data.windows, (data := knocked(prepared)).windows
    added = bouncing.position[np.setdiff1d(after.centers, before.centers)]
    assert count_contacts(data) >= 3
    reach = 0.3  # [rad], of half a window at 45 rad/s, less than a reversal in mid-range
    assert np.all((added < WALLS[0] + reach) | (added > WALLS[1] - reach))


@pytest.mark.parametrize(
    ("hidden", "terms"),
    [
        ({"stribeck": {"strib_d": 0.8, "strib_v": 0.3}}, (effect("stribeck")(0.3),)),
        pytest.param({"presliding": {"dahl_sigma": 40.0}}, (effect("presliding")(0.02),), marks=pytest.mark.slow),
        ({"load_dependent_friction": {"load_mu": 0.3}}, (effect("load_dependent_friction")(),)),
    ],
)
def test_a_turn_that_friction_of_another_law_makes_is_no_knock(hidden, terms):
    runs = recorded(Plant(effects=hidden), Experiment(rate=500, seconds=8, seed=3))
    assert count_contacts(knocked(RegressionData.from_recordings(runs), (*BASE, *terms))) == 0


def test_a_delay_absorbs_no_noise_of_the_torque(coarse):
    windows = prepare_windows([make_recording(coarse)]).windows[0]
    for delay in (0.001, 0.0025, 0.01, 0.1):
        assert 0.0 <= compute_absorbed_noise([windows], effect("dead_time")(delay)) < 0.1 * windows.noise.raw_torque**2


def test_noise_of_the_rate_of_a_torque_is_that_of_white_encoder_noise():
    rng, time = np.random.default_rng(1), np.arange(0.0, 60.0, 0.002)
    q = np.sin(2.0 * time)
    clean, noisy = (
        cut(Recording(time, q + noise * rng.standard_normal(len(q)), np.cos(2.0 * time), name=""), 0.03)
        for noise in (1e-9, 1e-4)
    )
    both = np.intersect1d(clean.centers, noisy.centers)
    of_each = (w.rates.narrow[np.isin(w.centers, both)] @ w.acceleration for w in (clean, noisy))
    assert noisy.noise.compute_rate_std(0.5) == pytest.approx(0.5 * np.std(np.subtract(*of_each)), rel=0.1)


SAMPLED = Alignment(Channel(0.5 / 500.0, 0.0, True), 1e-4, 0.0, is_half_sample=True)


def log_of_motion(torque: Array) -> Recording:
    """A steady swing with some torque, sampled at 500 Hz."""
    time = np.arange(len(torque)) / 500.0
    return Recording(time, np.sin(4.0 * time), torque, name="log")


def test_sampled_torque_that_was_moved_by_half_a_sample_keeps_the_noise_of_its_log():
    """Interpolation smooths the noise from sample to sample, by which a noise would look smaller."""
    noise = 0.1 * np.random.default_rng(0).standard_normal(20_000)
    (windows,) = prepare_windows([SAMPLED.apply(log_of_motion(noise))], [0.01]).windows
    average = WindowTorque([replace(windows, centers=np.arange(1000, 19_000))]).recorded
    raw = cut(SAMPLED.apply(log_of_motion(noise)), 0.01)
    assert raw.noise.torque == pytest.approx(average.std(), rel=0.05)


def test_equations_of_sampled_torque_count_by_the_unknown_instant_of_its_jumps():
    """A jump at a random instant between two samples; the scale predicts the error of a window about it."""
    rng, jumps = np.random.default_rng(0), np.arange(100, 9900, 97)
    instants, held = jumps + rng.uniform(0.0, 1.0, len(jumps)), np.zeros(10_000)
    log = 0.01 * rng.standard_normal(len(held))
    for sign, jump, instant in zip(rng.choice([-1.0, 1.0], len(jumps)), jumps, instants, strict=True):
        held[jump + 1 :] += sign
        held[jump] += sign * (jump + 1 - instant)  # mean over the sample
        log[jump + 1 :] += sign
    windows, true = cut(SAMPLED.apply(log_of_motion(log)), 0.01), cut(log_of_motion(held), 0.01)
    assert windows.scale is not None
    near = jumps[:-1] - round(500.0 * windows.recording.time[0])
    moved = WindowTorque([replace(windows, centers=near, scale=None)]).recorded
    error = np.std(moved - WindowTorque([replace(true, centers=jumps[:-1], scale=None)]).recorded)
    predicted = windows.noise.torque / windows.scale[near]
    assert error == pytest.approx(np.sqrt(np.mean(predicted**2)), rel=0.3)
    assert np.allclose(windows.scale[near + 48], 1.0) and true.scale is None


SLOW = {"excitation": "triangle", "scale": 1.2, "gains": (40.0, 2.0), "torque_limit": 12.0}  # a coarse encoder's speed
COARSE = {"rate": 1000.0, "seconds": 16.0, "counts": 4096, "torque_noise": 0.01}


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_divided_between_torque_and_encoder_under_a_controller(seed):
    (run,) = simulate([(Plant(), Experiment(seed=seed, **SLOW, **COARSE))])
    noisy = cut(make_recording(run), 0.06)
    exact = cut(Recording(run.time, run.exact_position, run.command), 0.06)
    w, theta = calibrate_noise(noisy), np.array([0.09, 2.0, 0.35, 0.8])
    residuals = []
    for torque, motion in ((noisy, exact), (exact, noisy)):  # noise of the torque's log alone, and of the encoder's
        phi = np.column_stack([WindowColumns([motion]).columns([term])[0][0] for term in BASE])
        shared = np.isin(motion.centers, torque.centers), np.isin(torque.centers, motion.centers)
        residuals.append(float(np.std(WindowTorque([torque]).net[shared[1]] - (phi @ theta)[shared[0]])))
    of_torque, of_encoder = residuals
    assert 0.5 < w.noise.torque / of_torque < 2.5 and 0.5 < 0.09 * w.noise.acceleration / of_encoder < 1.5
    assert 0.6 < w.noise.compute_std(0.09) / np.hypot(of_torque, of_encoder) < 1.3


@pytest.mark.parametrize("seed", range(3))
def test_a_coarse_encoder_in_slow_motion_does_not_bias_the_inertia(seed):
    (run,) = simulate([(Plant(), Experiment(seed=seed, **SLOW, **COARSE))])
    model, _ = fit_terms(RegressionData.from_recordings([make_recording(run)]), BASE)
    for own, true in zip(model.estimates.values(), TRUTH, strict=True):
        assert abs(own.value - true) < 4 * own.std


def test_rest_in_a_log_does_not_lower_the_noise_of_its_torque():
    (run,) = simulate([(Plant(), Experiment(rate=200.0, seconds=10.0, torque_noise=0.05))])
    rest = np.zeros(1200)
    time = np.arange(len(run.time) + len(rest)) / 200.0
    padded = Recording(time, np.append(rest + run.position[0], run.position), np.append(rest, run.torque))
    plain, longer = (cut(each, 0.02).noise.raw_torque for each in (make_recording(run), padded))
    assert 0.9 < longer / plain < 1.1
