"""What many estimates show together: named where it is, and not where it is not."""

import numpy as np
import pytest
from scipy import stats

from estimators import fleet
from estimators.fleet import course, odd_ones, onset, pool, significant, weigh

WEEKS = np.arange(10.0)


def test_a_line_is_recovered_with_its_error():
    rng = np.random.default_rng(0)
    error = rng.uniform(0.5, 2.0, 10)
    found = [course(WEEKS, 3 + 2.0 * WEEKS + error * rng.standard_normal(10), error) for _ in range(400)]
    lines = [one for one in found if one.first is None]
    assert len(lines) > 0.95 * 400  # no step leaves less
    slopes, errors = np.array([(one.change, one.change_error) for one in lines]).T
    assert np.mean(slopes) == pytest.approx(2.0, abs=0.02)
    covered = np.mean(np.abs(slopes - 2.0) < 1.96 * errors)
    assert 0.93 < covered < 1.0  # scatter that happens to be small is not believed


@pytest.mark.parametrize("excess", [1.0, 5.0])
def test_no_more_changes_than_chance_are_seen_whether_or_not_the_errors_tell_all_of_the_scatter(excess):
    rng = np.random.default_rng(1)
    p_values = np.array([course(WEEKS, excess * rng.standard_normal(10), np.ones(10)).p_value for _ in range(1000)])
    for level in (0.01, 0.05):
        assert np.mean(p_values < level) < level + 3 * np.sqrt(level / 1000)


def test_scatter_is_told_from_change():
    rng = np.random.default_rng(2)
    wild = course(WEEKS, 20 * rng.standard_normal(10), np.ones(10))
    assert wild.p_value > 1e-3 and wild.excess > 5


def test_the_two_tests_are_those_of_the_book_times_the_shapes_that_are_tried():
    value = np.array([1.0, 2.5, 2.0, 4.5, 4.0, 6.5])
    time = np.arange(6.0)
    fit = stats.linregress(time, value)
    wide = course(time, value, np.full(6, 0.1))  # scatter beyond the errors: F test, as without known errors
    assert wide.change == pytest.approx(fit.slope) and wide.change_error == pytest.approx(fit.stderr)
    assert wide.p_value == pytest.approx(4 * fit.pvalue)  # a line, and a step at three places
    narrow = course(time, 5 + 0.5 * time, np.ones(6))  # no scatter: chi-square
    assert narrow.p_value == pytest.approx(4 * stats.chi2.sf(0.5**2 * np.sum((time - 2.5) ** 2), 1))


def test_a_step_is_found_where_it_is():
    rng = np.random.default_rng(8)
    step = 5.0 + 30.0 * (WEEKS >= 6)
    shuffled = rng.permutation(10)  # the order in which estimates are told is none of time
    found = [course(WEEKS[shuffled], (step + 3 * rng.standard_normal(10))[shuffled], np.ones(10)) for _ in range(50)]
    assert {WEEKS[shuffled][one.first] for one in found} == {6} and max(one.p_value for one in found) < 1e-3
    assert np.std([(one.change - 30) / one.change_error for one in found]) == pytest.approx(1.0, abs=0.4)
    outlier = course(WEEKS, 5.0 + 30.0 * (WEEKS == 9), np.ones(10))
    assert outlier.first != 9 and outlier.p_value > 0.01


def test_too_few_estimates_tell_no_change():
    few = course(WEEKS[:3], np.array([1.0, 2.0, 3.0]), np.full(3, 0.01))
    assert np.isnan(few.p_value) and few.level == pytest.approx(2.0) and few.first is None
    assert np.isnan(course(np.zeros(5), np.arange(5.0), np.ones(5)).p_value)
    assert course(WEEKS[:1], np.ones(1), np.ones(1)).excess == 1.0


def test_holm_is_as_in_the_paper_and_passes_over_what_was_not_tested():
    named = significant(np.array([0.01, 0.04, 0.03, 0.005, np.nan]), 0.05)
    assert named.tolist() == [True, False, False, True, False]


def test_one_that_differs_is_told_from_siblings_that_all_differ_a_little():
    rng = np.random.default_rng(3)
    false = 0
    for _ in range(300):
        value, error = rng.normal(10, 0.5, 8), np.full(8, 0.05)  # they differ by more than their errors
        false += sum(one.p_value < 0.01 for one in odd_ones(value, error))
        value[2] += 8
        odd = odd_ones(value, error)
        assert min(range(8), key=lambda k: odd[k].p_value) == 2
    assert false < 0.025 * 300 * 8
    assert np.isnan(odd_ones(np.arange(3.0), np.ones(3))[0].p_value)  # two others are too few


def test_an_effect_sets_in_where_it_does():
    found = onset(WEEKS, WEEKS >= 6)
    assert found.first == 6 and found.p_value < 0.05
    assert found.p_value == pytest.approx(1 / 210)  # of 10 over 4 orders
    rng = np.random.default_rng(4)
    pattern = np.array([0, 0, 1, 0, 1, 0, 1, 1, 0, 1], dtype=bool)
    observed = onset(WEEKS, pattern).p_value
    shuffled = [onset(WEEKS, rng.permutation(pattern)).p_value for _ in range(1500)]
    assert np.mean(np.array(shuffled) <= observed + 1e-9) == pytest.approx(observed, abs=0.04)  # exact
    assert onset(WEEKS, np.ones(10, dtype=bool)) is None and onset(np.zeros(4), np.arange(4) > 1) is None


def test_what_is_weak_in_each_is_sure_in_all_and_noise_is_not():
    rng = np.random.default_rng(5)
    error, one_form = np.full(20, 3.0), np.ones(20, dtype=int)
    weak = pool(rng.normal(2.5, 3, 20), error, one_form, rivals=22)
    assert weak.total == pytest.approx(50, abs=30) and weak.p_value < 0.05
    assert pool(np.array([2.5]), error[:1], one_form[:1], rivals=22).p_value > 0.5
    sure = [pool(rng.normal(0, 3, 20), error, one_form, rivals=22).p_value < 0.05 for _ in range(200)]
    assert np.mean(sure) < 0.05


def test_what_one_case_shows_is_not_said_of_all_and_choosing_among_forms_gains_nothing():
    gain = np.full(20, -1.0)
    gain[7] = 300.0
    assert pool(gain, np.ones(20), np.ones(20, dtype=int), rivals=22).p_value > 0.05
    chosen = np.random.default_rng(6).normal(0, 1, (20, 60)).max(axis=1)  # the best of sixty forms of nothing
    assert pool(chosen, np.ones(20), np.full(20, 60), rivals=22).p_value > 0.5


def test_effects_that_look_alike_share_the_probability():
    rng = np.random.default_rng(7)
    gain = rng.normal(3, 1, 30)
    alike = np.column_stack([gain, gain + rng.normal(0, 0.1, 30), gain - 2, np.full(30, np.nan)])
    share = weigh(alike)
    assert share.sum() == pytest.approx(1) and share[:2].min() > 0.1 and share[2:].max() < 1e-3


def test_of_many_cases_some_are_drawn_together_to_the_same_weights(monkeypatch):
    rng = np.random.default_rng(8)
    gains = rng.normal(0.02, 1, (600, 1)) + rng.normal(0, 0.05, (600, 3))
    one_by_one = weigh(gains)
    monkeypatch.setattr(fleet, "FEWEST", fleet.Fewest(summed=50))
    assert weigh(gains) == pytest.approx(one_by_one, abs=0.03)
    assert one_by_one.max() - one_by_one.min() > 0.1  # there is something to tell
