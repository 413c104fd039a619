"""Free-running simulation against the measured position, in many short segments together.

A segment of `HORIZON` from the measured state is long enough to show a wrong torque. It is short enough to limit the
growing errors of an upright pendulum.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy

from estimators.regression.least_squares import IdentificationError
from estimators.weak_form.point import Point
from estimators.weak_form.traces import trace_all
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import KnownLoad, Samples, Term, Trajectory, simulate
from pendulum_env.physics.simulation import LONGEST_STEP, compile_step, count_substeps, delay_torque
from pendulum_env.physics.term import Memory

HORIZON = 1.0  # [s], default length of a segment
PERTURBATION = 1e-6  # [rad], small error of the initial position


@dataclass(frozen=True)
class Segments:
    """B segments of N periods of one recording, for simulation.

    Attributes:
        windows: windows of the recording.
        first: index of the first sample of each segment (B,).
        torque: held command in each period (N, B) [N m].
        position: measured position (N + 1, B) [rad].
        velocity: smoothed velocity at the start (B,) [rad/s].
        hidden: initial state variables (B,) by id of the term; those of other terms follow from the earlier motion.
    """

    windows: Windows
    first: Index
    torque: Array
    position: Array
    velocity: Array
    hidden: Mapping[str, Memory] = field(default_factory=dict)

    @cached_property
    def load(self) -> KnownLoad:
        """Known load of every segment: inertia and gravity (B,), and its torque over each period (N, B)."""
        x, index = self.windows.samples, self.first + np.arange(len(self.torque))[:, None]
        none, torque = np.zeros(len(self.first)), x.load.get_torque(x.time)
        return KnownLoad(none + x.load.inertia, none + x.load.gravity, 0.5 * (torque[index] + torque[index + 1]))

    def command(self, delay: float) -> Array:
        """Return the held command in every segment, (N, B) [N m], `delay` [s] late; zero before the recording."""
        if delay == 0:
            return self.torque
        recording = self.windows.recording
        reach = np.arange(-int(np.ceil(delay * recording.rate)) - 1, 0)[:, None] + self.first
        begins = np.array(recording.starts)[np.searchsorted(recording.starts, self.first, side="right") - 1]
        before = np.where(reach >= begins, recording.torque[np.maximum(reach, 0)], 0.0)
        return delay_torque(self.torque, before, delay * recording.rate)


def choose_segments(windows: Windows, seconds: float = HORIZON, covers: bool = False) -> Segments:
    """Cut a recording into segments that start away from reversals, where the velocity is most accurate.

    With `covers`, a last segment covers the rest at the end, and overlaps the previous segment.
    """
    recording = windows.recording
    length = count_periods(windows, seconds)
    keeps_direction = np.r_[False, np.diff(np.sign(windows.samples.velocity)) == 0]
    clear = scipy.ndimage.distance_transform_cdt(keeps_direction & windows.moving)
    clear = np.minimum(clear, len(windows.kernel))
    reach = round(0.2 * seconds * recording.rate)
    first = []
    for earliest, stop in list_spans(windows):
        latest = stop - length - 1
        begins = np.arange(earliest, latest + 1, length)
        for nominal in np.union1d(begins, [latest]) if covers and len(begins) else begins:
            low, high = max(earliest, nominal - reach // 2), min(latest, nominal + reach)
            first.append(low + int(np.argmax(clear[low : high + 1])))
    return cut_segments(windows, np.array(first), length)


def list_spans(windows: Windows) -> list[tuple[int, int]]:
    """Return first sample and end of each stretch without a gap, in the part of the recording with windows."""
    parts = windows.recording.segment_slices
    cut_off = ((max(part.start, windows.first), min(part.stop, windows.stop)) for part in parts)
    return [(begin, end) for begin, end in cut_off if end - begin > 1]


def count_periods(windows: Windows, seconds: float) -> int:
    """Return the number of periods in some seconds: at least 1, at most that of the median stretch."""
    median_length = int(np.median([end - begin for begin, end in list_spans(windows)])) - 1
    return min(max(1, round(seconds * windows.recording.rate)), median_length)


def refuse_long_horizon(w: Windows, seconds: float) -> None:
    """Raise an `IdentificationError` if a horizon exceeds the median stretch of a recording without a gap."""
    if (known := count_periods(w, len(w.recording))) < round(seconds * w.recording.rate):
        others = ", or hold other recordings out" if w.stop - w.first < len(w.recording) else ""
        begin, end = w.recording.time[[w.first, w.stop - 1]]
        raise IdentificationError(
            f"{w.recording.name}: from {begin:.3g} to {end:.3g} s it has {known / w.recording.rate:.3g} s "
            f"without a gap, less than the horizon of {seconds:g} s: give a shorter one{others}"
        )


def cut_segments(windows: Windows, first: Index, length: int) -> Segments:
    """Cut segments of `length` periods that start at samples `first` (B,), with smoothed initial states."""
    recording = windows.recording
    index = first + np.arange(length + 1)[:, None]
    return Segments(
        windows=windows,
        first=first,
        torque=recording.torque[index[:-1]],
        position=np.vstack([windows.samples.position[first], recording.position[index[1:]]]),
        velocity=windows.samples.velocity[first],
    )


def simulate_errors(segments: Segments, terms: Sequence[Term], theta: Array) -> Array:
    """Return simulated minus measured position in every segment, (N + 1, B) [rad]."""
    return simulate_all([segments], [Point(tuple(terms), theta)])[0][:, 0] - segments.position


def sample_free_runs(
    parts: Sequence[Segments], terms: Sequence[Term], theta: Array, count: int
) -> tuple[Array, Array, Array]:
    """Return time [s], simulated position [rad] and its error [rad] in about `count` samples of all segments.

    NaN follows each segment. `parts`: segments of one recording.
    """
    count = max(10, count // sum(len(segments.first) for segments in parts))
    series = list[list[Array]]([[], [], []])
    for segments in parts:
        rows = np.arange(0, len(segments.position), max(1, (len(segments.position) - 1) // count))
        errors, recording = simulate_errors(segments, terms, theta)[rows], segments.windows.recording
        time = recording.time[segments.first] + rows[:, None] / recording.rate
        for own, values in zip(series, (time, segments.position[rows] + errors, errors), strict=True):
            own += [np.append(run, np.nan) for run in values.T]
    time, position, error = (np.concatenate(own) if own else np.empty(0) for own in series)
    return time, position, error


def simulate_all(
    segments: Sequence[Segments], models: Sequence[Point], perturbations: Array | None = None
) -> list[Array]:
    """Simulate positions of V models with terms of equal classes, for each recording (N + 1, V, B) [rad].

    Recordings with segments of equal length are simulated together, which is faster.

    Args:
        segments: segments of each recording.
        models: terms and linear parameters of each model.
        perturbations: added to the initial position [rad] and velocity [rad/s], for each model (V, 2).
    """
    perturbations = np.zeros((len(models), 2)) if perturbations is None else perturbations
    groups: dict[tuple[int, int], list[int]] = {}
    for k, segment in enumerate(segments):
        groups.setdefault((len(segment.torque), count_substeps(1.0 / segment.windows.recording.rate)), []).append(k)
    results: dict[int, Array] = {}
    for numbers in groups.values():
        group = [segments[k] for k in numbers]
        counts = [len(segment.first) for segment in group]
        perturbed = np.repeat(perturbations.T, sum(counts), axis=1)  # (2, V B)
        position = np.tile(np.concatenate([segment.position[0] for segment in group]), len(models)) + perturbed[0]
        velocity = np.tile(np.concatenate([segment.velocity for segment in group]), len(models)) + perturbed[1]
        path = simulate_segments(group, models, position, velocity).position
        parts = np.split(path.reshape(len(path), len(models), -1), np.cumsum(counts)[:-1], axis=2)
        results.update(zip(numbers, parts, strict=True))
    return [results[k] for k in range(len(segments))]


def simulate_segments(
    segments: Sequence[Segments],
    models: Sequence[Point],
    position: Array,
    velocity: Array,
    hidden: Mapping[str, Memory] | None = None,
    longest_step: float = LONGEST_STEP,
    observe: Callable[[Samples], None] | None = None,
) -> Trajectory:
    """Simulate segments of equal length under V models from given states, in one batch.

    Args:
        segments: segments of each recording, B in total.
        models: terms and linear parameters of each model.
        position, velocity: initial values (V B,) [rad], [rad/s].
        hidden: initial state variables of some terms, by id; the segments or the measured motion give the others.
        longest_step: longest step of the integrator [s].
        observe: as in `simulate`.
    """
    memory = dict(hidden or {})
    for variants in zip(*(terms_of_model for terms_of_model, _ in models), strict=True):
        if variants[0].has_memory and variants[0].id not in memory:
            memory.update(start_memory(segments, variants))

    def repeat_for_models(series: Sequence[Array]) -> Array:
        """Repeat one value of each segment (B,) of each recording for every model, (V B,)."""
        return np.tile(np.concatenate(series), len(models))

    delays = [sum(term.delay for term in terms_of_model) for terms_of_model, _ in models]
    delays = delays if any(delays) else [0.0]  # one command for all models
    loads = [segment.load for segment in segments]
    load = KnownLoad(
        repeat_for_models([np.asarray(load.inertia) for load in loads]),
        repeat_for_models([np.asarray(load.gravity) for load in loads]),
        np.tile(np.concatenate([np.asarray(load.torque) for load in loads], axis=1), len(delays)),
    )
    period = repeat_for_models([np.full(len(f.first), 1.0 / f.windows.recording.rate) for f in segments])
    terms, theta = _stack_models(models, sum(len(segment.first) for segment in segments))
    compiler = partial(segments[0].windows.programs.find, compile_step)
    known: dict[str, Any] = {"memory": memory, "load": load, "compiler": compiler}
    commands = np.concatenate([segment.command(delay) for delay in delays for segment in segments], axis=1)
    start = position, velocity, repeat_for_models([f.windows.recording.time[f.first] for f in segments])
    return simulate(terms, theta, period, commands, *start, longest_step=longest_step, observe=observe, **known)


def _stack_models(models: Sequence[Point], count: int) -> tuple[list[Term], Array]:
    """Stack terms and theta (P, V count) to simulate `count` pendulums of each of V models in one batch.

    Terms that delay the command are left out: `Segments.command` applies the delay.
    """
    terms = []
    for variants in zip(*(terms_of_model for terms_of_model, _ in models), strict=True):
        if not variants[0].delay:
            values = [variant.nonlinear_values for variant in variants]
            nonlinear = {name: np.repeat([value[name] for value in values], count) for name in values[0]}
            terms.append(replace(variants[0], **nonlinear) if nonlinear else variants[0])
    return terms, np.repeat(np.column_stack([theta for _, theta in models]), count, axis=1)


def start_memory(segments: Sequence[Segments], variants: Sequence[Term]) -> dict[str, Memory]:
    """Return the initial states (V B,) of B segments under V variants of a term, grouped by variant.

    They are the `hidden` states of the segments, else states traced along the recorded motion.
    """
    id = variants[0].id
    if all(id in segment.hidden for segment in segments):
        known = [np.concatenate(series) for series in zip(*(segment.hidden[id] for segment in segments), strict=True)]
        return {id: tuple(np.tile(series, len(variants)) for series in known)}
    distinct = list(dict.fromkeys(variants))
    traced_samples = trace_all([segment.windows for segment in segments], distinct)
    traces = [dict(zip(distinct, states_of_variant, strict=True)) for states_of_variant in traced_samples]
    states = {}
    for id in traces[0][distinct[0]].memory:
        rows = [
            [series[segment.first] for series in trace[variant].memory[id]]
            for variant in variants
            for segment, trace in zip(segments, traces, strict=True)
        ]
        states[id] = tuple(np.concatenate(variable) for variable in zip(*rows, strict=True))
    return states


def compute_position_rms(segments: Sequence[Segments], terms: Sequence[Term], theta: Array) -> float:
    """Return the RMS of the position error over all segments [rad]."""
    paths = simulate_all(segments, [Point(tuple(terms), theta)])
    errors = [(path[:, 0] - segment.position)[1:].ravel() for path, segment in zip(paths, segments, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def compute_deviation(segments: Sequence[Segments]) -> float:
    """Return the root mean square deviation of the position from its mean in each segment [rad]."""
    return float(np.sqrt(np.mean(np.concatenate([segment.position.var(axis=0) for segment in segments]))))


def compute_growth(segments: Segments, terms: Sequence[Term], theta: Array) -> Array:
    """Return the largest growth factor of a small error of the initial position during each segment (B,).

    Near the upright equilibrium the growth is exponential, so a free-running error does not test the model.
    """
    paths = simulate_all([segments], [Point(tuple(terms), theta)] * 2, np.array([[0.0, 0.0], [PERTURBATION, 0.0]]))[0]
    return np.asarray(np.abs(paths[:, 1] - paths[:, 0]).max(axis=0) / PERTURBATION)


def select_segments(segments: Segments, selection: Mask | Index) -> Segments:
    """Return some of the segments, by a mask (B,) or their numbers."""
    return replace(
        segments,
        first=segments.first[selection],
        torque=segments.torque[:, selection],
        position=segments.position[:, selection],
        velocity=segments.velocity[selection],
        hidden={id: tuple(value[..., selection] for value in memory) for id, memory in segments.hidden.items()},
    )
