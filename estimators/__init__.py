"""What learns from measurements: six schemes, recursive least squares, comparison and diagnosis."""

from estimators.compare import Comparison, compare
from estimators.diagnose import Addition, add, diagnose, fit, gather
from estimators.diagnosis import Diagnosis, Verdict
from estimators.equations import IdentificationError
from estimators.evidence import Errors, Evidence, fit_terms
from estimators.identify import Identification, identify
from estimators.schemes import SCHEMES, scheme

__all__ = [
    "SCHEMES",
    "Addition",
    "Comparison",
    "Diagnosis",
    "Errors",
    "Evidence",
    "Identification",
    "IdentificationError",
    "Verdict",
    "add",
    "compare",
    "diagnose",
    "fit",
    "fit_terms",
    "gather",
    "identify",
    "scheme",
]
