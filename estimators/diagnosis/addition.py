"""One effect added to a model by choice: in torque and free runs, or of servos in the loop."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.arguments import HasModel, Recordings, chosen_recordings, model_that_moves, that_may_show, within_limits
from estimators.checks.torque_constant import told
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.diagnosis.in_loop import Looped, with_back_emf
from estimators.diagnosis.reasons import BY_CHANCE, rejection
from estimators.diagnosis.result import Addition
from estimators.diagnosis.setting import Setting
from estimators.findings import Finding
from estimators.free_swings import known_by, restore_known, swing_terms
from estimators.in_loop.rollouts import are_driven
from estimators.progress import Progress, no_progress
from estimators.regression.equations import IdentificationError
from estimators.selection.candidates import best_variant, refit_nonlinear, release_parameters
from estimators.selection.errors import Step
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.motion import refit_by_likelihood
from estimators.selection.physical import confirmation_gates
from estimators.selection.search import SearchResult
from pendulum_env.arguments import check_order
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import kind_at
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.physics.friction import LoadDependentFriction
from pendulum_env.physics.limits import Bounds
from pendulum_env.physics.terms import ids, is_hidden
from pendulum_env.recording import Recording
from pendulum_env.recording.study import format_of


def fit(train: RegressionData, holdout: RegressionData, terms: Sequence[Term] = BASE) -> Step:
    """Fit a model's terms to what `gather` returns, as `diagnose` and `add` do: the model and its errors on both."""
    is_free = all(recording.known_inertia for recording in train.recordings)  # the terms have what is known
    evaluator = ModelEvaluator(train, holdout, base=tuple(terms) if is_free else BASE)
    return refit_by_likelihood(
        SearchResult(evaluator, [evaluator.fit_with_std(None, refit_nonlinear(evaluator, tuple(terms)))])
    ).steps[-1]


def add(
    model: Model | HasModel,
    id: str,
    recordings: Recordings,
    holdout: Recordings = (),
    progress: Progress = no_progress,
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Bounds | None = None,
) -> Addition:
    """Refit a model's terms, then with one more effect; of an arm, nonlinear parameters of its terms stay.

    Args:
        model: to start from.
        id: of the effect, or of a function to be kept as a table, such as `torque_by_angle`; of an arm at one of its
            joints, `stribeck@elbow`.
        recordings: fitted jointly.
        holdout: recordings to confirm on; without them the last 30 % of each recording is held out.
        progress: called with what is being done and the share that is done.
        fixed: values that are known, by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"stribeck": (0.0, 0.5)}`; None is no limit.

    Raises:
        ValueError: if the effect, its joint or a parameter is unknown.
        ModelError: if the model has it already, or has no inertia.
        IdentificationError: if the recordings hold too little motion, or do not show the effect.
        TypeError: if something else is given than a model, an id and recordings.
    """
    check_order("add(model, id, recordings)", (model, Model), (id, Term), (recordings, Recording))
    model = model_that_moves(model)
    body = model.body
    recordings = chosen_recordings(recordings, body=body, log_format=model.log_format)
    holdout = chosen_recordings(holdout, empty=True, body=body, log_format=model.log_format)
    if not isinstance(id, str):
        raise TypeError(f"an effect is added by its id, such as 'stribeck', got {id!r}")
    kind = kind_at(id, body)
    model.add(kind())  # raises if it is there already
    that_may_show({kind.id: kind}, recordings)  # raises if it needs a quantity that none has
    if all(recording.is_free for recording in recordings):
        fixed = known_by(model, fixed)
    terms, library = within_limits(model.terms, {kind.id: kind}, fixed, bounds)
    model, kind = replace(model, terms=terms), library[kind.id]
    setting = Setting(model.terms, library, progress=progress)
    if isinstance(body, Body):
        found = _added_at_joint(recordings, holdout, setting, kind)
    elif are_driven([*recordings, *holdout]):
        found = _added_in_loop(recordings, holdout, setting, kind)
    else:
        found = _added_by_torque(recordings, holdout, setting, kind, model)
    return replace(found, after=found.after.with_log_format(format_of(recordings)))


