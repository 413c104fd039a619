"""Online diagnosis: how soon an effect or a changed parameter is reported, and how often nothing is the matter.

    python -m benchmarks.online_diagnosis [--null-hours 1] [--recordings FILE ...]

Random plants of the independent simulator, at four sensors and under four excitations. At 10 s an effect sets in, whose
torque is a tenth of the RMS torque, or a parameter changes by 20 %; the simulation goes on from the same state under
the same torque. Or an effect is hidden from the start. Alarms in plants that do not change are counted in hours of
motion. Recordings of machines are played back again and again.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.excitation import OPEN_LOOP
from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, effect_share, random_case, simulate
from benchmarks.parallel import each
from benchmarks.two_link import Multisine, TwoLink
from estimators.online import Diagnoser, OnlineDiagnosis
from estimators.signals.measurements import Smoothing, choose_smoothing
from pendulum_env.arms.body import read_body
from pendulum_env.arms.joints import arm_base, kinds_at
from pendulum_env.recording import read_recording
from workbench.terminal import Terminal

CHANGE, AFTER = 10.0, 10.0  # [s]
WITHIN = 5.0  # [s], in which an alarm is to come
SHARE, FACTOR = 0.1, 0.2  # of the RMS torque, that an effect has; of a parameter, by which it changes
SENSORS = ((1000.0, 1_024_000), (500.0, 65_536), (200.0, 65_536), (1000.0, 8192))  # rate [Hz], counts
EXCITATIONS = ("two_tone", "multisine", "filtered_noise", "steps")
PARAMETERS = ("inertia", "gravity", "viscous", "coulomb")
SIZES = {  # of effects, to which their torque is proportional
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
ARMS = {
    "viscous@elbow": TwoLink(viscous=(0.3638, 1.2 * 0.3638)),
    "coulomb@shoulder": TwoLink(coulomb=(1.2 * 0.9163, 0.9163)),
    "cogging@elbow": TwoLink(cogging=(0.0, 0.3)),
    "quadratic_drag@elbow": TwoLink(drag=(0.0, 0.05)),
}

Joined = tuple[np.ndarray, np.ndarray, np.ndarray]  # time, position, torque over the period that ends with the sample
Verdicts = list[tuple[float, OnlineDiagnosis]]  # since a time [s]


def scaled(plant: Plant, experiment: Experiment, effect: str) -> Plant:
    """The plant with a size of the effect that has a tenth of the RMS torque."""
    for _ in range(3):
        (run,) = simulate([(plant, replace(experiment, rate=200.0))])
        factor = SHARE / max(effect_share(run).with_true_parameters, 1e-3)
        law = {k: v * (factor if k in SIZES[effect] else 1.0) for k, v in plant.effects[effect].items()}
        plant = replace(plant, effects={effect: law})
    return plant


def drawn(rng: np.random.Generator, what: str, k: int, seconds: float) -> tuple[Plant, Plant, Experiment]:
    """A plant without and with an effect or a changed parameter, and an experiment on it; the k-th of a series."""
    rate, counts = SENSORS[k // len(EXCITATIONS) % len(SENSORS)]
    hidden = (what,) if what in SIZES else ()
    case = random_case(rng, hidden, seconds=seconds, torque_noise=0.05, rate=rate, counts=counts)
    experiment = replace(case.train, excitation=EXCITATIONS[k % len(EXCITATIONS)], scale=1.0)
    before = after = replace(case.plant, effects={})
    if hidden:
        after = scaled(case.plant, experiment, what)
    elif what:
        after = replace(before, **{what: getattr(before, what) * (1.0 + rng.choice([-1, 1]) * FACTOR)})
    return before, after, experiment


def changing(cases: Sequence[tuple[Plant, Plant, Experiment]], change: float = CHANGE) -> list[Joined]:
    """Runs whose plant changes at a time [s]: the second part starts from where the first one ended."""
    commands, first = [], round(change * cases[0][2].rate)
    for _, _, experiment in cases:
        t = np.arange(first + experiment.samples) / experiment.rate
        rng = np.random.default_rng([experiment.seed, 0])
        commands.append(OPEN_LOOP[experiment.excitation](rng, t, experiment.scale))
    halves = [(plant, replace(e, seconds=change + 1 / e.rate)) for plant, _, e in cases]
    before = simulate(halves, [command[: first + 1] for command in commands])
    ends = [(float(run.exact_position[-1]), float(run.velocity[-1])) for run in before]
    rest = [(plant, replace(e, start=end, seed=e.seed + 1)) for (_, plant, e), end in zip(cases, ends, strict=True)]
    after = simulate(rest, [command[first:] for command in commands])
    return [_joined(one, other, first) for one, other in zip(before, after, strict=True)]


def _joined(one: SimulatedRecording, other: SimulatedRecording, first: int) -> Joined:
    position, torque = (np.r_[getattr(one, name)[:first], getattr(other, name)] for name in ("position", "torque"))
    return np.arange(len(position)) / one.experiment.rate, position, np.r_[0.0, torque[:-1]]


def diagnosed(run: Joined, diagnoser: Diagnoser) -> Verdicts:
    """What is said of a run, and since when."""
    told = Verdicts()
    for sample in zip(*run, strict=True):
        (said,) = diagnoser.take(*(np.array([value]) for value in sample))
        if not told or said is not told[-1][1]:
            told.append((float(sample[0]), said))
    return told


def diagnoser_of(experiment: Experiment) -> Diagnoser:
    """A diagnoser that knows nothing of a pendulum but its four terms."""
    return Diagnoser(experiment.rate, smoothing=Smoothing.of_encoder(experiment.counts or 0, experiment.rate))


def names(said: OnlineDiagnosis) -> tuple[str, ...]:
    """Effects or parameters that are reported."""
    return said.group if said.kind == "missing" else tuple(said.changed)


@dataclass(frozen=True)
class Outcome:
    """What was reported of a plant that changes.

    Attributes:
        is_early: whether there was an alarm before the change.
        alarm: time from the change to the first alarm [s].
        named: time from the change until the right kind and name were reported [s].
        last: kind and names that were reported in the end.
        is_right: whether these are right.
    """

    is_early: bool
    alarm: float
    named: float
    last: str
    is_right: bool


def outcome(case: tuple[str, int, int]) -> Outcome:
    """Diagnose a plant of which something changes; takes what, the number in its series, and a seed."""
    what, k, seed = case
    before, after, experiment = drawn(np.random.default_rng([seed, k, *what.encode()]), what, k, AFTER)
    (run,) = changing([(before, after, experiment)])
    return judged(what, diagnosed(run, diagnoser_of(experiment)))


def judged(what: str, told: Verdicts, change: float = CHANGE) -> Outcome:
    """Compare what was reported with what changed at a time [s]; of several parameters the first has to be right."""
    kind = "missing" if what.partition("@")[0] in SIZES else "changed"

    def is_right(said: OnlineDiagnosis) -> bool:
        return said.kind == kind and what in names(said)[: None if kind == "missing" else 1]

    later, last = [(t - change, said) for t, said in told if t > change], told[-1][1]
    return Outcome(
        is_early=any(names(said) for t, said in told if t <= change),
        alarm=min((t for t, said in later if names(said)), default=np.inf),
        named=min((t for t, said in later if is_right(said)), default=np.inf),
        last=f"{last.kind} {' or '.join(last.group) or ', '.join(sorted(last.changed))}".strip(),
        is_right=is_right(last),
    )


def summary(found: Sequence[Outcome]) -> tuple[str, ...]:
    """Cells of a table over several plants."""
    soon = (np.mean([getattr(one, name) <= WITHIN for one in found]) for name in ("alarm", "named"))
    others = Counter(one.last for one in found).most_common(3)
    return (
        str(sum(one.is_early for one in found)),
        f"{np.median([one.alarm for one in found]):.1f}",
        *(f"{share:.0%}" for share in soon),
        f"{np.mean([one.is_right for one in found]):.0%}",
        ", ".join(f"{name} {count}" for name, count in others),
    )


def detection(n: int, seed: int, workers: int, terminal: Terminal) -> None:
    """Plants that change at 10 s."""
    rows = []
    for what in (*PARAMETERS, *SIZES):
        found = each(outcome, [(what, k, seed) for k in range(n)], workers=workers, title=what, terminal=terminal)
        rows.append((what, *summary(found)))
    terminal.heading(
        f"A parameter changes by {FACTOR:.0%}, or an effect of {SHARE:.0%} of the RMS torque sets in; n = {n}"
    )
    terminal.table(HEADERS, rows, left=HEADERS[-1:])


def null(case: tuple[float, int, int]) -> tuple[float, float, list[str]]:
    """Motion [s], CPU time [s] and alarms of a plant that does not change; takes its time [s], number and seed."""
    seconds, k, seed = case
    plant, _, experiment = drawn(np.random.default_rng([seed, k]), "", k, seconds)
    (run,) = simulate([(plant, experiment)])
    begin = time.process_time()
    told = diagnosed((run.time, run.position, np.r_[0.0, run.torque[:-1]]), diagnoser_of(experiment))
    cost, pairs = time.process_time() - begin, list(pairwise(said for _, said in told))
    motion = sum(max(said.motion - last.motion, 0.0) for last, said in pairs)
    alarms = [
        f"{experiment.excitation}: {said.kind} {names(said)}" for last, said in pairs if names(said) and not names(last)
    ]
    return motion, cost, alarms


def nulls(hours: float, seconds: float, seed: int, workers: int, terminal: Terminal) -> None:
    """Plants that do not change: alarms, where one an hour is accepted."""
    cases = [(seconds, k, seed) for k in range(max(1, round(3600 * hours / seconds)))]
    found = each(null, cases, workers=workers, title="nothing changes", terminal=terminal)
    motion, cost = sum(one[0] for one in found), sum(one[1] for one in found)
    alarms = [alarm for *_, own in found for alarm in own]
    terminal.heading("Nothing changes, where one alarm an hour is accepted")
    terminal.say(f"{len(alarms)} alarms in {motion / 3600:.2f} h of motion: {'; '.join(alarms) or 'none'}")
    terminal.say(f"{1e3 * cost / (len(cases) * seconds):.0f} ms of computing for a second")


def arms(n: int, terminal: Terminal) -> None:
    """An arm of two links that changes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "two.urdf"
        path.write_text(TwoLink().urdf())
        body = read_body(path)
    library = {one.id: one for one in kinds_at(("quadratic_drag", "cogging", "stribeck", "torque_offset"), body)}
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
            one = Diagnoser(rate, arm_base(body), library=library, smoothing=Smoothing.of_encoder(counts, rate))
            found.append(judged(what, diagnosed(run, one)))
        rows.append((what, *summary(found)))
    terminal.heading(f"An arm of two links; n = {n}")
    terminal.table(HEADERS, rows, left=HEADERS[-1:])


