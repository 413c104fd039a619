"""Success of suggested experiments at resolving ambiguous diagnoses, compared with other experiments.

python -m benchmarks.ambiguity --n 120

Random plants, each with one effect of the library or none, are recorded for 8 s with weak torque, small swings or one
direction of rotation, which makes many diagnoses ambiguous. Ambiguous plants get a second recording of 20 s: the same
signal, a random signal of the family of suggestions, or the suggested signal. Both recordings are diagnosed together.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.draws import make_generator
from benchmarks.excitation import filtered_noise
from benchmarks.independent_plant import LIBRARY, Array, Case, random_case, simulate
from benchmarks.parallel import each
from benchmarks.scoring import Exact, compare, positive, rate, take_workers
from estimators import Diagnosis, diagnose
from estimators.diagnosis.experiment import DEFAULT_TORQUE, EXPERIMENT_TIME, UnreachableAims
from pendulum_env.excitation import draw_family
from pendulum_env.recording import Recording
from workbench.terminal import Terminal

BRIEF = 8.0  # duration of the first recording [s]
RATES = (500.0, 1000.0)  # [Hz]
SUGGESTED = "suggested"
ARMS = ("more of the same", "drawn from the family", SUGGESTED)
Pair = frozenset[str]


def weak(rng: np.random.Generator, time: Array) -> Array:
    """Return weak filtered noise, barely above the dry friction [N m]."""
    return filtered_noise(rng, time, float(rng.uniform(0.2, 0.4)))


def small_swings(rng: np.random.Generator, time: Array) -> Array:
    """Return two fast tones, for angles within about 0.3 rad [N m]."""
    fast, slow = rng.uniform(11, 15), rng.uniform(8, 11)  # [rad/s]
    return np.asarray(np.sin(fast * time) + 0.6 * np.sin(slow * time + rng.uniform(0, 2 * np.pi)))


def one_way(rng: np.random.Generator, time: Array) -> Array:
    """Return two tones on a constant torque, for rotation in one direction [N m]."""
    fast, slow = rng.uniform(7, 11), rng.uniform(4, 6)  # [rad/s]
    return np.asarray(4.6 + 0.6 * np.sin(fast * time + rng.uniform(0, 2 * np.pi)) + np.sin(slow * time))


POOR = (weak, small_swings, one_way)


@dataclass(frozen=True)
class Study:
    """Plant, signal of its first recording, and seed of both recordings."""

    case: Case
    poor: Callable[[np.random.Generator, Array], Array]
    seed: int


@dataclass(frozen=True)
class Row:
    """Result of one plant.

    Attributes:
        hidden: hidden effects.
        open: pairs of effects that the first recording does not distinguish.
        right: whether its diagnosis names exactly the hidden effects.
        left: pairs not distinguished after the second recording, by arm of the study.
        settled: whether both recordings name exactly the hidden effects, by arm of the study.
    """

    hidden: tuple[str, ...]
    open: frozenset[Pair]
    right: bool
    left: dict[str, frozenset[Pair]]
    settled: dict[str, bool]
    failure: str = ""

    @property
    def line(self) -> str:
        """Return the result on one line."""
        arms = ", ".join(
            f"{arm}: {'right' if self.settled[arm] else 'wrong'}{f', {len(left)} open' if left else ''}"
            for arm, left in self.left.items()
        )
        open_pairs = "; ".join(" = ".join(sorted(pair)) for pair in sorted(self.open, key=sorted))
        return f"{'+'.join(self.hidden) or 'nothing':28s} {self.failure or open_pairs or 'clear':60s} {arms}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ambiguity", description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=positive, default=120, help="plants (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    take_workers(parser)
    arguments = parser.parse_args(argv)
    terminal = Terminal()
    studies = [poor_study(arguments.seed, k) for k in range(arguments.n)]

    def show(row: Row) -> None:
        terminal.print(row.line)

    rows = each(examine, studies, workers=arguments.workers, title="diagnosing", terminal=terminal, show=show)
    print_results(rows, terminal)
    return 0 if len(rows) == len(studies) else 130


def poor_study(seed: int, k: int) -> Study:
    """Return the k-th plant, with low friction; effects in turn, none in every tenth plant."""
    hidden = () if k % 10 == 9 else (LIBRARY[k % len(LIBRARY)],)
    rng = make_generator(seed, k if k % 10 == 9 else k // len(LIBRARY), *hidden)
    case = random_case(rng, hidden, rate=float(rng.choice(RATES)), coulomb=float(rng.uniform(0.2, 0.5)))
    return Study(case, POOR[rng.integers(len(POOR))], int(rng.integers(2**31)))


def examine(study: Study) -> Row:
    """Diagnose a first recording and, if it is ambiguous, again with each second recording."""
    hidden = tuple(study.case.plant.effects)
    try:
        first = record(study, BRIEF, study.poor, 0)
        found = diagnose([first], max_angle=np.inf, max_speed=np.inf)
        open_pairs = undecided(found)
        right = is_right(hidden, found)
        if not open_pairs:
            return Row(hidden, open_pairs, right, {}, {})
        # without a suggestion, its arm has no second recording
        left, settled = {SUGGESTED: open_pairs}, {SUGGESTED: right}

        def drawn(rng: np.random.Generator, time: Array) -> Array:
            signals = draw_family(rng, EXPERIMENT_TIME, DEFAULT_TORQUE)
            return signals[rng.integers(len(signals))].signal(time)

        commands = dict(zip(ARMS, (study.poor, drawn), strict=False))
        if found.suggestion is not None and found.suggestion.signal is not None:
            suggested = found.suggestion.signal.signal
            commands[SUGGESTED] = lambda rng, time: suggested(time)
        for arm, command in commands.items():
            both = diagnose([first, record(study, EXPERIMENT_TIME, command, 1)], max_angle=np.inf, max_speed=np.inf)
            left[arm], settled[arm] = undecided(both), is_right(hidden, both)
        return Row(hidden, open_pairs, right, left, settled)
    except Exception as error:  # keep the other cases
        return Row(hidden, frozenset(), False, {}, {}, f"{type(error).__name__}: {error}")


def record(
    study: Study, seconds: float, command: Callable[[np.random.Generator, Array], Array], number: int
) -> Recording:
    """Record the plant under a command; `number`: 0 for the first recording, 1 for the second."""
    rate = study.case.train.rate
    experiment = replace(study.case.train, seconds=seconds, seed=study.seed + number)
    torque = command(np.random.default_rng([study.seed, number]), np.arange(round(seconds * rate)) / rate)
    (run,) = simulate([(study.case.plant, experiment)], [torque])
    return Recording(run.time, run.position, run.torque, name=f"run {number}")


def undecided(found: Diagnosis) -> frozenset[Pair]:
    """Return the pairs that a diagnosis does not distinguish, but another torque would."""
    pairs = {frozenset((first, other)) for first, *others in found.ambiguous for other in others}
    if found.suggestion is not None:
        pairs |= {frozenset((aim.effect, aim.instead)) for aim in found.suggestion.settles if aim.instead}
    return frozenset(pairs - {frozenset(pair) for pair in list_inseparable(found)})


def list_inseparable(found: Diagnosis) -> tuple[tuple[str, str], ...]:
    """List the pairs of a term and an effect that no torque would distinguish."""
    findings = (*found.findings, found.no_experiment)
    unreachable = [own for own in findings if isinstance(own, UnreachableAims) and own.limits is None]
    return tuple((aim.instead or "", aim.effect) for own in unreachable for aim in own.aims)


def is_right(hidden: tuple[str, ...], found: Diagnosis) -> bool:
    """Return whether the hidden effect, or one inseparable from it, is named."""
    return compare(hidden, found.selected, list_inseparable(found), bool(found.unexplained)) is not Exact.NO


def print_results(rows: Sequence[Row], terminal: Terminal) -> None:
    """Print the table of results."""
    failed = [row for row in rows if row.failure]
    ambiguous = [row for row in rows if row.open]
    after_first = f"{len(ambiguous)} ambiguous after the first recording"
    terminal.print_heading(f"{len(rows)} plants, {after_first}, {len(failed)} failed")
    count: Callable[[Sequence[bool]], str] = lambda hits: rate(sum(hits), len(hits))  # noqa: E731
    table = [("first recording only", count([True for _ in ambiguous]), count([row.right for row in ambiguous]))]
    for arm in ARMS:
        still = count([bool(row.left[arm]) for row in ambiguous])
        table.append((arm, still, count([row.settled[arm] for row in ambiguous])))
    terminal.print_table(("second recording", "still ambiguous", "right"), table)


if __name__ == "__main__":
    sys.exit(main())
