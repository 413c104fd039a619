from .alignment import align
from .comparison import compare
from .data.fit_data import FitData
from .decisions.criterion import Criterion
from .decisions.decision import Decision
from .diagnosis.addition import add
from .diagnosis.result import Addition, Diagnosis
from .diagnosis.run import diagnose
from .diagnosis.torque_search import fit
from .findings import Finding, Quantity, Verdict
from .identification import identify
from .prediction import Prediction
from .regression.least_squares import IdentificationError
from .results import Comparison
from .schemes.result import Identification
from .schemes.six import SCHEMES, scheme
from .search_hints import SearchHints, set_hints
from .simulated_motion import simulate

__all__ = [
    "SCHEMES",
    "Addition",
    "Comparison",
    "Criterion",
    "Decision",
    "Diagnosis",
    "Finding",
    "FitData",
    "Identification",
    "IdentificationError",
    "Prediction",
    "Quantity",
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
    "simulate",
]
