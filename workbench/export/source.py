"""Expressions as lines of a program: what is used twice, or has a name for the reader, is a variable."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pendulum_env.physics.symbols import NAME, Operand, Symbol, distinct

WIDE = 64  # characters, from which a part of an expression is a variable of its own
INFIX: dict[str, tuple[str, int]] = {  # and how tightly it binds
    "add": ("+", 4),
    "subtract": ("-", 4),
    "multiply": ("*", 5),
    "divide": ("/", 5),
    "less": ("<", 3),
    "less_equal": ("<=", 3),
    "greater": (">", 3),
    "greater_equal": (">=", 3),
    "equal": ("==", 3),
    "not_equal": ("!=", 3),
}
NEGATIVE, ATOM, LOOSE = 6, 9, 0


@dataclass(frozen=True)
class Dialect:
    """How a language writes what `INFIX` does not say: templates over the operands."""

    calls: Mapping[str, str]  # by operation, such as "sin({0})" or "{0} ? {1} : {2}"
    infinity: str

    def number(self, value: float) -> str:
        """A number, so that it is read back as it is."""
        if value in (float("inf"), float("-inf")):
            return self.infinity if value > 0 else f"-{self.infinity}"
        return repr(value)


@dataclass
class Source:
    """Lines that compute results."""

    dialect: Dialect
    lines: list[tuple[str, str]] = field(default_factory=list)  # name and expression of each variable, in order
    results: list[str] = field(default_factory=list)  # expression of each result
    used: set[str] = field(default_factory=set)  # operations that occur
    names: set[str] = field(default_factory=set)  # given names that occur

    @classmethod
    def of(cls, results: Sequence[Operand], dialect: Dialect) -> Source:
        """Write the results down."""
        source = cls(dialect)
        order, same = distinct(results)
        counts = Counter(same[x] for x in (*(x for s in order for x in s.inputs), *results) if isinstance(x, Symbol))
        texts: dict[Symbol, tuple[str, int]] = {}

        def operand(x: Operand) -> tuple[str, int]:
            if isinstance(x, Symbol):
                return texts[same[x]]
            return dialect.number(x), ATOM if x >= 0 else NEGATIVE

        for symbol in order:
            text = source._text(symbol, [operand(x) for x in symbol.inputs])
            if symbol.op != NAME and (symbol.label or counts[symbol] > 1 or len(text[0]) > WIDE):
                name = symbol.label or f"t{len(source.lines) + 1}"
                source.lines.append((name, text[0]))
                text = name, ATOM
            texts[symbol] = text
        source.results = [operand(x)[0] for x in results]
        return source

    def _text(self, symbol: Symbol, parts: Sequence[tuple[str, int]]) -> tuple[str, int]:
        """Expression of a symbol of operands, and how tightly it binds."""
        if symbol.op == NAME:
            self.names.add(symbol.label)
            return symbol.label, ATOM
        self.used.add(symbol.op)
        if symbol.op in INFIX:
            sign, tight = INFIX[symbol.op]
            keeps = symbol.op in ("add", "multiply", "subtract", "divide")  # evaluated from the left
            left = _within(parts[0], tight if keeps else tight + 1)
            return f"{left} {sign} {_within(parts[1], tight + 1)}", tight
        if symbol.op == "negative":
            return f"-{_within(parts[0], NEGATIVE + 1)}", NEGATIVE
        template = self.dialect.calls[symbol.op]
        encloses = template.endswith(")")
        inner = [_within(part, LOOSE if encloses else ATOM) for part in parts]
        return template.format(*inner), ATOM if encloses else LOOSE


def _within(part: tuple[str, int], tight: int) -> str:
    text, own = part
    return text if own >= tight else f"({text})"
