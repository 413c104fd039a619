"""Standard errors of gravity in a model with an effect of the angle: within part of a turn, other laws fit equally."""

from collections.abc import Iterator

import numpy as np

from estimators.data.variants import rank_variants, refine_variants
from estimators.decisions.errors import Terms
from estimators.selection.candidates import can_reproduce
from estimators.selection.evidence import Evidence
from estimators.selection.policies import KEEP_BASE, SWAP_HELD_OUT
from estimators.selection.state import remove_term
from pendulum_env.physics import SIGNIFICANT, Estimate, Gravity, Model, Term, list_ids

TURN = 2 * np.pi  # range of angles from which gravity differs from any other law of the angle [rad]


def list_angle_effects(model: Model, base: Terms) -> list[Term]:
    """List the torques by angle in a model of a pendulum, without those of its base.

    A stop acts at the end of the range only. A tilt is gravity too, but it competes with other laws.
    """
    added = (term for term in model.terms if term.id not in list_ids(base))
    return [term for term in added if term.kind == "potential" and not (term.has_impacts or term.is_free_form)]


def widen_by_law(model: Model, evidence: Evidence) -> Model:
    """Add the error of the law of the angle to the standard errors and correlations of a model of a pendulum.

    Within part of a turn, other laws may replace an effect of the angle and fit equally, with another gravity. The
    error of gravity reaches from its value to that of the farthest law, and includes the latter's error. Parameters of
    the effects change with gravity by their covariance.

    Args:
        model: fitted to the training data of `evidence`.
        evidence: compares the laws of its library.
    """
    effects, estimate = list_angle_effects(model, evidence.fits.base), model.estimates.get(Gravity.id)
    low, high = evidence.train.get_range()
    if not effects or estimate is None or not estimate.std or model.is_prismatic or high - low >= TURN:
        return model
    gravity = evidence.fits.fit_with_std(model.terms).model.estimates[Gravity.id]
    rivals = (rival for effect in effects for rival in _list_rivals(evidence, model.terms, effect))
    variances = [(other.value - gravity.value) ** 2 + other.std**2 for other in rivals]
    added = max(variances, default=0.0) - gravity.std**2
    if added <= 0:
        return model
    names = list(model.estimates)
    slopes = model.assumed_covariance[names.index(Gravity.id)] / estimate.std**2  # of all parameters by gravity
    competing = (Gravity.id, *(column.name for effect in effects for column in effect.columns))
    return model.add_errors({name: slopes[names.index(name)] * np.sqrt(added) for name in competing})


def _list_rivals(evidence: Evidence, terms: Terms, effect: Term) -> Iterator[Estimate]:
    """Yield gravity with another law in the place of an effect of the angle, where held-out data allow that law.

    The law must keep the inertia and the sign of gravity of the model without the effect, see `KEEP_BASE`. Its
    gravity is at most twice that of this model. A law that contains the effect, as a spring that may harden, counts
    only if it changes gravity significantly: the simpler law is likelier.
    """
    others = remove_term(terms, effect)
    laws = [law for law in evidence.library.values() if law.kind == "potential" and not law().has_impacts]
    with_effect, without = (
        evidence.fits.fit_with_std(own).model.estimates[Gravity.id].value for own in (terms, others)
    )
    for law in (law for law in laws if law.id not in list_ids(others)):
        trials = [*rank_variants(evidence.train, others, law), *refine_variants(evidence.train, others, law)]
        for rival in dict.fromkeys(trial.terms for trial in trials):
            if (
                not evidence.decide(terms, rival, SWAP_HELD_OUT).passed
                and evidence.decide(rival, others, KEEP_BASE).passed
            ):
                gravity = evidence.fits.fit_with_std(rival).model.estimates[Gravity.id]
                is_other = abs(gravity.value - with_effect) > SIGNIFICANT * gravity.std
                if abs(gravity.value) <= 2 * abs(without) and (
                    is_other or not can_reproduce(evidence, rival[-1], effect)
                ):
                    yield gravity
