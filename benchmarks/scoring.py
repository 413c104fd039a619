"""Scores of diagnoses with known truth: single cases and totals."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.parallel import each, peak_memory
from benchmarks.truth import Truth, read_pair
from estimators.decisions.errors import Errors
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.run import diagnose
from estimators.findings import Verdict
from pendulum_env.physics import effects
from workbench.terminal import Terminal

CLEAR = 0.02  # smallest effect that should be found [share of the RMS torque]
FALL = 1.5  # required ratio of held-out errors before and after
SHARES = (0.0, 0.01, 0.02, 0.05, 0.1, 1.0)  # bins of the effect's share of the torque


class Exact(StrEnum):
    """Agreement of a diagnosis with the hidden effects."""

    YES = "yes"
    AMBIGUOUS = "ambiguous"  # right within a group of indistinguishable effects
    NO = "no"


@dataclass(frozen=True)
class Claim:
    """Effect that a diagnosis selects, or names as equally good."""

    effect: str
    score: float
    is_selected: bool = True


@dataclass(frozen=True)
class Outcome:
    """Diagnosis of one case.

    Attributes:
        errors: on the held-out recording, of the base model and after each effect added.
        claims: selected and ambiguous effects with their scores.
        deviations: estimate minus truth [standard errors], if the model has the true terms.
        torque: RMS of the recorded torque [N m].
        memory: peak memory of the process [MB].
        failure: error message instead of a diagnosis.
    """

    truth: Truth
    selected: tuple[str, ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()
    unexplained: str | None = None
    errors: tuple[Errors, ...] = ()
    claims: tuple[Claim, ...] = ()
    deviations: dict[str, float] = field(default_factory=dict)
    torque: float = 0.0
    seconds: float = 0.0
    memory: float = 0.0
    failure: str = ""

    @property
    def exact(self) -> Exact:
        """Return the agreement with the hidden effects."""
        if self.failure:
            return Exact.NO
        return compare(self.truth.hidden, self.selected, self.groups, self.unexplained is not None)

    @property
    def right(self) -> bool:
        """Return whether the verdict is right, perhaps within a group."""
        return self.exact is not Exact.NO

    @property
    def spurious(self) -> set[str]:
        """Return the selected effects that are not hidden; empty if the verdict is right."""
        return set() if self.right else set(self.selected) - set(self.truth.hidden)

    def is_right(self, claim: Claim) -> bool:
        """Return whether a claimed effect, or for a selected one its group, is hidden."""
        group = next((g for g in self.groups if g[0] == claim.effect), ()) if claim.is_selected else ()
        return bool({claim.effect, *group} & set(self.truth.hidden))

    @property
    def ratios(self) -> list[tuple[float, float]]:
        """Return the ratios of held-out errors after and before each step, in torque and position."""
        return [
            (new.torque_rms / max(old.torque_rms, 1e-300), new.position_rms / max(old.position_rms, 1e-300))
            for old, new in pairwise(self.errors)
        ]

    @property
    def fall(self) -> tuple[float, float]:
        """Return base over final held-out error in torque and position; 1 if the diagnosis failed."""
        if not self.errors:
            return 1.0, 1.0
        first, last = self.errors[0], self.errors[-1]
        return first.torque_rms / max(last.torque_rms, 1e-300), first.position_rms / max(last.position_rms, 1e-300)

    @property
    def line(self) -> str:
        """Return the result on one line."""
        truth = f"{self.truth.name:28s} {self.truth.label:42s}"
        if self.failure:
            return f"{truth} failed: {self.failure}"
        parts = [
            f"{truth} {'+'.join(self.selected) or 'nothing':42s} {self.exact:9s}",
            "torque " + (" ".join(f"{torque:.2f}" for torque, _ in self.ratios) or "-"),
            "position " + (" ".join(f"{position:.2f}" for _, position in self.ratios) or "-"),
            f"{self.seconds:5.1f} s",
        ]
        if self.groups:
            parts.append("alike: " + "; ".join(" = ".join(group) for group in self.groups))
        if self.unexplained:
            parts.append(f"unexplained: {self.unexplained.partition(';')[0]}")
        if self.deviations:
            parts.append("z: " + " ".join(f"{name} {z:+.1f}" for name, z in self.deviations.items()))
        return "  ".join(parts)


def compare(
    hidden: Sequence[str], selected: Sequence[str], groups: Sequence[Sequence[str]], unexplained: bool
) -> Exact:
    """Compare a selection with the hidden effects; those outside the library must leave `unexplained` true."""
    known = set(hidden) & effects().keys()
    if len(known) < len(set(hidden)) and not unexplained:
        return Exact.NO
    if set(selected) == known:
        return Exact.YES
    choices = [{id, *(other for group in groups if id in group for other in group)} for id in selected]
    swapped = any(set(choice) == known and len(choice) == len(known) for choice in product(*choices))
    return Exact.AMBIGUOUS if swapped else Exact.NO


def examine(truth: Truth, folder: Path) -> Outcome:
    """Diagnose one pair of recordings; an exception becomes a failure."""
    try:
        train, holdout = read_pair(folder, truth.name)
        begin = perf_counter()
        found = diagnose([train], [holdout])
        seconds = perf_counter() - begin
    except Exception as error:  # keep the other cases
        return Outcome(truth, failure=f"{type(error).__name__}: {error}")
    where = found.json()["unexplained"]
    named = (Verdict.SELECTED, Verdict.AMBIGUOUS)
    return Outcome(
        truth=truth,
        selected=found.selected,
        groups=found.ambiguous,
        unexplained=str(where["where"]) if where["present"] else None,
        errors=tuple(step.errors["holdout"] for step in found.steps),
        claims=tuple(
            Claim(c.effect, c.score, c.verdict is Verdict.SELECTED) for c in found.candidates if c.verdict in named
        ),
        deviations=deviations(truth, found),
        torque=float(np.sqrt(np.mean(train.torque**2))),
        seconds=seconds,
        memory=peak_memory(),
    )


def deviations(truth: Truth, found: Diagnosis) -> dict[str, float]:
    """Return estimate minus truth [standard errors] by parameter; empty unless the selection is exact."""
    if set(found.selected) != set(truth.hidden):
        return {}
    return {
        name: (estimate.value - truth.parameters[name]) / estimate.std
        for name, estimate in found.model.estimates.items()
        if name in truth.parameters and estimate.std > 0
    }


def examine_all(folder: Path, truths: Sequence[Truth], workers: int, terminal: Terminal) -> list[Outcome]:
    """Diagnose every case and print a line for each; after an interrupt, return those so far."""

    def show(outcome: Outcome) -> None:
        terminal.print(outcome.line)

    work: Callable[[Truth], Outcome] = partial(examine, folder=folder)
    return each(work, truths, workers=workers, title="diagnosing", terminal=terminal, show=show)


# ------------------------------------------------------------------------------------------------------------- totals


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Return the confidence interval of a share, 95 % by default. Source: Wilson, JASA 22, 1927."""
    if count == 0:
        return 0.0, 1.0
    share, weight = hits / count, z**2 / count
    centre = share + weight / 2
    half = z * np.sqrt(share * (1 - share) / count + weight / (4 * count))
    return max(0.0, float((centre - half) / (1 + weight))), min(1.0, float((centre + half) / (1 + weight)))


