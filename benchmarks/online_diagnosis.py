"""Delay of online alarms after a new effect or a changed parameter, and rate of false alarms.

    python -m benchmarks.online_diagnosis [--null-hours 1] [--recordings FILE ...]

Random plants of the independent simulator have four sensors and four excitations. At 10 s an effect of a tenth of the
RMS torque starts, or a parameter changes by 20 %; state and torque command are continuous. Or two parameters change,
5 s apart. False alarms are counted per hour of motion of unchanged plants. Recordings of machines are repeated.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.excitation import OPEN_LOOP
from benchmarks.independent_plant import Experiment, Plant, effect_share, random_case, simulate
from benchmarks.parallel import each
from benchmarks.two_link import Multisine, TwoLink
from estimators.online import Diagnoser, OnlineDiagnosis
from estimators.signals.measurements import Smoothing, choose_smoothing
from pendulum_env.physics.joints import find_kinds
from pendulum_env.recording import read_recording
from robots.arms import arm_base
from robots.arms.body import read_body
from workbench.terminal import Terminal

CHANGE, AFTER = 10.0, 10.0  # time of the change, and time after it [s]
APART = 5.0  # time between two changes [s]
WITHIN = 5.0  # longest delay of a timely alarm [s]
SHARE, FACTOR = 0.1, 0.2  # effect over RMS torque; relative change of a parameter
SENSORS = ((1000.0, 1_024_000), (500.0, 65_536), (200.0, 65_536), (1000.0, 8192))  # rate [Hz], counts
EXCITATIONS = ("two_tone", "multisine", "filtered_noise", "steps")
PARAMETERS = ("inertia", "gravity", "viscous", "coulomb")
SIZES = {  # parameters proportional to the torque of an effect
    "stribeck": ("strib_d",),
    "cogging": ("cog_s", "cog_c"),
    "quadratic_drag": ("drag",),
    "load_dependent_friction": ("load_mu",),
    "torque_offset": ("offset",),
    "coulomb_asymmetry": ("asym_c",),
    "position_dependent_friction": ("pos_s", "pos_c"),
    "spring": ("spring_k",),
}

HEADERS = (
    "changes at 10 s",
    "early",
    "median alarm [s]",
    "alarm within 5 s",
    "named within 5 s",
    "right at 20 s",
    "reported at 20 s",
)
HEADERS_OF_TWO = (
    "changes at 10 s and 15 s",
    "an effect reported",
    "second reported within 5 s",
    "second right at 25 s",
    "reported at 25 s",
)
ARMS = {
    "viscous@elbow": TwoLink(viscous=(0.3638, 1.2 * 0.3638)),
    "coulomb@shoulder": TwoLink(coulomb=(1.2 * 0.9163, 0.9163)),
    "cogging@elbow": TwoLink(cogging=(0.0, 0.3)),
    "quadratic_drag@elbow": TwoLink(drag=(0.0, 0.05)),
}

Joined = tuple[np.ndarray, np.ndarray, np.ndarray]  # time, position, torque over the period that ends with the sample
Verdicts = list[tuple[float, OnlineDiagnosis]]  # each with its time [s]


def scale_effect(plant: Plant, experiment: Experiment, effect: str) -> Plant:
    """Return the plant with the effect scaled to a tenth of the RMS torque."""
    for _ in range(3):
        (run,) = simulate([(plant, replace(experiment, rate=200.0))])
        factor = SHARE / max(effect_share(run).with_true_parameters, 1e-3)
        law = {k: v * (factor if k in SIZES[effect] else 1.0) for k, v in plant.effects[effect].items()}
        plant = replace(plant, effects={effect: law})
    return plant


def draw_plants(rng: np.random.Generator, what: str, k: int, seconds: float) -> tuple[Plant, Plant, Experiment]:
    """Draw the k-th plant before and after the change `what` (effect or parameter), and its experiment."""
    rate, counts = SENSORS[k // len(EXCITATIONS) % len(SENSORS)]
    hidden = (what,) if what in SIZES else ()
    case = random_case(rng, hidden, seconds=seconds, torque_noise=0.05, rate=rate, counts=counts)
    experiment = replace(case.train, excitation=EXCITATIONS[k % len(EXCITATIONS)], scale=1.0)
    before = after = replace(case.plant, effects={})
    if hidden:
        after = scale_effect(case.plant, experiment, what)
    elif what:
        after = change_parameter(rng, before, what)
    return before, after, experiment


def change_parameter(rng: np.random.Generator, plant: Plant, name: str) -> Plant:
    """Return the plant with a parameter changed by `FACTOR`, up or down."""
    return replace(plant, **{name: getattr(plant, name) * (1.0 + rng.choice([-1, 1]) * FACTOR)})


def simulate_changes(plants: Mapping[float, Plant], experiment: Experiment) -> Joined:
    """Simulate a plant that changes at given times [s] with a continuous state.

    Args:
        plants: by start time [s], the first at 0.
        experiment: of the last plant; excitation and sensor apply to the whole run.
    """
    starts = [round(time * experiment.rate) for time in plants]
    t = np.arange(starts[-1] + experiment.samples) / experiment.rate
    command = OPEN_LOOP[experiment.excitation](np.random.default_rng([experiment.seed, 0]), t, experiment.scale)
    position, torque, part = [], [], experiment
    for k, (plant, first, end) in enumerate(zip(plants.values(), starts, [*starts[1:], None], strict=True)):
        samples = experiment.samples if end is None else end - first + 1  # the next part starts at the last one
        part = replace(part, seconds=samples / experiment.rate, seed=experiment.seed + k)
        (run,) = simulate([(plant, part)], [command[first : first + samples]])
        part = replace(part, start=(float(run.exact_position[-1]), float(run.velocity[-1])))
        kept = slice(None if end is None else -1)
        position.append(run.position[kept])
        torque.append(run.torque[kept])
    return t, np.concatenate(position), np.r_[0.0, np.concatenate(torque)[:-1]]


def diagnose_run(run: Joined, diagnoser: Diagnoser) -> Verdicts:
    """Diagnose a run, and return each verdict with its time."""
    verdicts = Verdicts()
    for sample in zip(*run, strict=True):
        (verdict,) = diagnoser.take(*(np.array([value]) for value in sample))
        if not verdicts or verdict is not verdicts[-1][1]:
            verdicts.append((float(sample[0]), verdict))
    return verdicts


def make_diagnoser(experiment: Experiment) -> Diagnoser:
    """Return a diagnoser of a pendulum with the four base terms."""
    return Diagnoser(experiment.rate, smoothing=Smoothing.from_encoder(experiment.counts or 0, experiment.rate))


def names(verdict: OnlineDiagnosis) -> tuple[str, ...]:
    """Return the reported effects or parameters."""
    return verdict.group if verdict.kind == "missing" else tuple(verdict.changed)


def describe(verdict: OnlineDiagnosis) -> str:
    """Return the kind and names of a verdict as text."""
    return f"{verdict.kind} {' or '.join(verdict.group) or ', '.join(sorted(verdict.changed))}".strip()


@dataclass(frozen=True)
class Outcome:
    """Verdicts on a plant that changes once.

    Attributes:
        is_early: whether there was an alarm before the change.
        alarm: time from the change to the first alarm [s], inf without one.
        named: time from the change to the first right verdict [s], inf without one.
        last: kind and names of the last verdict.
        is_right: whether the last verdict is right.
    """

    is_early: bool
    alarm: float
    named: float
    last: str
    is_right: bool


def diagnose_change(case: tuple[str, int, int]) -> Outcome:
    """Diagnose a plant that changes; the case is the change, the number in its series, and a seed."""
    what, k, seed = case
    before, after, experiment = draw_plants(np.random.default_rng([seed, k, *what.encode()]), what, k, AFTER)
    run = simulate_changes({0.0: before, CHANGE: after}, experiment)
    return score_verdicts(what, diagnose_run(run, make_diagnoser(experiment)))


def score_verdicts(what: str, verdicts: Verdicts) -> Outcome:
    """Compare verdicts with the change `what` at 10 s; of several parameters the first must be right."""
    kind = "missing" if what.partition("@")[0] in SIZES else "changed"

    def is_right(verdict: OnlineDiagnosis) -> bool:
        return verdict.kind == kind and what in names(verdict)[: None if kind == "missing" else 1]

    later, last = [(t - CHANGE, verdict) for t, verdict in verdicts if t > CHANGE], verdicts[-1][1]
    return Outcome(
        is_early=any(names(verdict) for t, verdict in verdicts if t <= CHANGE),
        alarm=min((t for t, verdict in later if names(verdict)), default=np.inf),
        named=min((t for t, verdict in later if is_right(verdict)), default=np.inf),
        last=describe(last),
        is_right=is_right(last),
    )


def summary(found: Sequence[Outcome]) -> tuple[str, ...]:
    """Return the table cells for several plants."""
    soon = (np.mean([getattr(one, name) <= WITHIN for one in found]) for name in ("alarm", "named"))
    others = Counter(one.last for one in found).most_common(3)
    return (
        str(sum(one.is_early for one in found)),
        f"{np.median([one.alarm for one in found]):.1f}",
        *(f"{share:.0%}" for share in soon),
        f"{np.mean([one.is_right for one in found]):.0%}",
        ", ".join(f"{name} {count}" for name, count in others),
    )


def print_detection(n: int, seed: int, workers: int, terminal: Terminal) -> None:
    """Diagnose n plants of each change, and print a table."""
    rows = []
    for what in (*PARAMETERS, *SIZES):
        found = each(
            diagnose_change, [(what, k, seed) for k in range(n)], workers=workers, title=what, terminal=terminal
        )
        rows.append((what, *summary(found)))
    terminal.print_heading(
        f"A parameter changes by {FACTOR:.0%}, or an effect of {SHARE:.0%} of the RMS torque sets in; n = {n}"
    )
    terminal.print_table(HEADERS, rows, left=HEADERS[-1:])


@dataclass(frozen=True)
class OutcomeOfTwo:
    """Verdicts on a plant with parameters that change twice.

    Attributes:
        has_effect: whether an effect was reported (wrongly).
        alarm: time from the second change to the next report of a change [s], inf without one.
        last: kind and names of the last verdict.
        is_right: whether the last verdict is a change with the second parameter first.
    """

    has_effect: bool
    alarm: float
    last: str
    is_right: bool


def diagnose_two_changes(case: tuple[int, int]) -> OutcomeOfTwo:
    """Diagnose a plant with two changes of parameters; the case is a number and a seed."""
    k, seed = case
    first, second = PARAMETERS[k % 4], PARAMETERS[(k + 1 + k // 4 % 3) % 4]
    rng = np.random.default_rng([seed, k])
    before, after, experiment = draw_plants(rng, first, k, AFTER)
    plants = {0.0: before, CHANGE: after, CHANGE + APART: change_parameter(rng, after, second)}
    verdicts = diagnose_run(simulate_changes(plants, experiment), make_diagnoser(experiment))
    later = [(t, own) for t, own in verdicts if own.since is not None and own.since > CHANGE + 0.5 * APART]
    last = verdicts[-1][1]
    return OutcomeOfTwo(
        has_effect=any(own.group for _, own in verdicts),
        alarm=min((t - CHANGE - APART for t, own in later if own.changed), default=np.inf),
        last=describe(last),
        is_right=bool(later) and last.kind == "changed" and names(last)[0] == second,
    )


def two_changes(n: int, seed: int, workers: int, terminal: Terminal) -> None:
    """Diagnose n plants with one parameter that changes at 10 s and another 5 s later, and print a table."""
    cases = [(k, seed) for k in range(n)]
    found = each(diagnose_two_changes, cases, workers=workers, title="two changes", terminal=terminal)
    others = Counter(one.last for one in found).most_common(3)
    row = (
        "one parameter, then another",
        str(sum(one.has_effect for one in found)),
        f"{np.mean([one.alarm <= WITHIN for one in found]):.0%}",
        f"{np.mean([one.is_right for one in found]):.0%}",
        ", ".join(f"{name} {count}" for name, count in others),
    )
    terminal.print_heading(f"Two parameters change by {FACTOR:.0%}, {APART:g} s apart; n = {n}")
    terminal.print_table(HEADERS_OF_TWO, [row], left=HEADERS_OF_TWO[-1:])


def diagnose_unchanged(case: tuple[float, int, int]) -> tuple[float, float, list[str]]:
    """Diagnose an unchanged plant; the case is its duration [s], number and seed.

    Returns:
        Motion [s], CPU time [s] and alarms.
    """
    seconds, k, seed = case
    plant, _, experiment = draw_plants(np.random.default_rng([seed, k]), "", k, seconds)
    (run,) = simulate([(plant, experiment)])
    begin = time.process_time()
    verdicts = diagnose_run((run.time, run.position, np.r_[0.0, run.torque[:-1]]), make_diagnoser(experiment))
    cost, pairs = time.process_time() - begin, list(pairwise(verdict for _, verdict in verdicts))
    motion = sum(max(verdict.motion - last.motion, 0.0) for last, verdict in pairs)
    alarms = [
        f"{experiment.excitation}: {verdict.kind} {names(verdict)}"
        for last, verdict in pairs
        if names(verdict) and not names(last)
    ]
    return motion, cost, alarms


def print_false_alarms(hours: float, seconds: float, seed: int, workers: int, terminal: Terminal) -> None:
    """Count and print the false alarms of unchanged plants; one per hour is accepted."""
    cases = [(seconds, k, seed) for k in range(max(1, round(3600 * hours / seconds)))]
    found = each(diagnose_unchanged, cases, workers=workers, title="nothing changes", terminal=terminal)
    motion, cost = sum(one[0] for one in found), sum(one[1] for one in found)
    alarms = [alarm for *_, own in found for alarm in own]
    terminal.print_heading("Nothing changes, where one alarm an hour is accepted")
    terminal.print(f"{len(alarms)} alarms in {motion / 3600:.2f} h of motion: {'; '.join(alarms) or 'none'}")
    terminal.print(f"{1e3 * cost / (len(cases) * seconds):.0f} ms of computing for a second")


def diagnose_arms(n: int, terminal: Terminal) -> None:
    """Diagnose a two-link arm that changes, and print a table."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "two.urdf"
        path.write_text(TwoLink().urdf())
        body = read_body(path)
    library = {one.id: one for one in find_kinds(("quadratic_drag", "cogging", "stribeck", "torque_offset"), body)}
    rate, counts, rows = 500.0, 65_536, []
    for what, after in ARMS.items():
        found = []
        for seed in range(n):
            instants, signal = np.arange(0.0, CHANGE + AFTER, 1 / rate), Multisine.paper(seed, (5.0, 2.5))
            first = round(CHANGE * rate)
            begun, speed = TwoLink().simulate(signal, instants[: first + 1])
            rest, _ = after.simulate(signal, instants[first:], tuple(begun[-1]), tuple(speed[-1]))
            position = np.round(np.vstack([begun, rest[1:]]) * counts / (2 * np.pi)) * 2 * np.pi / counts
            noise = 0.02 * np.random.default_rng(seed).normal(size=position.shape)
            run = instants, position, signal.held(instants - 1 / rate, 1 / rate) + noise
            one = Diagnoser(rate, arm_base(body), library=library, smoothing=Smoothing.from_encoder(counts, rate))
            found.append(score_verdicts(what, diagnose_run(run, one)))
        rows.append((what, *summary(found)))
    terminal.print_heading(f"An arm of two links; n = {n}")
    terminal.print_table(HEADERS, rows, left=HEADERS[-1:])


