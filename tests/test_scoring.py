"""Scores of the benchmarks: what counts as right."""

import pytest

from benchmarks.hidden_effects import reliability
from benchmarks.scoring import Claim, Exact, Outcome, compare
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


def test_a_score_is_right_if_its_effect_or_one_of_its_group_is_hidden() -> None:
    truth = Truth("one", ("coulomb_asymmetry",), {}, 500.0, None, 0.02)
    claims = Claim("torque_offset", 0.97), Claim("coulomb_asymmetry", 0.4, is_selected=False), Claim("spring", 0.6)
    outcome = Outcome(truth, ("torque_offset", "spring"), (OFFSETS,), claims=claims)
    assert reliability([outcome]).bins == ((0.5, 0.7, 0, 1, 0.6), (0.95, 0.99, 1, 1, 0.97))