def rate(hits: int, count: int) -> str:
    """Return `57 of 60, 95 % (86 to 98 %)`."""
    if count == 0:
        return "none"
    low, high = wilson(hits, count)
    return f"{hits} of {count}, {hits / count:.0%} ({100 * low:.0f} to {high:.0%})"


@dataclass(frozen=True)
class Curve:
    """Share of successes by bins of a quantity.

    Attributes:
        quantity, success: names of the quantity and of the success.
        bins: lower and upper edge, numbers of successes and cases, and mean of the quantity, without empty bins.
    """

    quantity: str
    success: str
    bins: tuple[tuple[float, float, int, int, float], ...]

    @classmethod
    def of(cls, quantity: str, success: str, edges: Sequence[float], cases: Sequence[tuple[float, bool]]) -> Curve:
        """Sort cases (quantity, success) into bins between the edges."""
        bins = []
        for low, high in pairwise(edges):
            some = [case for case in cases if low <= case[0] < high]
            if some:
                mean = sum(value for value, _ in some) / len(some)
                bins.append((low, high, sum(success for _, success in some), len(some), mean))
        return cls(quantity, success, tuple(bins))

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Return the range, mean and rate of each bin."""
        return [
            (f"{low:g} to {high:g}", f"{mean:.3g}", rate(hits, count)) for low, high, hits, count, mean in self.bins
        ]

    def print(self, terminal: Terminal) -> None:
        """Print the rate of each bin."""
        terminal.print_heading(f"{self.success.capitalize()} by {self.quantity}")
        terminal.print_table((self.quantity, "mean", self.success), self.rows, left=(self.success,))


def select_library_cases(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the cases with hidden effects that are all in the library."""
    return [o for o in outcomes if o.truth.hidden and set(o.truth.hidden) <= effects().keys()]


