"""Format numbers, names and lists for the command line, the report and notebooks."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pendulum_env.quantity import Quantity
from pendulum_env.units import to_shown_unit

PARTS, PARTS_OF_LEFTWARD = ("", *"▏▎▍▌▋▊▉"), ("", "▐")  # of a block
SUPERSCRIPTS = str.maketrans("-0123456789n", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹ⁿ")
POWER = re.compile(r"\^([0-9n])")
OPTION = re.compile(r"`([^`]*--[^`]*)`|(--[a-z]+ (?:'[^']*'|\S+=\S+))")  # a command, or an option with its value
TYPOGRAPHY = tuple(  # pattern in a text of the command line, and its replacement on a page
    (re.compile(pattern), sign)
    for pattern, sign in (
        (r"`", ""),
        (r"->", "→"),
        (r"\+-", "±"),
        (r"(?<!\w)--([a-z]+)", r"option \1"),
        (r"\bq''", "q̈"),
        (r"\bq'", "q̇"),
        (r"\btau\b", "τ"),
        (r"\b(N|kg)[ \xa0]m\b", r"\1·m"),
        (r"(?<=N·m)[ \xa0]s\b", "·s"),
        (r"\bN[ \xa0]s/", "N·s/"),
        (r"(?<![\w.])-(?=[\d.])", "−"),
    )
)


class TextTable(NamedTuple):
    """Rows of text under headers; the first column and the columns in `left` are flush left, the others right."""

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: Sequence[str] = ()

    def __str__(self) -> str:
        lines = (self.headers, *self.rows)
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        signs = ["<" if k == 0 or header in self.left else ">" for k, header in enumerate(self.headers)]
        formats = [f"{sign}{width}" for sign, width in zip(signs, widths, strict=True)]
        return "\n".join("  ".join(map(format, line, formats)).rstrip() for line in lines)


def capitalise(text: str) -> str:
    """Capitalise the first letter of a text."""
    return text[:1].upper() + text[1:]


def join_words(items: Sequence[str], conjunction: str = "and") -> str:
    """Join items to a list in words: `a`, `a and b`, `a, b and c`."""
    return f" {conjunction} ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else items)


def format_p_value(value: float) -> str:
    """Format a p-value, `p = 0.012`; `p < 0.001` for smaller ones."""
    return f"p = {value:.2g}" if value >= 1e-3 else "p < 0.001"


def format_estimate(value: float, std: float) -> str:
    """Format value and standard error to two digits of the error, `0.08951 ± 0.00012`; four digits without one."""
    if not 1e-9 * abs(value) < std < math.inf:  # no error, or rounding error of an exact value
        return f"{value:.4g}"
    digits = min(12, max(0, 1 - math.floor(math.log10(std))))
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def draw_bar(share: float, width: int = 12) -> str:
    """Draw a bar of up to `width` blocks in eighths, at least one; a negative share ends on the left, in halves."""
    parts = PARTS if share >= 0 else PARTS_OF_LEFTWARD
    size = min(len(parts) * width, max(share != 0, round(len(parts) * width * abs(share))))
    blocks, rest = divmod(size, len(parts))
    return blocks * "█" + parts[rest] if share >= 0 else parts[rest] + blocks * "█"


def format_number(value: float, digits: int = 3, padded: bool = False) -> str:
    """Format a value to `digits` significant digits, with powers of ten; `padded` keeps trailing zeros."""
    if not np.isfinite(value):
        return "–"
    plain = f"{value:#.{digits}g}".rstrip(".") if padded else f"{value:.{digits}g}"
    mantissa, _, exponent = plain.partition("e")
    if exponent and 0 < int(exponent) < 6:
        plain, exponent = f"{float(plain):.0f}", ""
    power = f" × 10{str(int(exponent)).translate(SUPERSCRIPTS)}" if exponent else ""
    return (mantissa if exponent else plain).replace("-", "−") + power


def format_unit(text: str) -> str:
    """Format a unit for a page, `kg·m²` for `kg m^2`; empty for a dimensionless quantity."""
    return "" if text == "1" else text.replace("^2", "²").replace("deg C", "°C").replace(" ", "·")


def typeset(text: str) -> str:
    """Set a text of the command line for a page: `q' -> 2 kg m^2` becomes `q̇ → 2 kg·m²`; options lose their dashes.

    A command with options, or an option with its value, stays, so that it can be copied.
    """
    parts = OPTION.split(text)  # text, command or None, option or None, text, ...
    for pattern, sign in TYPOGRAPHY:
        parts[::3] = [pattern.sub(sign, part) for part in parts[::3]]
    parts[::3] = [POWER.sub(lambda power: power[1].translate(SUPERSCRIPTS), part) for part in parts[::3]]
    return "".join(filter(None, parts))


def format_percent(share: float) -> str:
    """Format a share in per cent."""
    return f"{100 * share:.3g} %" if share >= 0.001 or share == 0 else "< 0.1 %"


def format_quantity(value: float, digits: int, unit: str = "") -> str:
    """Format a number with its unit; NaN becomes `unknown`."""
    return "unknown" if math.isnan(value) else f"{value:.{digits}g}{f' {unit}' if unit else ''}"


def measure(quantity: Quantity, digits: int = 3, is_parameter: bool = False) -> str:
    """Format a quantity in its displayed unit, with its standard error if known."""
    factor, unit = to_shown_unit(1.0, quantity.unit, is_parameter)
    value, std = factor * quantity.value, factor * quantity.std
    text = format_estimate(value, std) if std else format_quantity(value, digits)
    return f"{text} {unit}".rstrip()


def measure_change(before: Quantity, after: Quantity, digits: int = 3) -> str:
    """Format two values in one unit: `0.2 -> 0.1 rad`."""
    value, _ = to_shown_unit(before.value, before.unit)
    return f"{format_quantity(value, digits)} -> {measure(after, digits)}"


def measure_range(low: float, high: float, unit: str, digits: int = 3) -> str:
    """Format a range in its displayed unit: `-1.2 to 0.9 rad`."""
    ends = [to_shown_unit(end, unit) for end in (low, high)]
    return f"{ends[0][0]:.{digits}g} to {ends[1][0]:.{digits}g} {ends[0][1]}".rstrip()
