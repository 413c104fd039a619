"""Decide how the controllers of a log integrate their error.

Controllers add the error of a turn before or after they compute the output, and differ in what the integral does while
the output is at its limit. Each convention is fitted by the base model. The first one, in the order of the choices of a
drive, that no other predicts significantly better is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.rows import BLOCK
from estimators.findings import Finding, Kind, Quantity
from estimators.in_loop.fit import choose_likeliest_point, densities
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.rollouts import FINE, Rollouts
from estimators.selection.criterion import Criterion
from estimators.selection.score import Bootstrap
from estimators.simulation.output_error import Point
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.recording import Recording
from pendulum_env.servo.drive import find_declared_integral, list_integral_settings

SAME = 1e-3  # [nat], below which two conventions give one motion: the output does not reach its limit


def read_integral(recordings: Sequence[Recording], base: Sequence[Term], part: Part = WHOLE) -> Finding | None:
    """Decide how the controllers integrate; return None if no drive has an integral whose convention is open.

    The finding has the gain over the likeliest other convention [nat], and the settings of `with_integral` as pairs.
    """
    conventions = list_integral_settings([r.drive for r in recordings if r.drive is not None])
    if len(conventions) == 1:
        return None
    variants = [with_integral(recordings, settings) for settings in conventions]
    torque = RegressionData.from_recordings(recordings, part=part).torque
    scores, points = list[Array](), list[Point]()
    for _ in range(3):  # a wrong convention leads a fit astray, and others begin where it ended
        scores.clear()
        for variant in variants:
            rows = RolloutRows(Rollouts(variant, FINE, shares=part), torque)
            if points:
                rows.begin_at(choose_likeliest_point(rows.rollouts, points)[0], tuple(base))
            rows.fit(base, exactly=True)
            near = rows.near(base)
            blocks, _, of_block = rows.rollouts.blocks(BLOCK)
            scores.append(np.bincount(blocks, densities(rows.rollouts, near.error)).astype(float))
            points.append(near.point)
    bootstrap = Bootstrap(of_block, np.random.default_rng(0))
    best, *others = sorted(range(len(scores)), key=lambda k: -scores[k].sum())
    gains = [bootstrap.gain(scores[best], score, float(np.log(len(scores)))) for score in scores]
    chosen = next(k for k, gain in enumerate(gains) if k == best or gain.p_value > Criterion().p_value)
    different = [k for k in others if abs(scores[best].sum() - scores[k].sum()) > SAME] or others
    gain = bootstrap.gain(scores[chosen], scores[best if chosen != best else different[0]])
    pairs = tuple(conventions[chosen].items())
    return Finding(Kind.INTEGRAL_READ, {"gain": Quantity(gain.total, gain.error)}, pairs=pairs)


def with_integral(recordings: Sequence[Recording], settings: Mapping[str, str | None]) -> tuple[Recording, ...]:
    """Return the recordings with `ServoDrive.with_integral` of their drives."""
    return tuple(r if r.drive is None else replace(r, drive=r.drive.with_integral(settings)) for r in recordings)


def find_declared_settings(recordings: Sequence[Recording]) -> dict[str, str]:
    """Return the `windup` and `integral` that the first drive of some recordings declares, by name."""
    return find_declared_integral([r.drive for r in recordings if r.drive is not None])
