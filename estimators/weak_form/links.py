"""Windowed equations of an arm: those of its joints in a row, with the links' columns, which all joints' motion makes.

A window of a joint is clear of that joint's stick and reversals; others may stick meanwhile. The rigid body's columns
are linear in the acceleration, <w Y(q, q', q'')> = <w M(q) q''> + <w Y(q, q', 0)>: the first takes raw differences,
of which only averages are meaningful, the second is smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.regression.equations import IdentificationError
from estimators.weak_form.dataset import Dataset, Given, choose_half_width, dataset, quieter, smooth_laws
from estimators.weak_form.windows import Rows, Windows, cut
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links
from pendulum_env.arms.recording import ArmRecording

FEWEST = 20  # windows of each joint
PLACES = 50  # samples of each recording over which a joint's inertia is averaged


def prepare_arm(recordings: Sequence[ArmRecording], links: Links) -> Dataset:
    """Windowed equations of recordings of an arm, in `links`, terms at joints, or both.

    Raises:
        IdentificationError: if a joint hardly moves clear of stick.
    """
    entries = [
        [
            replace(cut(joint, width), at=name, run=run)
            for name, joint in zip(links.body.joints, recording.joints, strict=True)
        ]
        for run, recording in enumerate(recordings)
        for width in [max(choose_half_width(joint) for joint in recording.joints)]
    ]
    for k, name in enumerate(links.body.joints):
        if sum(len(own[k].centers) for own in entries) < FEWEST:
            names = ", ".join(recording.name for recording in recordings)
            raise IdentificationError(
                f"{names}: joint '{name}' is hardly ever clear of stick and reversals: record longer, faster or wider "
                "motion"
            )
    parts = [_columns(own, links.body) for own in entries]
    calibrated, linear, rates = [], [], []
    for k in range(len(links.body.joints)):  # the windows of a joint stand in a row
        for own, part in zip(entries, parts, strict=True):
            calibrated.append(_calibrated(own[k], part.linear[k], part.inertia[k]))
            linear.append(part.linear[k])
            rates.append(part.rates[k])
    inertia = np.mean([part.inertia for part in parts], axis=0)
    return dataset(calibrated, {links.id: Given(np.concatenate(linear), np.concatenate(rates), inertia)})


@dataclass(frozen=True)
class _Columns:
    """Links' columns of one recording, joint by joint."""

    linear: list[Array]  # (R_k, P)
    rates: list[Array]
    inertia: Array  # (n, P)


def _columns(entries: Sequence[Windows], body: Body) -> _Columns:
    q, v, a = (
        np.column_stack(series)
        for series in zip(*((w.samples.position, w.samples.velocity, w.acceleration) for w in entries), strict=True)
    )
    smooth, heavy = body.torque(q, v, np.zeros_like(v)), body.momentum(q, a)  # (N, n, P)

    def averaged(rows: Rows, k: int) -> Array:
        return np.asarray(rows.wider @ smooth[:, k] + rows.narrow @ heavy[:, k])

    some = q[:: max(1, len(q) // PLACES)]
    units = (np.broadcast_to(unit, some.shape) for unit in np.eye(len(entries)))
    inertia = [body.momentum(some, unit)[:, k].mean(axis=0) for k, unit in enumerate(units)]
    return _Columns(
        [averaged(w.rows, k) for k, w in enumerate(entries)],
        [averaged(w.rates, k) for k, w in enumerate(entries)],
        np.array(inertia),
    )


def _calibrated(w: Windows, linear: Array, inertia: Array) -> Windows:
    """Windows whose noise is no more than what links and every smooth law of the joint leave of the torque."""
    beside = [law for law in smooth_laws(w) if law.id not in ("inertia", "gravity")]
    phi = np.column_stack([linear, *(w.columns([law])[0][0] for law in beside)])
    return quieter(w, phi, lambda theta: float(inertia @ theta[: len(inertia)]))
