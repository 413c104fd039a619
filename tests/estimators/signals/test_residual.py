"""Regions in which a residual stands out: found at their place, in words, and only where there is something."""

import numpy as np
import pytest

from estimators.signals.residual import (
    AXES,
    REGIONS,
    Region,
    compute_order_spectrum,
    compute_profile,
    compute_profiles,
    compute_spectrum,
    find_regions,
    find_runs,
    remove_strongest,
)
from pendulum_env.physics import Samples

NOISE = 0.02  # N m


def motion(seed: int = 0, rows: int = 1500) -> Samples:
    """Samples in time order whose position, velocity and torque have little to do with each other."""
    rng = np.random.default_rng(seed)
    q, v, u = rng.uniform(-2.5, 2.5, rows), 4 * rng.standard_normal(rows), 3 * rng.standard_normal(rows)
    return Samples(np.arange(rows) * 0.01, q, v, u)


def noise(seed: int, rows: int = 1500) -> np.ndarray:
    return NOISE * np.random.default_rng(1000 + seed).standard_normal(rows)


def regions_of(x: Samples, residual: np.ndarray) -> list[Region]:
    return find_regions(compute_profiles(x, residual, NOISE))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("axis", "center", "width"),
    [("position", 1.2, 0.25), ("velocity", -3.0, 0.8), ("torque", 4.0, 0.8), ("time", 6.0, 0.7)],
)
def test_a_bump_in_the_residual_is_found_at_its_place(axis, center, width, sign):
    x = motion()
    distance = (getattr(x, axis) - center) / width
    residual = noise(0) + sign * 0.08 * np.exp(-0.5 * distance**2)
    top = regions_of(x, residual)[0]
    assert top.axis == axis and top.unit == AXES[axis]
    assert top.low < center < top.high < top.low + 6 * width
    assert 0.02 < sign * top.residual < 0.08 and top.significance > 5


def test_two_bumps_of_opposite_sign_are_two_regions():
    x = motion()
    residual = noise(0) + 0.1 * np.exp(-((x.position - 1) ** 2) / 0.1) - 0.1 * np.exp(-((x.position + 1) ** 2) / 0.1)
    two = sorted((own for own in regions_of(x, residual) if own.axis == "position"), key=lambda own: own.low)
    assert [(np.sign(own.residual), own.low < np.sign(own.residual) < own.high) for own in two] == [(-1, 1), (1, 1)]


def test_a_region_has_the_mean_of_its_bins_and_every_bin_beyond_its_band_is_in_one():
    time = np.arange(3000) * 0.01
    x = Samples(time, 2 * np.sin(1.3 * time), 2.6 * np.cos(1.3 * time), np.sin(0.7 * time))
    residual = noise(0, 3000) + 0.1 * np.exp(-((x.velocity / 0.3) ** 2)) * np.sign(x.velocity) + 0.01
    profiles = {profile.axis: profile for profile in compute_profiles(x, residual, NOISE)}
    regions = find_regions(list(profiles.values()))
    means = [region.significance for region in regions if region.peak is None]
    assert means == sorted(means, reverse=True) and regions[0].axis == "velocity"
    for axis, profile in profiles.items():
        told = np.zeros(len(profile.mean), dtype=bool)
        for region in (region for region in regions if region.axis == axis):
            bins = (profile.middle > region.low) & (profile.middle < region.high)
            told |= bins
            largest = profile.mean[bins].max() if profile.is_spectrum else profile.mean[bins].mean()
            assert region.residual == pytest.approx(largest, rel=0.01)
            assert np.all(np.sign(profile.mean[bins]) == np.sign(region.residual))
        assert np.array_equal(told, np.abs(profile.mean) > profile.band)


def test_a_constant_is_told_once_and_what_is_left_without_the_strongest_profile_is_told_without_it():
    x = motion()
    (everywhere,) = regions_of(x, noise(0) + 0.2)
    assert everywhere.is_constant
    assert everywhere.residual == pytest.approx(0.2, abs=0.01)
    (faint,) = regions_of(x, noise(0) + 0.004)  # in no bin
    assert faint.is_constant
    v_shape = regions_of(x, noise(0) + 0.1 * np.abs(x.velocity))  # of one sign over every quantity
    assert not any(region.is_constant for region in v_shape) and v_shape[0].axis == "velocity"
    sway = Samples(x.time, np.sin(x.time), np.cos(x.time), x.torque)  # over time it stands out, too
    residual = noise(0) + 0.1 * np.sign(sway.velocity)
    top, rest = remove_strongest(compute_profiles(sway, residual, NOISE), sway, residual)
    assert top.axis == "velocity" and regions_of(sway, rest) == []
    both = noise(0) + 0.1 * np.sign(x.velocity) + 0.08 * np.sin(2 * x.position)
    top, rest = remove_strongest(compute_profiles(x, both, NOISE), x, both)
    assert top.axis == "velocity" and regions_of(x, rest)[0].axis == "position"


def test_a_negligible_mean_is_no_region():
    x = motion()
    profiles = compute_profiles(x, noise(0) + 0.1 * np.sign(x.velocity), NOISE, negligible=0.2)
    assert find_regions(profiles) == [] and all((profile.band >= 0.2).all() for profile in profiles)


