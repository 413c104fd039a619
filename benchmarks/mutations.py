"""Which numbers decide: every field of the criterion times 0.7 and 1.4, and what changes on recordings of known truth.

python -m benchmarks.mutations FOLDER        # with NAME.train.csv.gz, NAME.holdout.csv.gz and truth.json
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from benchmarks.parallel import each
from benchmarks.scoring import Outcome, examine, take_workers
from benchmarks.truth import Truth, read_truth
from estimators.selection.criterion import Criterion
from pendulum_env.lookup import find
from workbench.terminal import Terminal

FACTORS = (0.7, 1.4)
CERTAIN = "certain"  # a probability that only scales what is told: no verdict hangs on it


@dataclass(frozen=True)
class Mutation:
    """One field of the criterion times a factor; no field as it stands."""

    field: str = ""
    factor: float = 1.0

    @property
    def criterion(self) -> Criterion:
        """The criterion with that field changed; a whole number stays one, and changes by one at least."""
        standard = Criterion()
        if not self.field:
            return standard
        value = asdict(standard)[self.field]
        if isinstance(value, int):
            changed = max(1, value + (1 if self.factor > 1 else -1) * max(1, round(abs(self.factor - 1) * value)))
            return replace(standard, **{self.field: changed})
        return replace(standard, **{self.field: value * self.factor})


def mutations() -> list[Mutation]:
    """The criterion as it stands, and every change of it."""
    fields = [name for name in asdict(Criterion()) if name != CERTAIN]
    return [Mutation(), *(Mutation(name, factor) for name in fields for factor in FACTORS)]


def judged(work: tuple[Mutation, Truth], folder: Path) -> tuple[Mutation, Outcome]:
    """What is said of a case under a changed criterion."""
    mutation, truth = work
    return mutation, examine(truth, folder, mutation.criterion)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutations", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="NAME.train.csv.gz, NAME.holdout.csv.gz and truth.json")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these recordings only")
    take_workers(parser)
    arguments = parser.parse_args(argv)
    terminal = Terminal()
    try:
        truths = {truth.name: truth for truth in read_truth(arguments.folder)}
        if arguments.only:
            truths = {name: find("recording", name, truths) for name in arguments.only}
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    work = [(mutation, truth) for mutation in mutations() for truth in truths.values()]
    doing = partial(judged, folder=arguments.folder)
    found = each(doing, work, workers=arguments.workers, title="diagnosing", terminal=terminal)
    tell(found, terminal)
    return 0 if len(found) == len(work) else 130


def tell(found: Sequence[tuple[Mutation, Outcome]], terminal: Terminal) -> None:
    """Print how many are right under each change, and whose verdict it changes."""
    said: dict[Mutation, dict[str, Outcome]] = {}
    for mutation, outcome in found:
        said.setdefault(mutation, {})[outcome.truth.name] = outcome
    usual = said.get(Mutation(), {})
    rows = []
    for mutation in mutations():
        cases = said.get(mutation, {})
        changed = [name for name, one in cases.items() if name in usual and told(one) != told(usual[name])]
        right = f"{sum(one.right for one in cases.values())} of {len(cases)}"
        label = f"{mutation.field} x {mutation.factor:g}" if mutation.field else "as it stands"
        rows.append((label, right, ", ".join(sorted(changed)) or "-"))
    terminal.heading("What each number decides")
    terminal.table(("number", "right", "verdicts that change"), rows, left=("right", "verdicts that change"))


def told(outcome: Outcome) -> tuple[object, ...]:
    """What counts as the verdict."""
    return set(outcome.selected), {frozenset(group) for group in outcome.groups}, outcome.unexplained is not None


if __name__ == "__main__":
    sys.exit(main())