def played(files: Sequence[str], seconds: float, terminal: Terminal) -> None:
    """Recordings of machines that do not change, played back again and again."""
    rows = []
    for file in files:
        recording = read_recording(file)
        length = recording.time[-1] - recording.time[0] + 1.0  # a gap before it begins again
        turns = max(1, round(seconds / length))
        later = np.concatenate([recording.time - recording.time[0] + k * length for k in range(turns)])
        held = np.tile(np.r_[0.0, recording.torque[:-1]], turns)
        diagnoser = Diagnoser(recording.rate, smoothing=choose_smoothing(recording))
        told = diagnosed((later, np.tile(recording.position, turns), held), diagnoser)
        changes = {said.since: "+".join(said.changed) for _, said in told if said.changed}
        effects = Counter(said.group[0] for _, said in told if said.group).most_common(2)
        words = ", ".join(f"{name} {count}" for name, count in effects)
        rows.append((recording.name, f"{later[-1]:.0f}", str(len(changes)), ", ".join(changes.values()), words))
    terminal.heading("Recordings of machines played back")
    headers = ("recording", "seconds", "changes", "of", "most often missing")
    terminal.table(headers, rows, left=headers[-2:])


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.online_diagnosis", description=__doc__.partition("\n")[0]
    )
    parser.add_argument("--n", type=int, default=16, help="plants for each change (default 16)")
    parser.add_argument("--null-hours", type=float, default=1.0, help="of plants that do not change (default 1)")
    parser.add_argument("--seconds", type=float, default=120.0, help="that each of those runs for, or is played")
    parser.add_argument("--arms", type=int, default=4, help="runs of an arm for each change (default 4)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recordings", nargs="+", help="of machines that do not change, to play back instead")
    args = parser.parse_args(argv)
    terminal = Terminal()
    if args.recordings:
        played(args.recordings, args.seconds, terminal)
        return 0
    if args.null_hours:
        nulls(args.null_hours, args.seconds, args.seed, args.workers, terminal)
    if args.n:
        detection(args.n, args.seed, args.workers, terminal)
    if args.arms:
        arms(args.arms, terminal)
    return 0


if __name__ == "__main__":
    sys.exit(main())
