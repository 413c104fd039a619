"""Numbers, names and lists as a reader wants them, on the command line, in the report and in notebooks alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class TextTable(NamedTuple):
    """Rows of words under headers; the first column and those named in `left` are flush left, the others right."""

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: Sequence[str] = ()


def capitalise(text: str) -> str:
    """Text with its first letter in upper case, the rest as it is."""
    return text[:1].upper() + text[1:]


def join_words(items: Sequence[str], last: str = "and") -> str:
    """Items as in a sentence: `a`, `a and b`, `a, b and c`."""
    return f" {last} ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else items)


def format_estimate(value: float, std: float) -> str:
    """Value and standard error to two digits of the error: `0.08951 ± 0.00012`; without an error, four digits."""
    if not 1e-9 * abs(value) < std < math.inf:  # else rounding of a value that is known
        return f"{value:.4g}"
    digits = min(12, max(0, 1 - math.floor(math.log10(std))))
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def draw_bar(share: float, width: int = 12) -> str:
    """Bar of up to `width` blocks; what is not nothing shows at least one."""
    filled = round(width * min(1.0, max(0.0, share)))
    return "█" * max(1 if share > 0 else 0, filled)


def format_number(value: float, digits: int = 3, padded: bool = False) -> str:
    """Value to some significant digits, trailing zeros shown if `padded`, without a computer's exponents."""
    if not np.isfinite(value):
        return "–"
    plain = f"{value:#.{digits}g}".rstrip(".") if padded else f"{value:.{digits}g}"
    mantissa, _, exponent = plain.partition("e")
    if exponent and 0 < int(exponent) < 6:
        plain, exponent = f"{float(plain):.0f}", ""
    power = f" × 10{str(int(exponent)).translate(SUPERSCRIPTS)}" if exponent else ""
    return (mantissa if exponent else plain).replace("-", "−") + power


def format_unit(text: str) -> str:
    """Unit as printed; empty for a pure number."""
    return "" if text == "1" else text.replace("^2", "²").replace(" ", "\N{NO-BREAK SPACE}")


def typeset(text: str) -> str:
    """Text of an estimate with minus signs in place of hyphens."""
    return text.replace("-", "−")


def split_estimate(text: str) -> tuple[str, str]:
    """Value and standard error of an estimate, for two lines of a table; the error is empty where there is none."""
    value, _, error = typeset(text).partition(" ± ")
    return value, error and f"± {error}"


def format_percent(share: float) -> str:
    """Share in per cent."""
    return f"{100 * share:.3g} %" if share >= 0.001 or share == 0 else "< 0.1 %"


def format_quantity(value: float, digits: int, unit: str = "") -> str:
    """Write a number with its unit, or `unknown` for NaN."""
    return "unknown" if math.isnan(value) else f"{value:.{digits}g}{f' {unit}' if unit else ''}"
