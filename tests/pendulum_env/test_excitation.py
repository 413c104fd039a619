"""Excitation signals: bounded, repeatable, plain functions of time."""

import json

import numpy as np
import pytest

from pendulum_env.excitation import EXCITATIONS, decode_signal, draw_family, encode_signal, excitation

NAMES = sorted(EXCITATIONS)
TIME = np.arange(0, 40, 0.001)


def draw(name, seed=0, **options):
    return excitation(name, np.random.default_rng(seed), **options)


@pytest.mark.parametrize("name", NAMES)
def test_a_signal_is_a_function_of_time_and_seed_that_goes_on_beyond_its_recording(name):
    command = draw(name, seconds=5.0)
    torque = command.signal(TIME)
    assert torque.shape == TIME.shape and np.isfinite(torque).all() and torque[TIME > 5].std() > 0
    assert np.array_equal(torque, draw(name, seconds=5.0).signal(TIME))
    assert not np.allclose(torque, draw(name, seed=1, seconds=5.0).signal(TIME))
    assert [float(command.signal(t)) for t in TIME[::4001]] == pytest.approx(list(torque[::4001]))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("amplitude", [None, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_torque_stays_within_its_amplitude_and_comes_near_it(name, amplitude, seed):
    command = draw(name, seed, amplitude=amplitude)
    peak = np.abs(command.signal(TIME)).max()
    assert 0.8 * command.amplitude < peak <= command.amplitude
    assert amplitude is None or command.amplitude == amplitude


def test_paper_excitation_is_the_two_tones_of_the_paper():
    command = draw("paper")
    first, second = command.phases
    assert command.signal(TIME) == pytest.approx(3 * np.sin(12.07 * TIME + first) + 3 * np.sin(2.25 * TIME + second))


@pytest.mark.parametrize(
    ("name", "options", "why"),
    [
        ("chrip", {}, r"unknown excitation 'chrip': did you mean chirp\? Known: chirp, multisine"),
        ("steps", {"amplitude": -1.0}, "needs amplitude above zero"),
        ("steps", {"seconds": np.nan}, "needs seconds above zero"),
    ],
)
def test_what_makes_no_excitation_is_refused_with_what_was_meant(name, options, why):
    with pytest.raises(ValueError, match=why):
        draw(name, **options)


def test_a_family_stays_within_its_amplitude_and_differs_in_speed_and_strength():
    signals = draw_family(np.random.default_rng(0), 20.0, 4.0)
    peaks = [np.abs(signal.signal(TIME)).max() for signal in signals]
    assert max(peaks) <= 4.0 and min(peaks) < 2.0
    reversals = [np.count_nonzero(np.diff(np.sign(signal.signal(TIME)))) for signal in signals]
    assert max(reversals) > 10 * min(reversals)


def test_signals_survive_json():
    for signal in draw_family(np.random.default_rng(0), 20.0, np.float64(4.0)):
        again = decode_signal(json.loads(json.dumps(encode_signal(signal))))
        assert again == signal
        assert np.array_equal(again.signal(TIME), signal.signal(TIME))


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"kind": "square"},
        {"kind": "levels", "amplitude": 1.0, "edges": [1.0], "levels": [2.0]},
        {"kind": "two_tone", "amplitude": float("nan"), "phases": [0.0, 1.0]},
        {"kind": "two_tone", "amplitude": "high", "phases": [0.0, 1.0]},
    ],
)
def test_what_is_no_signal_is_refused(data):
    with pytest.raises(ValueError, match="a signal is one of two_tone, multisine, chirp, levels"):
        decode_signal(data)