@pytest.mark.parametrize("order", [5, 12, 31])
def test_a_torque_that_repeats_over_the_angle_has_bins_enough_and_its_order(order):
    time = np.arange(6000) * 0.005
    x = Samples(time, 1.8 * np.sin(0.9 * time), 1.62 * np.cos(0.9 * time), np.sin(0.7 * time))
    cogs = noise(0, 6000) + 0.1 * np.cos(order * x.position + 1)
    profile = compute_profile("position", x.position, cogs, NOISE)
    waves = order * np.ptp(x.position) / (2 * np.pi)
    assert len(profile.mean) >= 4 * waves and len(find_runs(profile)) >= 2 * waves - 2
    spectrum = compute_order_spectrum(x.position, cogs, NOISE)
    assert spectrum is not None and spectrum.middle[np.argmax(spectrum.mean)] == order
    assert spectrum.mean.max() == pytest.approx(0.1, rel=0.1)
    assert regions_of(x, cogs)[0].peak == order
    assert len(compute_profile("position", x.position, noise(0, 6000), NOISE).mean) == REGIONS.bins


def test_the_angle_of_a_joint_that_turns_is_told_within_a_turn():
    rng = np.random.default_rng(3)
    time = np.arange(6000) * 0.005
    x = Samples(time, 0.9 * time + rng.uniform(-3, 3, 6000), rng.standard_normal(6000), rng.standard_normal(6000))
    cogs = noise(0, 6000) + 0.1 * np.cos(12 * x.position)
    around = compute_profiles(x, cogs, NOISE, ["position"])[0]
    assert around.unit == "rad within a turn" and around.edges[0] >= -np.pi and around.edges[-1] <= np.pi
    middle = 0.5 * (around.edges[1:] + around.edges[:-1])
    assert np.corrcoef(around.mean, np.cos(12 * middle))[0, 1] > 0.99
    regions = [r for r in regions_of(x, cogs) if r.axis == "position"]
    assert len(regions) == pytest.approx(24, abs=1)
    assert all(region.unit == "rad within a turn" for region in regions)
    half = compute_profiles(Samples(time, x.position / 5, x.velocity, x.torque), cogs, NOISE, ["position"])[0]
    assert half.unit == "rad" and half.edges[-1] > np.pi  # a joint with stops keeps its angles


@pytest.mark.parametrize("hertz", [0.4, 3.0, 11.0])
def test_an_oscillation_in_time_is_found_at_its_frequency(hertz):
    x = motion()
    residual = noise(0) + 0.03 * np.sin(2 * np.pi * hertz * x.time + 1)
    (region,) = [r for r in regions_of(x, residual) if r.axis == "frequency"]
    assert region.low - 0.05 < hertz < region.high + 0.05
    assert region.residual == pytest.approx(0.03, rel=0.2)


@pytest.mark.slow
def test_white_noise_has_no_region():
    assert [regions_of(motion(seed), noise(seed)) for seed in range(40)] == [[]] * 40


def test_a_profile_is_the_mean_in_bins_of_equal_count_with_its_standard_error():
    x = motion()
    residual = noise(0)
    found = compute_profile("position", x.position, residual, NOISE)
    for k in range(len(found.mean)):
        low, high = found.edges[k], found.edges[k + 1]
        inside = (x.position >= low) & ((x.position < high) | (k == len(found.mean) - 1))
        assert inside.sum() == pytest.approx(len(residual) / len(found.mean), abs=1.5)
        assert found.mean[k] == pytest.approx(residual[inside].mean())
        assert found.error[k] == pytest.approx(NOISE / np.sqrt(inside.sum()))


def test_no_bin_has_both_directions():
    """A residual of the sign of the velocity has its size in each bin."""
    rare = np.where(np.arange(100) < 7, -0.5, 1.0) * np.linspace(0.1, 1.0, 100)
    coarse = np.round(2 * motion().velocity) / 2 + 0.25
    for velocity in (motion().velocity + 1.3, rare, coarse):
        profile = compute_profile("velocity", velocity, 0.1 * np.sign(velocity), NOISE)
        assert (np.diff(profile.edges) > 0).all()
        assert np.abs(profile.mean) == pytest.approx(0.1)


def test_the_spectrum_reads_amplitudes_though_samples_are_missing():
    x = motion()
    kept = np.random.default_rng(0).random(1500) < 0.4
    found = compute_spectrum(x.time[kept], 0.5 * np.sin(2 * np.pi * 4 * x.time[kept]), NOISE)
    peak = int(np.argmax(found.mean))
    assert found.edges[peak] - 0.05 < 4 < found.edges[peak + 1] + 0.05
    assert found.mean[peak] == pytest.approx(0.5, rel=0.15)


@pytest.mark.parametrize("rows", [2, 9, 25, 100])
def test_few_samples_and_values_that_do_not_vary_are_no_error(rows):
    x = motion(rows=rows)
    assert all(np.isfinite(item.mean).all() for item in compute_profiles(x, noise(0, rows), NOISE))
    still = Samples(x.time, np.zeros(rows), x.velocity, np.full(rows, 2.0))
    assert regions_of(still, noise(0, rows)) == []
