"""Fits of given terms, and of one effect beside them, as a diagnosis makes them."""

from collections.abc import Sequence

from estimators.data.regression_data import RegressionData
from estimators.regression.equations import IdentificationError
from estimators.selection.candidates import find_best_variant, refit_nonlinear, release_parameters
from estimators.selection.errors import Step
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.motion import refit_by_likelihood
from estimators.selection.search import SearchResult
from pendulum_env.physics import BASE, Term


def fit(train: RegressionData, holdout: RegressionData, terms: Sequence[Term] = BASE) -> Step:
    """Fit terms to the result of `split_recordings`, as `diagnose` and `add` do: the model and its errors on both."""
    is_free = all(recording.known_inertia for recording in train.recordings)  # the terms have what is known
    evaluator = ModelEvaluator(train, holdout, base=tuple(terms) if is_free else BASE)
    return refit_by_likelihood(
        SearchResult(evaluator, [evaluator.fit_with_std(None, refit_nonlinear(evaluator, tuple(terms)))])
    ).steps[-1]


def release_significant(evaluator: ModelEvaluator, terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """Release nonlinear parameters from their default values, one by one, while the gain is significant."""
    for looser in sorted(release_parameters(evaluator, terms), key=evaluator.screening_score):
        if evaluator.is_significant(looser, terms) and not evaluator.violations(looser):
            return release_significant(evaluator, looser)
    return terms


def fit_effect(evaluator: ModelEvaluator, kind: type[Term]) -> tuple[Step, Step]:
    """Fit the base model, and the same with the best variant of an effect.

    Raises:
        IdentificationError: if the motion does not show the effect.
    """
    evaluator.progress("fitting without it", 0.1)
    before = evaluator.fit_with_std(None, refit_nonlinear(evaluator, evaluator.base))
    evaluator.progress(f"searching {kind.id}", 0.3)
    trial = find_best_variant(evaluator, before.model.terms, kind)
    if trial is None:
        raise IdentificationError(f"{', '.join(evaluator.train.names)}: nothing there shows {kind.id}", kind.id)
    evaluator.progress(f"fitting with {kind.id}", 0.8)
    return before, evaluator.fit_with_std(
        kind.id, refit_nonlinear(evaluator, release_significant(evaluator, trial.terms))
    )