def right_of(outcomes: Sequence[Outcome]) -> str:
    """Return the rate of right outcomes as text."""
    return rate(sum(outcome.right for outcome in outcomes), len(outcomes))


def is_clear(outcome: Outcome) -> bool:
    """Return whether the hidden effects have a share of at least `CLEAR` of the torque."""
    return outcome.truth.share is not None and outcome.truth.share >= CLEAR


def print_totals(outcomes: Sequence[Outcome], terminal: Terminal) -> None:
    """Print rates, false alarms, time and memory."""
    nulls = [o for o in outcomes if not o.truth.hidden]
    library = effects().keys()
    outside = [o for o in outcomes if set(o.truth.hidden) - library]
    inside = [o for o in outcomes if o.truth.hidden and o not in outside]
    exact = [o.exact for o in outcomes]
    steps = [ratio for o in outcomes for ratio in o.ratios]
    alarms = sum(bool(o.selected) for o in nulls)
    fallen = sum(min(o.fall) >= FALL for o in inside)
    terminal.print_heading("Totals")
    rows = [
        ("right", right_of(outcomes)),
        ("  exactly", rate(exact.count(Exact.YES), len(exact))),
        ("  within a group of effects that look alike", str(exact.count(Exact.AMBIGUOUS))),
        ("right where a library effect is hidden", right_of(inside)),
        (f"  of at least {CLEAR:.0%} of the torque after the refit", right_of([o for o in inside if is_clear(o)])),
        ("  with two effects", right_of([o for o in inside if len(o.truth.hidden) > 1])),
        ("right outside the library (nothing selected, unexplained)", right_of(outside)),
        ("false alarms where nothing is hidden", rate(alarms, len(nulls))),
        ("  called unexplained there", rate(sum(o.unexplained is not None for o in nulls), len(nulls))),
        ("spurious effects beside or instead of hidden ones", rate(sum(bool(o.spurious) for o in inside), len(inside))),
        (f"both held-out errors fall by {FALL:g} or more where a library effect is hidden", rate(fallen, len(inside))),
        ("steps that lower both held-out errors", rate(sum(max(pair) < 1 for pair in steps), len(steps))),
        ("failed", str(sum(bool(o.failure) for o in outcomes))),
    ]
    done = [o for o in outcomes if not o.failure]
    if done:
        seconds = [o.seconds for o in done]
        rows.append(("time, median and longest [s]", f"{np.median(seconds):.1f}, {max(seconds):.1f}"))
        rows.append(("peak memory [MB]", f"{max(o.memory for o in done):.0f}"))
    terminal.print_table(("", "rate (95 % interval)"), rows, left=("rate (95 % interval)",))


def print_by_effect(outcomes: Sequence[Outcome], terminal: Terminal) -> None:
    """Print for each effect the rates of right cases, alone and in pairs, and the number of wrong ones."""
    rows = []
    for id in dict.fromkeys(["nothing", *effects(), *(id for o in outcomes for id in o.truth.hidden)]):
        alone = [o for o in outcomes if o.truth.label == id]
        paired = [o for o in outcomes if len(o.truth.hidden) > 1 and id in o.truth.hidden]
        wrongly = sum(id in o.spurious for o in outcomes)
        if alone or paired or wrongly:
            found = sum(id in o.selected or o.right for o in paired)
            right = sum(o.right for o in alone)
            rows.append((id, f"{right} of {len(alone)}", f"{found} of {len(paired)}" if paired else "-", str(wrongly)))
    terminal.print_heading("By effect")
    terminal.print_table(("hidden", "right alone", "found in pairs", "selected wrongly"), rows)


def print_by_share(outcomes: Sequence[Outcome], terminal: Terminal) -> None:
    """Print the rate of right diagnoses of library effects by their share of the torque."""
    cases = [(o.truth.share, o.right) for o in select_library_cases(outcomes) if o.truth.share is not None]
    Curve.of("share of the torque that the base model misses after its refit", "right", SHARES, cases).print(terminal)


def positive(text: str) -> int:
    """Return the positive whole number, for argparse."""
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return value


def take_workers(parser: argparse.ArgumentParser) -> None:
    """Declare --workers."""
    cores = os.cpu_count() or 1
    parser.add_argument("--workers", type=positive, default=min(2, cores), help="processes (default %(default)s)")
