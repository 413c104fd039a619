"""The score: predictions of blocks that were not fitted, and how sure their sum is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from estimators.decisions.score import FOLDS, NU, Blocks, Bootstrap, cross_validate_density, predict_density
from estimators.regression.balance import Balance


def linear(phi: np.ndarray, y: np.ndarray) -> Balance:
    """Equations that do not depend on the torque."""
    count, size = phi.shape
    free = np.full(size, np.inf)
    return Balance(phi, y, np.zeros_like(phi), -free, free, np.ones(count))


def blocks(recordings: int, each: int, rows: int) -> Blocks:
    """`each` blocks of `rows` equations in each of some recordings."""
    block = np.repeat(np.arange(recordings * each), rows)
    of_block = np.repeat(np.arange(recordings), each)
    return Blocks(block, of_block[block], of_block, block)


def data(seed: int, where: Blocks, size: int = 3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((len(where.block), size))
    return phi, phi @ np.arange(1.0, size + 1) + 0.3 * rng.standard_normal(len(phi))


def test_a_stretch_is_predicted_by_the_fit_of_the_others():
    where = blocks(2, 20, 30)
    phi, y = data(0, where)
    found = cross_validate_density(linear(phi, y), where)
    for block in (0, 7, 25):
        fold, own = where.fold == block % FOLDS, where.recording == where.of_block[block]
        theta = np.linalg.lstsq(phi[~fold], y[~fold], rcond=None)[0]
        error = y - phi @ theta
        _, _, scale = student.fit(error[own & ~fold], fdf=NU, floc=0)
        expected = student.logpdf(error[where.block == block], NU, scale=scale).sum()
        assert found[block] == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_a_difference_of_models_does_not_depend_on_the_unit_of_torque(unit):
    where = blocks(1, 20, 30)
    phi, y = data(1, where)
    one, other = (cross_validate_density(linear(phi[:, :size], y), where) for size in (3, 2))
    scaled, rescaled = (cross_validate_density(linear(unit * phi[:, :size], unit * y), where) for size in (3, 2))
    assert scaled - rescaled == pytest.approx(one - other, abs=1e-6)


def test_a_recording_counts_by_its_own_scale():
    """The louder of two recordings does not drown what the quieter one tells."""
    where = blocks(2, 20, 30)
    phi, y = data(2, where)
    theta = np.array([1.0, 2.0, 3.0])
    loud = y + np.where(where.recording == 1, 50.0, 0.0) * np.random.default_rng(0).standard_normal(len(y))
    gains = [
        predict_density(theta, linear(phi, values), where) - predict_density(0.9 * theta, linear(phi, values), where)
        for values in (y, loud)
    ]
    first = where.of_block == 0
    assert gains[1][first].sum() == pytest.approx(gains[0][first].sum())
    assert gains[0][first].sum() > 100


def test_errors_far_below_the_least_scale_count_alike():
    """Errors of rounding in a recording at rest, which one model has and another lacks, decide nothing."""
    where = replace(blocks(2, 20, 30), least_scale=1e-3)
    moving = where.recording == 0
    y = np.where(moving, np.random.default_rng(0).standard_normal(len(moving)), 0.0)
    column = np.where(moving, 0.0, 1e-9)[:, None]
    gain = predict_density(np.zeros(1), linear(column, y), where) - predict_density(
        np.ones(1), linear(column, y), where
    )
    assert gain == pytest.approx(0.0, abs=1e-6)


def test_a_column_of_noise_predicts_no_better_and_a_true_one_does():
    rng = np.random.default_rng(3)
    useless, useful = 0, 0
    for seed in range(20):
        where = blocks(1, 20, 25)
        phi, y = data(seed, where)
        bootstrap = Bootstrap(where.of_block, np.random.default_rng(0))
        with_noise = np.column_stack([phi, rng.standard_normal((len(y), 3))])
        full = cross_validate_density(linear(phi, y), where)
        useless += bootstrap.gain(cross_validate_density(linear(with_noise, y), where), full, 3.0).p_value < 0.05
        useful += bootstrap.gain(full, cross_validate_density(linear(phi[:, :2], y), where), 3.0).p_value < 0.05
    assert useless == 0
    assert useful == 20


def test_noise_that_a_model_takes_out_counts_as_error_all_the_same():
    where = blocks(1, 20, 30)
    phi, y = data(4, where)
    square = 0.3**2
    smoothed = linear(phi, phi @ [1.0, 2.0, 3.0] + 0.5 * (y - phi @ [1.0, 2.0, 3.0]))  # the same with half the noise
    honest = cross_validate_density(smoothed, where, [(slice(None), 0.75 * square)]).sum()
    assert honest == pytest.approx(cross_validate_density(linear(phi, y), where).sum(), abs=len(y) * 0.05)
    assert cross_validate_density(smoothed, where).sum() > honest + len(y) * 0.5


# ------------------------------------------------------------------------------------------------ what is sure of a sum


def chance(differences: list[list[float]]) -> float:
    """Chance that nothing is gained, from the differences of each recording's blocks."""
    owner = np.repeat(np.arange(len(differences)), [len(own) for own in differences])
    after = np.concatenate([np.asarray(own, dtype=float) for own in differences])
    return Bootstrap(owner, np.random.default_rng(0)).gain(after, np.zeros(len(after)), 5.0).p_value


