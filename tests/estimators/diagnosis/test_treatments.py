"""Treatments of the recordings: which are kept, and what a diagnosis records of them."""

import pytest

from estimators.diagnosis.treatments import is_better
from estimators.findings import Kind
from tests.cases import diagnosed


@pytest.mark.parametrize(
    ("error_ratio", "assumptions", "before", "is_kept"),
    [
        (0.5, 3, 0, True),  # predicts better
        (0.98, 1, 0, False),  # as well, by one more effect
        (0.98, 1, 1, True),
        (1.02, 0, 1, True),  # as well, by less
        (1.5, 0, 2, False),
        (float("nan"), 0, 0, False),
    ],
)
def test_treatment_is_kept_where_its_model_predicts_better_or_is_simpler(error_ratio, assumptions, before, is_kept):
    assert is_better(error_ratio, assumptions, before, margin=0.05) is is_kept


@pytest.mark.slow
def test_diagnosis_records_the_treatments_that_were_tried():
    found = diagnosed("bouncing")
    (tried,) = found.treatments
    assert tried.treatment.kind is Kind.IMPACTS_INCLUDED and tried.is_kept and tried.error_ratio < 0.5
    assert found.data.has_treatment(Kind.IMPACTS_INCLUDED)
    (row,) = found.json()["treatments"]
    assert row["kind"] == "impacts_included" and row["kept"] and row["assumptions"] == {"with": 2, "without": 0}
