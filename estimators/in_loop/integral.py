"""Decide how the controllers of a log integrate their error.

Controllers add the error of a turn before or after they compute the output, and differ in what the integral does while
the output is at its limit. Each convention is fitted by the base model. The first one, in the order of the choices of a
drive, that no other predicts significantly better is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, get_args

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
from pendulum_env.servo.drive import Order, ServoDrive, Windup

Settings = tuple[tuple[str, str | None], ...]  # of a drive


def read_integral(recordings: Sequence[Recording], base: Sequence[Term], part: Part = WHOLE) -> Finding | None:
    """Decide how the controllers integrate; return None if no drive has an integral whose convention is open.

    The finding has the gain over the likeliest other convention [nat], and the settings of `with_integral` as pairs.
    """
    tried = dict[tuple[ServoDrive | None, ...], tuple[tuple[Recording, ...], Settings]]()
    for windup, order in product(get_args(Windup), get_args(Order)):
        variant = with_integral(recordings, {"windup": windup, "integral": order})
        tried.setdefault(tuple(r.drive for r in variant), (variant, (("windup", windup), ("integral", order))))
    if len(tried) == 1:
        return None
    torque = RegressionData.from_recordings(recordings, part=part).torque
    scores, points = list[Array](), list[Point]()
    for _ in range(3):  # a wrong convention leads a fit astray, and others begin where it ended
        scores.clear()
        for variant, _ in tried.values():
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
    gain = bootstrap.gain(scores[chosen], scores[best if chosen != best else others[0]])
    settings = [pairs for _, pairs in tried.values()][chosen]
    return Finding(Kind.INTEGRAL_READ, {"gain": Quantity(gain.total, gain.error)}, pairs=settings)


def with_integral(recordings: Sequence[Recording], settings: Mapping[str, Any]) -> tuple[Recording, ...]:
    """Return the recordings with `windup` and `integral` of drives that have an integral and do not declare them.

    The order of a turn has no meaning without the `rate` of the controller.
    """
    found = []
    for recording in recordings:
        drive = recording.drive
        if drive is not None and drive.ki:
            drive = replace(drive, windup=drive.windup or settings.get("windup"))
            if drive.rate is not None:
                drive = replace(drive, integral=drive.integral or settings.get("integral"))
        found.append(replace(recording, drive=drive))
    return tuple(found)
