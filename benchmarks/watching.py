"""Watching a model online: how soon a change is seen, whether it is called what it is, and how often nothing is.

python -m benchmarks.watching

Random plants of the independent simulator. At 10 s an effect sets in, whose torque is 3 % or more of all (RMS), or a
payload is picked up; the simulation goes on from where it was, under the same torque. The watch knows nothing of a
plant but its four terms. Alarms in plants that do not change are counted in hours of motion.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.excitation import OPEN_LOOP
from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, effect_share, random_case, simulate
from estimators.online.watch import Verdict, Watch
from estimators.signals.measurements import Smoothing, choose_smoothing
from pendulum_env.recording import read_recording
from workbench.terminal import Terminal

CHANGE, AFTER = 10.0, 10.0  # [s]
WITHIN = 5.0  # [s] of motion, in which an alarm is to come
SHARE = 0.03  # of the RMS torque, that an effect changes at least
EXCITATIONS = ("two_tone", "multisine", "filtered_noise", "steps")
EFFECTS = ("stribeck", "cogging", "quadratic_drag", "load_dependent_friction", "torque_offset")
PAYLOAD = "payload"
SENSORS = ((1000.0, 1_024_000), (500.0, 65_536), (200.0, 65_536), (1000.0, 8192))  # rate [Hz], counts
EVERY = 20  # samples, between two looks at the verdicts

Joined = tuple[np.ndarray, np.ndarray, np.ndarray]  # time, position, torque over the period that ends with the sample


def plants(rng: np.random.Generator, effect: str, n: int, **experiment: float) -> list[tuple[Plant, Plant, Experiment]]:
    """Plants before and after the change, drawn until the effect changes the torque as much as it should."""
    found: list[tuple[Plant, Plant, Experiment]] = []
    while len(found) < n:
        excitation = EXCITATIONS[len(found) % len(EXCITATIONS)]
        hidden = () if effect == PAYLOAD else (effect,)
        case = random_case(rng, hidden, seconds=AFTER, torque_noise=0.05, **experiment)
        before = replace(case.plant, effects={})
        drawn = replace(case.train, excitation=excitation, scale=1.0)
        if effect == PAYLOAD:
            inertia, gravity = (2 ** rng.uniform(-1, 1, 2)) * (0.02, 0.4)
            after = replace(before, inertia=before.inertia + inertia, gravity=before.gravity + gravity)
            found.append((before, after, drawn))
            continue
        (run,) = simulate([(case.plant, replace(drawn, rate=200.0))])
        if effect_share(run).with_true_parameters >= SHARE:
            found.append((before, case.plant, drawn))
    return found


def changing(cases: Sequence[tuple[Plant, Plant, Experiment]]) -> list[Joined]:
    """Runs whose plant changes at 10 s: the second half starts from where the first one ended."""
    commands, first = [], round(CHANGE * cases[0][2].rate)
    for _, _, experiment in cases:
        t = np.arange(first + experiment.samples) / experiment.rate
        rng = np.random.default_rng([experiment.seed, 0])
        commands.append(OPEN_LOOP[experiment.excitation](rng, t, experiment.scale))
    halves = [(plant, replace(e, seconds=CHANGE + 1 / e.rate)) for plant, _, e in cases]
    before = simulate(halves, [command[: first + 1] for command in commands])
    ends = [(float(run.exact_position[-1]), float(run.velocity[-1])) for run in before]
    rest = [(plant, replace(e, start=end, seed=e.seed + 1)) for (_, plant, e), end in zip(cases, ends, strict=True)]
    after = simulate(rest, [command[first:] for command in commands])
    return [_joined(one, other, first) for one, other in zip(before, after, strict=True)]


def _joined(one: SimulatedRecording, other: SimulatedRecording, first: int) -> Joined:
    position, torque = (np.r_[getattr(one, name)[:first], getattr(other, name)] for name in ("position", "torque"))
    return np.arange(len(position)) / one.experiment.rate, position, np.r_[0.0, torque[:-1]]


def watched(runs: Sequence[Joined], rate: float, counts: int, **options: float) -> list[list[tuple[float, Verdict]]]:
    """What is said of each run over time."""
    watch = Watch(rate, batch=len(runs), smoothing=Smoothing.of_encoder(counts, rate), **options)
    position, torque = (np.array([run[k] for run in runs]).T for k in (1, 2))
    told: list[list[tuple[float, Verdict]]] = [[] for _ in runs]
    for k, t in enumerate(runs[0][0]):
        verdicts = watch.take(np.full(len(runs), t), position[k], torque[k])
        if k % EVERY == 0:
            for own, verdict in zip(told, verdicts, strict=True):
                own.append((float(t), verdict))
    return told


def judged(told: Sequence[tuple[float, Verdict]]) -> tuple[str, float, str]:
    """Kind that is said at the end, time from the change to the alarm [s], and parameters that are said to change."""
    early = [t for t, verdict in told if verdict.alarms and t < CHANGE]
    alarm = next((t - CHANGE for t, verdict in told if verdict.alarms and t >= CHANGE), np.inf)
    last = told[-1][1]
    return "early" if early else last.kind, alarm, "+".join(sorted(last.changes))


def detection(n: int, seed: int, terminal: Terminal) -> None:
    rows = []
    for effect in (*EFFECTS, PAYLOAD):
        kinds: Counter[str] = Counter()
        alarms, both = [], 0
        for k, (rate, counts) in enumerate(SENSORS):
            rng = np.random.default_rng([seed, k])
            runs = changing(plants(rng, effect, n // len(SENSORS), rate=rate, counts=counts))
            for told in watched(runs, rate, counts):
                kind, alarm, changes = judged(told)
                kinds[kind] += 1
                alarms.append(alarm)
                both += {"inertia", "gravity"} <= set(changes.split("+"))
        total = sum(kinds.values())
        soon = np.mean(np.array(alarms) <= WITHIN)
        kind = "value" if effect == PAYLOAD else "structure"
        named = f"{100 * both / total:.0f} %" if effect == PAYLOAD else ""
        cells = (f"{np.median(alarms):.1f}", f"{100 * soon:.0f} %", f"{100 * kinds[kind] / total:.0f} %", named)
        rows.append((effect, *cells, ", ".join(f"{name} {count}" for name, count in kinds.most_common())))
    headers = ("sets in at 10 s", "median alarm [s]", "within 5 s", "right kind", "inertia and gravity named", "kinds")
    terminal.heading(f"Changes, {n} plants each, at four sensors and under four excitations")
    terminal.table(headers, rows, left=("kinds",))


def nulls(seconds: float, n: int, seed: int, terminal: Terminal) -> None:
    rows = []
    for k, (rate, counts) in enumerate(SENSORS):
        rng = np.random.default_rng([seed, 100 + k])
        cases = []
        for j in range(n):
            case = random_case(rng, (), seconds=seconds, torque_noise=0.05, rate=rate, counts=counts)
            cases.append((case.plant, replace(case.train, excitation=EXCITATIONS[j % len(EXCITATIONS)], scale=1.0)))
        runs = [(run.time, run.position, np.r_[0.0, run.torque[:-1]]) for run in simulate(cases)]
        begin = time.process_time()
        told = watched(runs, rate, counts)
        cost = (time.process_time() - begin) / len(runs[0][0]) / n * 1e6
        alarms = sum(own[-1][1].alarms for own in told)
        hours = n * seconds / 3600
        rows.append((f"{rate:g}", f"{counts:,}", f"{hours:.2f}", str(alarms), f"{cost:.1f}"))
    terminal.heading("Nothing changes: alarms, where one an hour is set")
    terminal.table(("rate [Hz]", "counts", "hours", "alarms", f"us a sample, {n} at once"), rows)


def played(files: Sequence[str], seconds: float, terminal: Terminal) -> None:
    """Recordings of machines that do not change, played back again and again."""
    rows = []
    for file in files:
        recording = read_recording(file)
        watch = Watch(recording.rate, smoothing=choose_smoothing(recording))
        time, motion = recording.time - recording.time[0], recording.position
        torque, length = np.r_[0.0, recording.torque[:-1]], time[-1] + 1.0  # a gap before it begins anew
        turns = max(1, round(seconds / length))
        for k in range(turns * len(time)):
            turn, row = divmod(k, len(time))
            (verdict,) = watch.take(time[row : row + 1] + turn * length, motion[row : row + 1], torque[row : row + 1])
        kind = "not in motion for long enough" if verdict.error is None else verdict.kind
        rows.append((recording.name, f"{turns * len(time) / recording.rate:.0f}", str(verdict.alarms), kind))
    terminal.heading("Recordings played back")
    terminal.table(("recording", "seconds", "alarms", "said in the end"), rows, left=("said in the end",))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.watching", description=__doc__.partition("\n")[0])
    parser.add_argument("--n", type=int, default=40, help="plants for each effect (default 40)")
    parser.add_argument("--nulls", type=int, default=32, help="plants that do not change, for each sensor (default 32)")
    parser.add_argument(
        "--seconds", type=float, default=120.0, help="that each of those runs for, or is played (default 120)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recordings", nargs="+", help="of machines that do not change, to play back instead")
    args = parser.parse_args(argv)
    terminal = Terminal()
    if args.recordings:
        played(args.recordings, args.seconds, terminal)
        return 0
    nulls(args.seconds, args.nulls, args.seed, terminal)
    detection(args.n, args.seed, terminal)
    return 0


if __name__ == "__main__":
    sys.exit(main())
