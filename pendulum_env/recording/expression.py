"""Parse the expression of a column: name, unit, sign, gains, ratios and offset.

    [-]NAME[:UNIT][*GAIN or /RATIO, repeated][+OFFSET[:UNIT] or -OFFSET[:UNIT]]

`torque=current:A*0.091`, `position=-motor_angle/6`, `position=enc:counts/4096`, `position=angle:deg-90`. Gains, ratios
and offsets are numbers or `pi`. The offset comes last and is added after the gains, in its own unit or else that of the
column. An unknown gain is `?`: `torque=current:A*?`. A text that equals the name of a column, such as `rate-of-turn`,
is not parsed.
"""

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from pendulum_env.errors import ColumnError

GRAMMAR = "NAME:UNIT*GAIN/RATIO+OFFSET:UNIT"
LONGEST_UNIT = 64  # characters of a unit; the search time grows with the square
NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|pi\b")
FACTOR = re.compile(rf"\s*([*/])\s*([+-]?(?:{NUMBER.pattern})|\?)\s*")
OFFSET = re.compile(rf"\s*([+-])\s*({NUMBER.pattern})\s*(?::(.*))?$", re.S)


class UnknownColumnError(ColumnError):
    """Unknown column name."""


class UnknownUnitError(ColumnError):
    """Unknown unit name."""


@dataclass(frozen=True)
class Expression:
    """Column of a file with its conversion: gain times column, plus offset."""

    name: str
    unit: str | None = None  # unit of the column, as written
    factors: tuple[str, ...] = ()  # as written: `*0.091`, `/6`, `*?`
    offset: str | None = None  # as written: `-90`
    offset_unit: str | None = None  # as written; None: unit of the column
    is_negative: bool = False

    @property
    def gain(self) -> float:
        """Return the product of sign, gains and ratios, with 1 for an unknown gain."""
        gain = -1.0 if self.is_negative else 1.0
        for factor in self.factors:
            if factor != "*?":
                gain = gain * _parse_number(factor[1:]) if factor[0] == "*" else gain / _parse_number(factor[1:])
        return gain

    @property
    def shift(self) -> float:
        """Return the offset in its unit."""
        return 0.0 if self.offset is None else _parse_number(self.offset[1:]) * (-1.0 if self.offset[0] == "-" else 1.0)

    @property
    def is_gain_unknown(self) -> bool:
        """Return whether the gain is unknown."""
        return "*?" in self.factors

    def has_factor(self, factor: float) -> bool:
        """Return whether successive gains and ratios have the product `factor`, within 0.1 %: `*pi/180` has 0.01745."""
        ends = range(len(self.factors) + 1)
        products = (abs(Expression("", factors=self.factors[i:j]).gain) for j in ends for i in range(j))
        return any(math.isclose(product, factor, rel_tol=1e-3) for product in products)

    def __str__(self) -> str:
        unit = "" if self.unit is None else f":{self.unit}"
        offset = (self.offset or "") + ("" if self.offset_unit is None else f":{self.offset_unit}")
        return f"{'-' if self.is_negative else ''}{self.name}{unit}{''.join(self.factors)}{offset}"


def parse_expression(text: str, headers: Sequence[str], units: Collection[str]) -> Expression:
    """Parse an expression with the names of the columns and the letters of known units."""
    text = text.strip()
    if text in headers:
        return Expression(text)
    signs = [(False, text), (True, text[1:].lstrip())] if text.startswith("-") else [(False, text)]
    matches = [
        (name, is_negative, remainder[len(name) :])
        for is_negative, remainder in signs
        for name in headers
        if name and re.match(r"\s*(?:[:*/+-]|$)", remainder[len(name) :] if remainder.startswith(name) else "no")
    ]
    mistakes = []
    for name, is_negative, remainder in sorted(matches, key=lambda match: len(match[0]), reverse=True):
        try:
            return _parse_conversion(name, is_negative, remainder, units)
        except ColumnError as error:
            mistakes.append(error)
    if mistakes:
        raise mistakes[0]
    name = re.split(r"[:*]", signs[-1][1])[0].strip() or text
    raise UnknownColumnError(name)


def normalise_name(unit: str) -> str:
    """Remove case, spaces, brackets and separators from a unit or name: `Pos [°]` becomes `posdeg`."""
    return re.sub(r"[\s_\-./·⋅*^()\[\]{}:,]+", "", unit.lower().replace("°", "deg"))


def _parse_conversion(name: str, is_negative: bool, remainder: str, units: Collection[str]) -> Expression:
    """Parse the text after the name of a column."""
    unit, factors, offset, offset_unit = None, [], None, None
    ending = remainder.strip()
    remainder = remainder.lstrip()
    if remainder.startswith(":"):
        unit, remainder = _split_unit(remainder[1:], units)
    while match := FACTOR.match(remainder):
        factors.append(match[1] + match[2])
        remainder = remainder[match.end() :]
    if match := OFFSET.match(remainder):
        offset, remainder = match[1] + match[2], ""
        if match[3] is not None:
            offset_unit, remainder = _split_unit(match[3], units)
    if remainder.strip() or "/?" in factors or factors.count("*?") > 1:
        raise ColumnError(f"{ending!r} behind column {name!r} is not understood: write {GRAMMAR}, such as {name}*0.5")
    expression = Expression(name, unit, tuple(factors), offset, offset_unit, is_negative)
    numbers = [_parse_number(factor[1:]) for factor in factors if factor != "*?"]
    if 0 in numbers or expression.gain == 0 or not math.isfinite(expression.gain + expression.shift):
        raise ColumnError(f"{ending!r} behind column {name!r}: gains, ratios and offsets are finite, gains are not 0")
    return expression


def _split_unit(text: str, units: Collection[str]) -> tuple[str, str]:
    """Split a text into its longest leading unit and the rest, which is empty or begins with a sign.

    Units may contain signs: `rad/s/6` has the unit rad/s and the ratio 6.
    """
    ends = [*(match.start() for match in re.finditer(r"[*/+-]", text[:LONGEST_UNIT])), len(text)]
    for end in reversed(ends):
        unit = text[:end].strip()
        if normalise_name(unit) in units and unit[-1] not in "*/+-":
            return unit, text[end:]
    raise UnknownUnitError(text[: ends[0]].strip())


def _parse_number(number: str) -> float:
    return {"pi": math.pi, "+pi": math.pi, "-pi": -math.pi}.get(number) or float(number)
