"""Effects of the library whose torque is most like the residual of a model."""

from collections.abc import Collection
from dataclasses import dataclass

from estimators.data.regression_data import RegressionData
from estimators.data.variants import rank_variants
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.physics.joints import list_effects


@dataclass(frozen=True)
class Match:
    """Effect fitted to the data beside the terms of a model.

    Attributes:
        effect: id of the effect.
        share: share of the mean square of the residual that it explains.
        torque: the residual without it minus that with it (R,) [N m].
    """

    effect: str
    share: float
    torque: Array


def find_matches(data: RegressionData, model: Model, without: Collection[str] = ()) -> list[Match]:
    """Fit each further effect of the library to the residual of a model, the best first; leave some out."""
    before, matches = data.residual(model.terms, model.theta), list[Match]()
    for id, kind in list_effects(model.mechanism).items():
        if id not in (*model.effects, *without) and (ranked := rank_variants(data, model.terms, kind)):
            after = data.residual(ranked[0].terms)
            matches.append(Match(id, 1 - float(after @ after) / float(before @ before), before - after))
    return sorted(matches, key=lambda match: -match.share)
