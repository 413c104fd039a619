"""Decide the undeclared conventions of the controllers of a log.

Controllers update their integral before or after they compute the output, and treat it differently while the output is
at its limit. The derivative part acts on the measured velocity, or on the derivative of the error. Each convention is
fitted by the base model, with held goals and with goals that run on, since a wrong reading of the goals hides the
convention. The first convention, in the order of the choices of a drive, is taken that no other predicts
significantly better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.rows import BLOCK
from estimators.findings import Finding, Kind, Quantity
from estimators.in_loop.counts import find_encoder_step
from estimators.in_loop.fit import LinearErrors, choose_likeliest_point, compute_log_densities
from estimators.in_loop.goals import with_goals
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.rollouts import FINE, Rollouts
from estimators.selection.criterion import Criterion
from estimators.selection.score import Bootstrap
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env.physics import Term
from pendulum_env.recording import Recording
from pendulum_env.servo.drive import Reading, list_open_conventions

SAME = 1e-3  # [nat], smaller gains mean equal motion: the output does not reach its limit


def read_controller(recordings: Sequence[Recording], base: Sequence[Term], part: Part = WHOLE) -> Finding | None:
    """Decide how the controllers act; return None if no drive leaves a convention open.

    The finding has the gain over the likeliest other convention [nat], and the settings of the drives as pairs.
    """
    conventions = list_open_conventions([r.drive for r in recordings if r.drive is not None])
    if len(conventions) == 1:
        return None
    readings = (True, False) if any(r.drive is not None and r.drive.goal is None for r in recordings) else (True,)
    variants = [
        tuple(r if r.drive is None else replace(r, drive=r.drive.complete_conventions(settings)) for r in goals)
        for settings in conventions
        for goals in (with_goals(recordings, is_held) for is_held in readings)
    ]
    torque = RegressionData.from_recordings(recordings, part=part).torque
    rollouts = [Rollouts(variant, FINE, shares=part).without_counts for variant in variants]
    fits: dict[int, LinearErrors] = {}
    for _ in range(3):  # a fit under a wrong convention may end far off, and others start from it
        for k, simulated in enumerate(rollouts):
            rows = RolloutRows(simulated, torque)
            if fits:
                known = [fits[n].point for n in sorted(fits, key=lambda n: n != k)]  # its own first
                start = choose_likeliest_point(simulated, known)[0]
                if k in fits and start is known[0]:
                    continue
                rows.set_start(start, tuple(base))
            rows.fit(base, exactly=True)
            fits[k] = rows.linearise_at_fit(base)
    blocks, _, of_block = rollouts[0].blocks(BLOCK)
    scores = [
        np.bincount(blocks, compute_log_densities(variant_rollouts, fits[k].error)).astype(float)
        for k, variant_rollouts in enumerate(rollouts)
    ]
    scores = [max(scores[k : k + len(readings)], key=np.sum) for k in range(0, len(scores), len(readings))]
    bootstrap = Bootstrap(of_block, np.random.default_rng(0))
    best, *others = sorted(range(len(scores)), key=lambda k: -scores[k].sum())
    gains = [bootstrap.gain(scores[best], score, float(np.log(len(scores)))) for score in scores]
    chosen = next(k for k, gain in enumerate(gains) if k == best or gain.p_value > Criterion().p_value)
    different = [k for k in others if abs(scores[best].sum() - scores[k].sum()) > SAME] or others
    gain = bootstrap.gain(scores[chosen], scores[best if chosen != best else different[0]])
    pairs = tuple(conventions[chosen].items())
    return Finding(Kind.CONTROLLER_READ, {"gain": Quantity(gain.total, gain.error)}, pairs=pairs)


def read_position(recordings: Sequence[Recording], base: Sequence[Term], part: Part = WHOLE) -> Finding | None:
    """Decide whether the controllers read counts of the encoder; return None if that is declared or cannot matter.

    Both readings are fitted by the base model and compared in counts. Counts are taken if they are likelier by more
    than a standard error. The finding has the gain over the other reading [nat], and the reading as a pair. Declared
    counts are a finding too if the log shows no step of the encoder: then exact positions are simulated.
    """
    if not all(r.actuator.acts_on_position for r in recordings):
        return None
    declared = {r.actuator.reads for r in recordings} - {None}
    if find_encoder_step(recordings) is None:
        return Finding(Kind.COUNTS_UNSEEN) if "counts" in declared else None
    if declared:
        return None
    torque = RegressionData.from_recordings(recordings, part=part).torque
    densities = []
    for reads in get_args(Reading):  # counts first
        rollouts = Rollouts(with_reading(recordings, reads), FINE, shares=part, has_counts=True)
        rows = RolloutRows(rollouts, torque)
        rows.fit(base, exactly=True)
        density = compute_log_densities(rollouts, rows.linearise_at_fit(base).error)
        blocks, _, of_block = rollouts.blocks(BLOCK)
        densities.append(np.bincount(blocks, density).astype(float))
    gain = Bootstrap(of_block, np.random.default_rng(0)).gain(densities[0], densities[1])
    reads, total = ("counts", gain.total) if gain.total > gain.error else ("exact", -gain.total)
    return Finding(Kind.POSITION_READ, {"gain": Quantity(total, gain.error)}, pairs=(("reads", reads),))


def with_reading(recordings: Sequence[Recording], reads: Reading | None) -> tuple[Recording, ...]:
    """Return the recordings with the reading of the position of all drives that do not declare it."""
    return tuple(
        r if r.drive is None or r.drive.reads else replace(r, drive=replace(r.drive, reads=reads)) for r in recordings
    )