def _added_by_torque(
    recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting, kind: type[Term], model: Model
) -> Addition:
    """An effect added to a joint, by its torque and its free runs."""
    progress = setting.progress
    progress("reading the motion", 0.0)
    given = FitData.of(recordings, holdout, model.terms)
    original = model.terms
    model = replace(model, terms=swing_terms(original, given.recordings))
    setting, given = replace(setting, base=model.terms), given.with_impacts(model.terms)
    evaluator = setting.evaluator(given.parts)
    before, longer, against = _searched(evaluator, kind)
    progress("refitting", 0.9)
    (shown,) = refit_by_likelihood(SearchResult(evaluator, [before]), model).steps
    more = longer.model.terms[-1]
    start = Model.build((*shown.model.terms, more), np.append(shown.model.theta, np.zeros(len(more.columns))))
    *_, after = refit_by_likelihood(SearchResult(evaluator, [before, longer]), start).steps
    against = rejection(confirmation_gates(after, shown, evaluator.train.motions)) or (
        None if is_hidden(more) else against
    )  # motion tells it
    shown, after = (
        replace(step, model=restore_known(told(step.model, given.parts[0].data), original, given.recordings))
        for step in (shown, after)
    )
    return Addition(shown, after, evaluator.residuals.floors, against, given.doubt)


def _added_at_joint(
    recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting, kind: type[Term]
) -> Addition:
    """An effect added at a joint of an arm."""
    evaluator = setting.evaluator(FitData.of(recordings, holdout, (*setting.base, kind)).parts)
    longer = _longer(evaluator, evaluator.base, kind)
    without, with_it = evaluator.fit_with_std(None, evaluator.base), evaluator.fit_with_std(kind.id, longer)
    against = rejection(confirmation_gates(with_it, without, evaluator.train.motions))
    if against is None and not evaluator.is_significant(longer, evaluator.base):
        against = BY_CHANCE
    return Addition(without, with_it, evaluator.residuals.floors, against)


def _added_in_loop(
    recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting, kind: type[Term]
) -> Addition:
    """An effect added to a servo, by its motion in the loop."""
    rubs = LoadDependentFriction.id in ids((*setting.base, kind()))
    servos = Looped.of(recordings, holdout, with_back_emf(setting, recordings) if rubs else setting)
    before, longer, against = _searched(servos.evaluator, kind)
    shown, after = servos.sharpened(before), servos.sharpened(longer)
    against = rejection(confirmation_gates(after, shown, servos.evaluator.train.motions)) or against
    shown, after = servos.readable(shown), servos.readable(after)
    return Addition(shown, after, servos.evaluator.residuals.floors, against, servos.given.doubt)


def loosened(evaluator: ModelEvaluator, terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """The terms with nonlinear parameters released from their usual values, while that is significant."""
    for looser in sorted(release_parameters(evaluator, terms), key=evaluator.screening_score):
        if evaluator.is_significant(looser, terms) and not evaluator.violations(looser):
            return loosened(evaluator, looser)
    return terms


def _longer(evaluator: ModelEvaluator, terms: tuple[Term, ...], kind: type[Term]) -> tuple[Term, ...]:
    """The terms with the best variant of an effect; raises IdentificationError where the motion does not show it."""
    trial = best_variant(evaluator, terms, kind)
    if trial is None:
        names = ", ".join(dict.fromkeys(recording.name for recording in evaluator.train.recordings))
        raise IdentificationError(f"{names}: nothing there shows {kind.id}", kind.id)
    return trial.terms


def _searched(evaluator: ModelEvaluator, kind: type[Term]) -> tuple[Step, Step, Finding | None]:
    """The base model, the same with the best variant of an effect, and what its gain says against it."""
    evaluator.progress("fitting without it", 0.1)
    before = evaluator.fit_with_std(None, refit_nonlinear(evaluator, evaluator.base))
    evaluator.progress(f"searching {kind.id}", 0.3)
    longer = _longer(evaluator, before.model.terms, kind)
    evaluator.progress(f"fitting with {kind.id}", 0.8)
    terms = refit_nonlinear(evaluator, loosened(evaluator, longer))
    return (
        before,
        evaluator.fit_with_std(kind.id, terms),
        None if evaluator.is_significant(terms, before.model.terms) else BY_CHANCE,
    )
