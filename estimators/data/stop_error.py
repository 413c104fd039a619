"""Standard errors of the ends of a hard stop."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.signals.differentiation import estimate_encoder_noise
from pendulum_env._typing import Array
from pendulum_env.physics import Estimate, Model
from pendulum_env.recording import Recording

CROSSING = 5.0  # least step of the motion across an end, in standard deviations of the encoder's noise


def widen_ends(model: Model, recordings: Sequence[Recording]) -> Model:
    """Return the model with standard errors of a stop's ends of at least the step of the motion across them.

    The force of a stop begins at an angle between two samples. A few contacts have no scatter that would show this
    error: the least error of an end is the RMS step of the position across it, over the root of the number of contacts.
    """
    changed = dict[str, Estimate]()
    for term in (term for term in model.terms if term.has_impacts):
        for name in {parameter.name for parameter in term.free} & {"lower", "upper"}:
            end = model.estimates[term.get_full_name(name)]
            steps = np.concatenate([_list_steps(recording, end.value) for recording in recordings])
            if len(steps):  # two for each contact
                least = float(np.sqrt(np.mean(steps**2) / (0.5 * len(steps))))
                changed[term.get_full_name(name)] = replace(end, std=max(end.std, least))
    return replace(model, estimates={**model.estimates, **changed}) if changed else model


def _list_steps(recording: Recording, end: float) -> Array:
    """Return the steps of the position across an angle, in both directions [rad]; noise crosses it by smaller steps."""
    is_beyond, steps = recording.position > end, np.diff(recording.position)
    steps[[start - 1 for start in recording.starts if start]] = 0.0  # gaps
    is_crossed = (is_beyond[1:] != is_beyond[:-1]) & (
        np.abs(steps) > CROSSING * estimate_encoder_noise(recording.position)
    )
    return np.asarray(steps[is_crossed])