def test_what_repeats_is_sure_and_what_happens_once_or_in_one_recording_alone_is_not():
    assert chance([[10.0] * 20]) == chance([[30.0] * 20]) == 0.0
    assert chance([[200.0] + [0.0] * 19]) > 0.01  # a single block may be a glitch
    assert chance([[100.0] * 6 + [0.0] * 14]) < 1e-3  # a stop that is hit now and then
    assert chance([[30.0] * 10, [20.0] * 10]) < 1e-2
    assert chance([[30.0] * 10, [-10.0] * 10]) > 0.1


def test_the_standard_error_is_that_of_a_sum_of_independent_stretches():
    rng = np.random.default_rng(5)
    totals, errors = [], []
    for _ in range(300):
        differences = 2.0 + 3.0 * rng.standard_normal(40)
        gain = Bootstrap(np.zeros(40, dtype=int), np.random.default_rng(0)).gain(differences, np.zeros(40))
        totals.append(gain.total)
        errors.append(gain.error)
    assert np.mean(errors) == pytest.approx(np.std(totals), rel=0.15)
    assert np.mean(totals) == pytest.approx(80.0, abs=4.0)


def test_models_that_predict_alike_share_the_probability_and_a_worse_one_gets_none():
    rng = np.random.default_rng(6)
    density = rng.standard_normal(30)
    bootstrap = Bootstrap(np.zeros(30, dtype=int), np.random.default_rng(0))
    found = bootstrap.probabilities([density, density, density - 3.0])
    assert found == pytest.approx([0.5, 0.5, 0.0], abs=1e-6)
    unsure = bootstrap.probabilities([density, density + 4.0 * rng.standard_normal(30)])
    assert unsure.sum() == pytest.approx(1.0)
    assert 0.02 < unsure.min()  # a difference that scatters so decides nothing


def test_rows_with_a_bound_of_their_error_have_no_share_in_the_scale_of_the_noise():
    """Rows in contact repeat one small residual, and would make the noise of the others an outlier."""
    where = blocks(1, 20, 30)
    phi, y = data(3, where)
    theta = np.array([1.0, 2.0, 3.0])
    is_bounded = where.block % 2 == 1
    y[is_bounded] = (phi @ theta)[is_bounded]
    without = replace(where, is_bounded=is_bounded)
    clear = slice(0, None, 2)
    exact = student.fit((y - phi @ theta)[~is_bounded], fdf=NU, floc=0)[2]
    expected = student.logpdf(y - phi @ theta, NU, scale=exact)
    found = predict_density(theta, linear(phi, y), without)
    np.testing.assert_allclose(found[clear], np.bincount(where.block, expected)[clear], atol=0.5)
    assert (predict_density(theta, linear(phi, y), where)[clear] < found[clear] - 1.0).all()


def test_a_recording_that_is_all_in_contact_does_not_change_the_scale_of_another():
    where = blocks(2, 10, 30)
    phi, y = data(4, where)
    theta = np.array([1.0, 2.0, 3.0])
    is_bounded = (where.recording == 1) | (where.block % 2 == 1)
    alone = blocks(1, 10, 30)
    one = replace(alone, is_bounded=is_bounded[: len(alone.block)])
    both = predict_density(theta, linear(phi, y), replace(where, is_bounded=is_bounded))
    first = slice(0, len(alone.block))
    np.testing.assert_allclose(both[:10], predict_density(theta, linear(phi[first], y[first]), one))
    assert np.isfinite(both).all()
