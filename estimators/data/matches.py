"""Effects of the library whose torque is most like the residual of a model."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.variants import rank_variants
from pendulum_env._typing import Array
from pendulum_env.physics import Model, count_term_parameters
from pendulum_env.physics.effect_texts import find_look_alikes
from pendulum_env.physics.joints import list_effects, place_effects


@dataclass(frozen=True)
class Match:
    """Effect fitted to the data beside the terms of a model.

    Attributes:
        effect: id of the effect.
        share: share of the mean square of the joint's residual that it explains.
        torque: the residual without it minus that with it (R,) [N m].
        size: number of its parameters.
    """

    effect: str
    share: float
    torque: Array
    size: int


def find_matches(data: RegressionData, model: Model, without: Collection[str] = (), at: str = "") -> list[Match]:
    """Fit each further effect of the library at a joint to the residual of a model; leave some out.

    The best comes first, and of shares that are equal to 0.1 % the one with the fewest parameters.
    """
    before, matches, rows = data.residual(model.terms, model.theta), list[Match](), data.data.locate_rows(at)
    for kind in place_effects(list_effects(model.mechanism).values(), model.mechanism):
        if kind.at != at or kind.id in (*model.effects, *without):
            continue
        if ranked := rank_variants(data, model.terms, kind):
            torque = before - data.residual(ranked[0].terms)
            share = 1 - float(np.mean((before - torque)[rows] ** 2)) / float(np.mean(before[rows] ** 2))
            matches.append(Match(kind.id, share, torque, count_term_parameters(ranked[0].terms[-1])))
    return sorted(matches, key=lambda match: (-round(match.share, 3), match.size))


def choose_rivals(matches: Sequence[Match], effect: str) -> list[Match]:
    """Choose an effect from its matches, then the rival that explains most, then the law most like it or the next."""
    own, (best, *others) = ([m for m in matches if (m.effect == effect) == is_own] for is_own in (True, False))
    alike = find_look_alikes(effect.partition("@")[0])
    others.sort(key=lambda match: [*alike, id := match.effect.partition("@")[0]].index(id))
    return [*own, best, *others[:1]]
