"""Refits of models of servos with shorter steps of the integrator."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from estimators.data.fits import fit_terms
from estimators.data.model_errors import compute_errors
from estimators.data.regression_data import RegressionData
from estimators.data.standard_errors import widen_by_constant
from estimators.decisions.errors import Step, Terms
from estimators.decisions.gate import Gate
from estimators.diagnosis.case import Trial
from estimators.findings import Finding
from estimators.memoize import memoized
from estimators.selection.evidence import Evidence, Hypothesis
from estimators.selection.fits import Fits
from estimators.selection.gates import require_gain_in_torque
from estimators.selection.policies import Rule
from estimators.selection.search import SearchResult
from estimators.weak_form.point import Point
from pendulum_env.physics import SIGNIFICANT, Model, Term, list_ids
from robots.servos.in_loop.profile import LikelihoodProfile, widen_by_profile
from robots.servos.in_loop.rollout_rows import RolloutRows


def refit(result: SearchResult, start: Model | None = None) -> SearchResult:
    """Refit all steps of a search with shorter steps of the integrator; `start` is not used."""
    return replace(result, steps=[refit_step(result.evidence, step) for step in result.steps])


def require_share_in_loop(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the share of the squared error in the loop that `after` explains, in fitted and in held-out data.

    The share is at least `needed`; for a link `dominant` if the residual is not noise.
    """
    evidence, limits, ids = after.evidence, after.evidence.criterion.loop, list_ids(before.terms)
    adds_link = any(term.link for term in after.terms if term.id not in ids)
    least = limits.dominant if adds_link and not evidence.residuals.is_noise(after.terms) else limits.needed
    models = [evidence.fits.fit_model(each.terms) for each in (after, before)]
    errors = [[compute_errors(part, model).motion_errors[0] for model in models] for part in evidence.fits.parts]
    share = min(1.0 - (new / old) ** 2 for new, old in errors)
    yield Gate("explained_share", share, least, share > least)


NEED_IN_LOOP = Rule("need in loop", (require_share_in_loop, require_gain_in_torque))


def refine(trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
    """Refit all steps with shorter steps of the integrator, and drop effects that are then not needed.

    An effect is needed if it predicts better and its size differs from zero by more than 3 standard errors. Prediction
    alone is not sufficient: a servo that sticks a little earlier or later changes seconds of the motion. An effect must
    also explain a share of the squared error, see `require_share_in_loop`.
    """
    result = refit(trial.result)
    last = result.steps[-1]
    train, held_out = refine_rows(result.evidence)
    fits, steps = Fits(make_data(train), make_data(held_out), result.evidence.fits.base), result.steps
    evidence = result.evidence.with_fits(fits)
    terms_by_ids = {list_ids(step.model.terms): step.model.terms for step in steps}
    terms, effects = result.terms, [step.added for step in steps[1:]]

    def without(*left_out: str | None) -> Terms:
        return tuple(term for term in terms if term.id not in left_out)

    def find_idle() -> list[str | None]:
        without_size = {term.id for term in last.model.terms if term.columns and not has_size(last.model, term)}
        return [
            id for id in effects if id in without_size or not evidence.decide(terms, without(id), NEED_IN_LOOP).passed
        ]

    while idle := find_idle():
        effects.remove(idle[-1])
        remaining = without(idle[-1])
        terms = terms_by_ids.get(list_ids(remaining)) or train.fits.fit_nonlinear(remaining)
        last = fit_step(result.evidence, effects[-1] if effects else None, terms)
    if len(effects) == len(steps) - 1:
        return result, ()
    earlier = [fit_step(result.evidence, id, without(*effects[k + 1 :])) for k, id in enumerate(effects[:-1])]
    return replace(result, steps=[steps[0], *earlier, *([last] if effects else [])]), ()


def has_size(model: Model, term: Term) -> bool:
    """Return whether the linear parameters of a term together differ from zero by more than 3 standard errors."""
    names = list(model.estimates)
    indices = [names.index(column.name) for column in term.columns]
    values = np.array([model.estimates[names[k]].value for k in indices])
    covariance = model.assumed_covariance[np.ix_(indices, indices)]
    return bool(values @ np.linalg.pinv(covariance) @ values > SIGNIFICANT**2)


@memoized
def make_data(rows: RolloutRows) -> RegressionData:
    """Return the data of a regression by rollouts."""
    return RegressionData(rows.torque.data, rollouts=rows)


def refine_rows(evidence: Evidence) -> tuple[RolloutRows, RolloutRows]:
    """Return the rows of fitted and held-out rollouts with shorter steps of the integrator."""
    train, held_out = (part.rollouts for part in evidence.fits.parts)
    assert isinstance(train, RolloutRows) and isinstance(held_out, RolloutRows)
    return train.fine, held_out.fine


def refit_step(evidence: Evidence, step: Step, start: Point | None = None) -> Step:
    """Refit a step with shorter steps of the integrator, from a start, by default its parameters."""
    start = start or Point.from_parameters(step.model.terms, np.asarray(step.model.theta))
    refine_rows(evidence)[0].fits.set_start(start)
    return fit_step(evidence, step.added, start.terms)


def fit_step(evidence: Evidence, added: str | None, terms: Sequence[Term]) -> Step:
    """Fit terms with shorter steps of the integrator; return the step with its errors on fitted and held-out rollouts.

    A parameter with many local minima is fitted by its profile.
    """
    train, held_out = refine_rows(evidence)
    terms = train.fit(terms).terms
    profile = train.fits.fit_by_profile(terms)
    terms = terms if profile is None else profile.point.terms
    model, recording = widen_errors(fit_terms(make_data(train), terms)[0], train, profile), train.rollouts.recordings[0]
    constant = recording.torque_constant  # its error widens all standard errors
    model = model.convert_units(recording.units) if constant is None else widen_by_constant(model, constant)
    errors = [compute_errors(make_data(rows), model) for rows in (train, held_out)]
    return Step(added, model, dict(zip(("train", "holdout"), errors, strict=True)))


def widen_errors(model: Model, rows: RolloutRows, profile: LikelihoodProfile | None = None) -> Model:
    """Widen the standard errors of a model by a profile, by the error of the clock, and by the counts of the encoder.

    The covariance includes the change of the parameters with delayed goals and controllers. It also includes
    their change with dry friction: a simulated controller that reads the exact position sticks, a real one may creep.
    """
    point = Point.from_model(model)
    near, rollouts = rows.fits.linearise(model.terms), rows.rollouts
    by_nonlinear, nonlinear = rows.nonlinear_jacobian(model.terms, point.theta)
    slopes = np.column_stack([near.slopes[:, : len(point.theta)], by_nonlinear])
    errors = [each.without_counts.compute_position_errors([point]) for each in (rollouts, *rollouts.mistimed)]
    weights = near.weights[:, None]
    delayed_errors = np.column_stack(errors[1:]) - errors[0]
    changes = np.linalg.lstsq(weights * slopes, -weights * delayed_errors, rcond=None)[0]
    names = [*(column.name for column in model.columns), *nonlinear]
    indices = [list(model.estimates).index(name) for name in names]
    covariance = model.assumed_covariance[np.ix_(indices, indices)]
    if profile is not None:
        covariance = widen_by_profile(names, covariance, profile)
    covariance += changes @ changes.T
    if "coulomb" in names and covariance[names.index("coulomb"), names.index("coulomb")] > 0:
        by_friction = covariance[names.index("coulomb")] / covariance[names.index("coulomb"), names.index("coulomb")]
        covariance += np.outer(by_friction, by_friction) * rollouts.creep_torque**2
    return model.with_errors(names, covariance)
