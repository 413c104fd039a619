"""What a diagnosis looks for and what is known before it, as the command line's options of these names have it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from estimators.arguments import chosen_effects, within_limits
from pendulum_env.physics import Term
from workbench.inputs import ids, known, ranges
from workbench.mistakes import sentence


@dataclass(frozen=True)
class Asked:
    """Effects to look for, values that are known and bounds of others, each in the words of the command line.

    Attributes:
        only: ids of the effects that are looked for, with commas; empty: all.
        without: ids of those that are not.
        fix: `gravity=2.01,...`
        bound: `viscous=0:0.5,...`
    """

    only: str = ""
    without: str = ""
    fix: str = ""
    bound: str = ""

    @classmethod
    def of(cls, values: Sequence[Any]) -> Asked:
        """What the fields of a form hold, in order: ids in a list, or text."""
        return cls(
            *(",".join(map(str, value)) if isinstance(value, list) else str(value or "").strip() for value in values)
        )

    @property
    def effects(self) -> dict[str, Any]:
        """What `diagnose` takes of effects; raises as the command line does."""
        return {"only": ids(self.only) or None, "without": ids(self.without)}

    @property
    def limits(self) -> dict[str, Any]:
        """What `diagnose` and `add` take of parameters; raises as the command line does."""
        return {
            "fixed": known(self.fix) if self.fix else {},
            "bounds": ranges(self.bound) if self.bound else {},
        }

    def faults(self, terms: Sequence[Term]) -> dict[str, str]:
        """What is wrong beside a model's terms, a sentence for each field."""
        checks: tuple[tuple[str, Callable[[], object]], ...] = (
            ("only", lambda: chosen_effects(None, ids(self.only) or None, ())),
            ("without", lambda: chosen_effects(None, **self.effects)),
            ("fix", lambda: within_limits(terms, {}, Asked(fix=self.fix).limits["fixed"], {})),
            ("bound", lambda: within_limits(terms, {}, **self.limits)),
        )
        found: dict[str, str] = {}
        for field, check in checks:
            try:
                check()
            except ValueError as mistake:
                if sentence(mistake) not in found.values():  # the second of a pair is tried with the first
                    found[field] = sentence(mistake)
        return found

    def options(self, *fields: str) -> list[str]:
        """Some fields as words of a command."""
        return [f"--{field}={getattr(self, field)}" for field in fields if getattr(self, field)]

    def arguments(self, *kinds: dict[str, Any]) -> str:
        """Arguments of Python that are given, each with a comma before it."""
        return "".join(f", {name}={value!r}" for kind in kinds for name, value in kind.items() if value)


NOTHING = Asked()  # every effect is looked for, and nothing is known
