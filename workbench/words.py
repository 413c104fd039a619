"""Numbers and lists as people like to read them."""

from __future__ import annotations

import math
from collections.abc import Sequence


def plus_minus(value: float, std: float) -> str:
    """Value and standard error to two digits of the error: `0.08951 ± 0.00012`; without an error, four digits."""
    if not 0 < std < math.inf:
        return f"{value:.4g}"
    digits = min(12, max(0, 1 - math.floor(math.log10(std))))
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def enumerate_words(words: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def bar(share: float, width: int = 12) -> str:
    """Bar of up to `width` blocks; what is not nothing shows at least one."""
    filled = round(width * min(1.0, max(0.0, share)))
    return "█" * max(1 if share > 0 else 0, filled)