def replay_recordings(files: Sequence[str], seconds: float, terminal: Terminal) -> None:
    """Diagnose repeated recordings of unchanged machines, and print a table."""
    rows = []
    for file in files:
        recording = read_recording(file)
        length = recording.time[-1] - recording.time[0] + 1.0  # with a gap before the repetition
        turns = max(1, round(seconds / length))
        later = np.concatenate([recording.time - recording.time[0] + k * length for k in range(turns)])
        held = np.tile(np.r_[0.0, recording.torque[:-1]], turns)
        diagnoser = Diagnoser(recording.rate, smoothing=choose_smoothing(recording))
        verdicts = diagnose_run((later, np.tile(recording.position, turns), held), diagnoser)
        changes = {verdict.since: "+".join(verdict.changed) for _, verdict in verdicts if verdict.changed}
        effects = Counter(verdict.group[0] for _, verdict in verdicts if verdict.group).most_common(2)
        words = ", ".join(f"{name} {count}" for name, count in effects)
        rows.append((recording.name, f"{later[-1]:.0f}", str(len(changes)), ", ".join(changes.values()), words))
    terminal.print_heading("Recordings of machines played back")
    headers = ("recording", "seconds", "changes", "of", "most often missing")
    terminal.print_table(headers, rows, left=headers[-2:])


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.online_diagnosis", description=__doc__.partition("\n")[0]
    )
    parser.add_argument("--n", type=int, default=16, help="plants for each change (default 16)")
    parser.add_argument("--two", type=int, default=24, help="plants that change twice (default 24)")
    parser.add_argument("--null-hours", type=float, default=1.0, help="of plants that do not change (default 1)")
    parser.add_argument("--seconds", type=float, default=120.0, help="that each of those runs for, or is played")
    parser.add_argument("--arms", type=int, default=4, help="runs of an arm for each change (default 4)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recordings", nargs="+", help="of machines that do not change, to play back instead")
    args = parser.parse_args(argv)
    terminal = Terminal()
    if args.recordings:
        replay_recordings(args.recordings, args.seconds, terminal)
        return 0
    if args.null_hours:
        print_false_alarms(args.null_hours, args.seconds, args.seed, args.workers, terminal)
    if args.n:
        print_detection(args.n, args.seed, args.workers, terminal)
    if args.two:
        two_changes(args.two, args.seed, args.workers, terminal)
    if args.arms:
        diagnose_arms(args.arms, terminal)
    return 0


if __name__ == "__main__":
    sys.exit(main())
