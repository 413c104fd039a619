"""The usual alternative, for comparison: sparse regression (SINDy) over the columns of all candidates at once.

Sequentially thresholded least squares of pysindy gets what the diagnosis gets: the torque balance averaged over windows
clear of stick, the base terms, and every effect at the shape parameters that suit it best beside the base model. Its
threshold is the sparsest one whose error on the held-out recording is within a few per cent of the least.
Source: Brunton, Proctor and Kutz, PNAS 113(15), 2016.
"""

from __future__ import annotations

import importlib
import importlib.util
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.scoring import Exact, compare
from benchmarks.truth import Truth, read_pair
from estimators.preprocessing import gather
from estimators.selection.models import Models
from estimators.selection.moves import candidates
from estimators.weak_form.dataset import Dataset
from pendulum_env.physics import BASE, Term

Array = NDArray[np.float64]

THRESHOLDS = np.geomspace(0.003, 0.5, 25)  # of a column's contribution, as a share of the torque
SLACK = 1.03  # ratio of held-out errors within which the sparser model is taken


@dataclass(frozen=True)
class Selection:
    """What sparse regression selects in one case."""

    truth: Truth
    selected: tuple[str, ...] = ()
    failure: str = ""

    @property
    def right(self) -> bool:
        """Whether it is what is hidden; effects outside the library count as right where nothing is selected."""
        return not self.failure and compare(self.truth.hidden, self.selected, (), True) is Exact.YES


def is_installed() -> bool:
    """Whether pysindy can be imported."""
    return importlib.util.find_spec("pysindy") is not None


def select_sparsely(truth: Truth, folder: Path) -> Selection:
    """Effects whose columns survive the thresholding."""
    try:
        train, holdout = read_pair(folder, truth.name)
        models = Models(*gather([train], [holdout]))
        terms = [longer[-1] for longer in candidates(models, BASE)]
        return Selection(truth, _survivors(models.train.data, models.holdout.data, terms))
    except Exception as error:  # the other cases still count
        return Selection(truth, failure=f"{type(error).__name__}: {error}")


def _survivors(train: Dataset, holdout: Dataset, terms: list[Term]) -> tuple[str, ...]:
    pysindy = importlib.import_module("pysindy")
    phi, owners = _columns(train, terms)
    y = train.torque()
    unseen, wanted = _columns(holdout, terms)[0], holdout.torque()
    norms, size = np.linalg.norm(phi, axis=0), float(np.linalg.norm(y))
    used = norms > 1e-9 * norms.max()
    scaled = phi[:, used] * size / norms[used]  # a coefficient is the column's contribution as a share of the torque
    results = []
    for threshold in THRESHOLDS:
        optimizer = pysindy.STLSQ(threshold=float(threshold), alpha=1e-8, max_iter=100)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of thresholds that leave nothing
            optimizer.fit(scaled, y[:, None])
        kept = np.zeros(len(norms), bool)
        kept[used] = optimizer.coef_[0] != 0
        theta = np.zeros(len(norms))
        theta[kept] = np.linalg.lstsq(phi[:, kept], y, rcond=None)[0]
        results.append((float(np.linalg.norm(wanted - unseen @ theta)), kept))
    least = min(error for error, _ in results)
    kept = next(kept for error, kept in reversed(results) if error <= SLACK * least)
    return tuple(dict.fromkeys(owner for owner, keeps in zip(owners, kept, strict=True) if keeps and owner))


def _columns(data: Dataset, terms: list[Term]) -> tuple[Array, list[str]]:
    """Columns (R, P) of the base terms and effects, and the effect that owns each, "" for the base.

    An effect without a linear parameter gives its fixed column, whose true coefficient is one.
    """
    columns, owners = [], []
    for term in (*BASE, *terms):
        ((linear, fixed),) = data.columns([term])
        own = np.column_stack([linear, fixed]) if term.fixed else linear
        columns.append(own)
        owners += ["" if term in BASE else term.id] * own.shape[1]
    return np.column_stack(columns), owners
