"""Estimation from measurements: six schemes, recursive least squares, comparison and diagnosis."""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from estimators.checks.channel import align
    from estimators.comparison import compare
    from estimators.data.fit_data import FitData
    from estimators.decisions.criterion import Criterion
    from estimators.diagnosis.addition import add
    from estimators.diagnosis.result import Addition, Diagnosis
    from estimators.diagnosis.run import diagnose
    from estimators.diagnosis.torque_search import fit
    from estimators.findings import Verdict
    from estimators.prediction import Prediction
    from estimators.regression.least_squares import IdentificationError
    from estimators.results import Comparison
    from estimators.schemes.identification import identify
    from estimators.schemes.result import Identification
    from estimators.schemes.six import SCHEMES, scheme
    from estimators.search_hints import SearchHints, set_hints
else:
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = [
    "SCHEMES",
    "Addition",
    "Comparison",
    "Criterion",
    "Diagnosis",
    "FitData",
    "Identification",
    "IdentificationError",
    "Prediction",
    "SearchHints",
    "Verdict",
    "add",
    "align",
    "compare",
    "diagnose",
    "fit",
    "identify",
    "scheme",
    "set_hints",
]
