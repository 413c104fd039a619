"""Zero of a position that is the integral of a velocity: it is set where the joint hangs."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from estimators.regression.least_squares import IdentificationError, solve, subtract_known_columns
from estimators.weak_form.preparation import prepare_windows
from pendulum_env.physics import BASE, SIGNIFICANT
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.recording import Recording


def set_integrated_zero(recording: Recording) -> Recording:
    """Return a recording whose integrated position is zero where the joint hangs, by a fit of tilted gravity.

    The zero stays as it is if gravity is not significant, or if the motion is too short.
    """
    if not recording.has_integrated_position or recording.units.is_prismatic:
        return recording
    terms = [*BASE, GravityTilt()]
    names = [column.name for term in terms for column in term.columns]
    known = {"inertia": recording.known_inertia} if recording.known_inertia else {}  # of a free swing
    unknown = [name for name in names if name not in known]
    gravity, tilt = (unknown.index(name) for name in ("gravity", "gravity_tilt"))
    with suppress(IdentificationError):
        windows = prepare_windows([recording])
        places = [names.index(name) for name in known]
        equations = subtract_known_columns(windows.equations(terms), places, np.array([*known.values()]))
        fit = solve(equations, windows.weights, windows.clusters)
        if np.hypot(*fit.theta[[gravity, tilt]]) > SIGNIFICANT * np.hypot(*fit.std[[gravity, tilt]]):
            angle = float(np.arctan2(fit.theta[tilt], fit.theta[gravity]))
            return replace(recording, position=recording.position + angle)
    return recording
