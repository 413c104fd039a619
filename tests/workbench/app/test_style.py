"""Text can be read: WCAG 2.1 contrast of every pair of colours that meet, in light and dark."""

import re
from pathlib import Path

import pytest

from workbench.report.page import read_shared

APP = Path(__file__).parents[3] / "workbench" / "app" / "assets" / "app.css"
BACKGROUNDS = ("--page", "--surface", "--raised")
PAIRS = [
    *((text, back) for text in ("--text", "--muted", "--link", "--base", "--final") for back in BACKGROUNDS),
    ("--good", "--good-back"),
    ("--warn", "--warn-back"),
    ("--muted", "--none-back"),
    ("--on-primary", "--primary"),
]
MARKS = [(mark, "--surface") for mark in ("--scheme-1", "--scheme-2", "--scheme-3", "--measured", "--primary")]


def colors(theme: str) -> dict[str, str]:
    """Colours of a theme, those of the app over those of the report."""
    found: dict[str, str] = {}
    for style in (read_shared("style.css"), APP.read_text(encoding="utf-8")):
        light = re.findall(r":root \{(.*?)\}", style, re.DOTALL)
        dark = re.findall(r':root\[data-theme="dark"\] \{(.*?)\}', style, re.DOTALL)
        for block in [*light, *(dark if theme == "dark" else [])]:
            found |= dict(re.findall(r"(--[\w-]+): (#[0-9a-f]{6});", block))
    return found


def luminance(color: str) -> float:
    parts = [int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize(("pairs", "least"), [(PAIRS, 4.5), (MARKS, 3.0)], ids=["text", "marks"])
def test_colours_that_meet_have_enough_contrast(pairs, least, theme):
    known = colors(theme)
    found = {pair: contrast(known[pair[0]], known[pair[1]]) for pair in pairs}
    assert {pair: ratio for pair, ratio in found.items() if ratio < least} == {}
