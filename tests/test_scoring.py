"""Scores of the benchmarks: what counts as right, and that the truth is told in the models' own names and signs."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import known_truth
from benchmarks.hidden_effects import reliability
from benchmarks.independent_plant import random_case, simulate, write_case
from benchmarks.scoring import Claim, Exact, Outcome, compare, wilson
from benchmarks.truth import Truth

OFFSETS = ("torque_offset", "coulomb_asymmetry")


@pytest.mark.parametrize(
    ("hidden", "selected", "groups", "unexplained", "expected"),
    [
        ((), (), (), False, Exact.YES),
        ((), ("spring",), (), False, Exact.NO),
        (("spring",), ("spring",), (), True, Exact.YES),
        (("spring", "cogging"), ("cogging", "spring"), (), False, Exact.YES),
        (("spring", "cogging"), ("spring",), (), False, Exact.NO),
        (("spring",), ("spring", "cogging"), (), False, Exact.NO),
        (("coulomb_asymmetry",), ("torque_offset",), (OFFSETS,), False, Exact.AMBIGUOUS),
        (("coulomb_asymmetry",), ("torque_offset",), (), False, Exact.NO),
        (("coulomb_asymmetry",), (), (OFFSETS,), False, Exact.NO),
        (("knocks",), (), (), True, Exact.YES),
        (("knocks",), (), (), False, Exact.NO),
        (("knocks",), ("spring",), (), True, Exact.NO),
    ],
)
def test_only_the_truth_is_exact(hidden, selected, groups, unexplained, expected) -> None:
    assert compare(hidden, selected, groups, unexplained) is expected


def test_wilson_interval_is_that_of_the_textbook() -> None:
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert wilson(45, 50) == pytest.approx((0.7864, 0.9565), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_a_score_is_right_if_its_effect_or_one_of_its_group_is_hidden() -> None:
    truth = Truth("one", ("coulomb_asymmetry",), {}, 500.0, None, 0.02)
    claims = Claim("torque_offset", 0.97), Claim("coulomb_asymmetry", 0.4, is_selected=False), Claim("spring", 0.6)
    outcome = Outcome(truth, ("torque_offset", "spring"), (OFFSETS,), claims=claims)
    assert reliability([outcome]).bins == ((0.5, 0.7, 0, 1, 0.6), (0.95, 0.99, 1, 1, 0.97))


@pytest.mark.slow
def test_known_truth_prints_a_line_for_each_recording_and_totals(tmp_path: Path, capsys) -> None:
    case = random_case(np.random.default_rng(3), ["torque_offset"], rate=200.0, seconds=6.0, excitation="two_tone")
    train, holdout = simulate([(case.plant, case.train), (case.plant, case.holdout)])
    write_case(tmp_path, "one", train, holdout)
    assert known_truth.main([str(tmp_path), "--workers", "1"]) == 0
    printed = capsys.readouterr().out
    assert "one " in printed and "false alarms where nothing is hidden" in printed
