"""The benchmark of ambiguous diagnoses: what counts as undecided, and that its cases repeat and are poor indeed."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import ambiguity
from benchmarks.ambiguity import BRIEF, POOR, SUGGESTED, examine, poor_study, record, undecided
from estimators.diagnosis.suggestion import Aim


def test_undecided_is_what_some_torque_could_decide():
    suggestion = SimpleNamespace(settles=(Aim("spring", "gravity"), Aim("stribeck")))
    groups = (("torque_offset", "coulomb_asymmetry", "gravity_tilt"),)
    alike = (groups[0][:2],)
    found = SimpleNamespace(ambiguous=groups, inseparable=alike, suggestion=suggestion)
    assert undecided(found) == {frozenset(("torque_offset", "gravity_tilt")), frozenset(("spring", "gravity"))}
    assert not undecided(SimpleNamespace(ambiguous=(), inseparable=(), suggestion=None))


@pytest.mark.slow
@pytest.mark.parametrize("poor", POOR, ids=lambda poor: poor.__name__)
def test_poor_experiments_repeat_and_the_second_differs(poor):
    study = next(s for s in (poor_study(np.random.default_rng(k), 9) for k in range(99)) if s.poor is poor)
    first, again, second = (record(study, BRIEF, poor, number) for number in (0, 0, 1))
    np.testing.assert_array_equal(first.position, again.position)
    assert (first.torque != second.torque).any()
    if poor.__name__ == "one_way":
        assert (np.diff(first.position) > -1e-4).all()  # but for counts
    else:
        assert np.ptp(first.position) < np.pi


def test_where_nothing_is_suggested_the_case_counts_as_not_settled(monkeypatch):
    study = poor_study(np.random.default_rng(0), 0)
    (effect,) = study.case.plant.effects
    clear = {"ambiguous": (), "inseparable": (), "suggestion": None, "selected": (effect,), "unexplained": ()}
    first = clear | {"ambiguous": ((effect, "gravity_tilt"),), "selected": ()}
    monkeypatch.setattr(ambiguity, "record", lambda *_: None)
    monkeypatch.setattr(
        ambiguity, "diagnose", lambda runs, **_: SimpleNamespace(**(first if len(runs) == 1 else clear))
    )
    row = examine(study)
    assert row.failure == "" and row.open
    assert {arm: bool(left) for arm, left in row.left.items()} == {arm: arm == SUGGESTED for arm in ambiguity.ARMS}
    assert not row.settled[SUGGESTED] and row.settled["more of the same"]
