"""States of effects, simulated along the windows of recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.weak_form.windows import Windows
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.term import trace_variants


def select_driving_samples(w: Windows, kind: type[Term]) -> Samples:
    """Return the input samples (N,) of an effect: raw positions for impacts and transmissions, else smoothed."""
    return w.unsmoothed if kind.has_impacts or kind.kind == "transmission" else w.samples


def trace_all(windows: Sequence[Windows], variants: Sequence[Term]) -> list[list[Samples]]:
    """Return, per recording and variant of one effect, the driving samples with the variant's states.

    States restart in each segment. Samples of an effect without state are unchanged.
    """
    kind = type(variants[0])
    driving = [select_driving_samples(w, kind) for w in windows]
    if not kind.has_state():
        return [[x] * len(variants) for x in driving]
    segments, commands, periods = [], [], []  # one of each segment
    for w, x in zip(windows, driving, strict=True):
        for rows in w.recording.segment_slices:
            temperature = np.broadcast_to(x.temperature, x.time.shape)[rows]
            motion = x.time[rows], x.position[rows], x.velocity[rows], x.torque[rows]
            segments.append(Samples(*motion, temperature=temperature))
            commands.append(w.recording.torque[rows])
            periods.append(1.0 / w.recording.rate)
    if kind.has_own_trace():
        arguments = zip(segments, commands, periods, strict=True)
        memories = iter([[variant.trace(*segment) for variant in variants] for segment in arguments])
    else:
        memories = iter(trace_variants(variants, segments, commands, periods))
    traces = []
    for w, x in zip(windows, driving, strict=True):
        of_segments = [next(memories) for _ in w.recording.starts]
        states = [
            tuple(np.concatenate(series) for series in zip(*(segment[v] for segment in of_segments), strict=True))
            for v in range(len(variants))
        ]
        traces.append([replace(x, memory=kind.name_memory(memory)) for memory in states])
    return traces
