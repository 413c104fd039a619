"""A recording in a notebook: its summary, the remarks made at reading, and its curves."""

import numpy as np

from pendulum_env.notebook import BLUE, GREEN, ORANGE, Curve, bullets, card, paragraph, plot, shown
from pendulum_env.recording.record import Recording
from pendulum_env.words import unit


@shown.register
def show_recording(recording: Recording) -> str:
    """A recording: length and rate, what was changed at reading, what it lacks, and its curves."""
    signals = [
        ("position q", recording.position, "rad", BLUE),
        ("torque", recording.torque, recording.torque_unit, ORANGE),
    ]
    if recording.velocity is not None:
        signals.insert(1, ("velocity q'", recording.velocity, "rad/s", GREEN))
    remarks = [*recording.notes]
    if not recording.torque.any():
        remarks.append("torque is never applied: only ratios of parameters can be known")
    plots = [
        plot(f"{label} [{unit(symbol)}] over {recording.duration:.3g} s", recording.time, curves)
        for label, values, symbol, color in signals
        for curves in [[Curve(own, color) for own in np.atleast_2d(values.T)]]  # a joint each
    ]
    return card(f"Recording {recording.name}", paragraph(recording.summary), bullets(remarks), *plots)
