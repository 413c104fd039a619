"""Rest of a servo near its goal: the band within dry friction, and the sag under its load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.findings import Finding, Quantity
from estimators.signals.motion import get_known_load
from pendulum_env.physics import Model, Samples
from pendulum_env.physics.potential import WEIGHT
from pendulum_env.recording import Recording
from robots.servos.torque import find_drive, get_bus_voltage, list_drives

PASSING = ("presliding", "friction_drift")  # ids of effects that leave the dry friction of a long rest as it is
ROUNDS = 50  # of dry friction that depends on the torque; errors fall by its coefficient, at most 0.7, in each
AIM = np.deg2rad(1.0)  # [rad], distance from the goal below which a rest is close
SLOW = 0.05  # [rad/s], largest speed of a sample at which the weight is that at rest
TYPICAL = 95  # percentile of the weight over the samples, without outliers


@dataclass(frozen=True)
class RestBand(Finding):
    """Distance from its goal within which a servo rests.

    Attributes:
        distance: largest one, of friction and weight together.
        friction: the part by dry friction over the stiffness.
        weight: the part by the weight over the stiffness, in the recorded postures.
        kp: gain of the drive.
        factor: the gain over `kp` with which the distance would be one degree.
    """

    distance: Quantity
    friction: Quantity
    weight: Quantity
    kp: float
    factor: float


def find_rest_band(model: Model, recordings: Sequence[Recording]) -> RestBand | None:
    """Find the distance from its goal within which a servo rests; None if it is small, or an integral removes it.

    At rest, |K (goal - q) - w| <= F with the stiffness K, the weight w and the dry friction F: the goal is at most
    (F + |w|) / K away. The recording with the least stiffness counts. Dry friction that depends on the torque is that
    at the torque F + |w|.
    """
    driven = [one for one in recordings if any(d.acts_on_position and not d.ki for d in list_drives([one]))]
    if not driven or len(driven) < len(recordings):
        return None
    stiffness = [find_drive(one).kp * float(np.mean(find_drive(one).scale(get_bus_voltage(one)))) for one in driven]
    softest = int(np.argmin(stiffness))
    recording, factor = driven[softest], stiffness[softest]
    speed = np.abs(np.gradient(recording.position, recording.time))
    rows = speed <= max(SLOW, float(np.percentile(speed, 10)))
    rest = np.zeros(int(rows.sum()))
    x = Samples(recording.time[rows], recording.position[rows], rest, rest, load=get_known_load(recording).select(rows))
    terms = [term for term in model.terms for _ in term.columns]
    parts_of_model = [*zip(terms, model.columns, model.theta, strict=True)]
    weights = [(column, value) for term, column, value in parts_of_model if term.id in WEIGHT or term.is_weight]
    rubbing = [
        (column, max(value, 0.0))
        for term, column, value in parts_of_model
        if not (term.id in (*WEIGHT, *PASSING) or term.is_weight)
    ]
    weight, friction = np.abs(rest + sum(value * column.force(x) for column, value in weights)), rest
    for _ in range(ROUNDS):
        held = Samples(x.time, x.position, rest, weight + friction, load=x.load)
        friction = rest + sum(value * column.dry(held) for column, value in rubbing)
    parts = [float(np.percentile(np.abs(part), TYPICAL)) / factor for part in (friction, weight, friction + weight)]
    if not parts[2] > AIM:
        return None
    unit = model.units().unit("rad")
    band, sag, distance = (Quantity(part, unit=unit) for part in parts)
    return RestBand(distance, band, sag, find_drive(recording).kp, parts[2] / AIM)
