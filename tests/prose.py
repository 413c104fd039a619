"""Prose with code in it: blocks of a Markdown page, and whether what a program prints is what the page says."""

import contextlib
import io
import math
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from workbench.cli import main

FENCE = re.compile(
    r"(?:<!-- not run: (?P<why>[^>]+) -->\n+)?^```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^```$", re.M | re.S
)
NUMBER = re.compile(r"[-+−]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?", re.I)
STAYS = ("app", "emulate")  # commands that run until somebody stops them
SHARE = 0.002  # of a number, or one unit of its last place: computers differ in rounding


@dataclass(frozen=True)
class Block:
    """A fenced block of a page; `why` it is not run, if so."""

    language: str
    text: str
    line: int
    why: str | None


def blocks(page: str, heading: str | None = None) -> list[Block]:
    """Fenced blocks of a page, or of the part under one of its second headings."""
    start, end = 0, len(page)
    if heading is not None:
        start = page.index(f"\n## {heading}\n")
        end = page.find("\n## ", start + 1) % (len(page) + 1)
    return [
        Block(found["language"], found["text"], page.count("\n", 0, found.start("text")), found["why"])
        for found in FENCE.finditer(page, start, end)
    ]


def first_untold(expected: str, printed: str) -> str | None:
    """First line of `expected` that was not printed after the line before; numbers may differ by rounding.

    Lines may be left out, blanks and where lines break do not matter.
    """
    printed, place = " ".join(printed.split()), 0
    for line in expected.splitlines():
        wanted = " ".join(line.split())
        if wanted in ("", "..."):
            continue
        after = next((found.end() for found in _candidates(wanted, printed, place) if _close(wanted, found[0])), None)
        if after is None:
            return line
        place = after
    return None


def _candidates(wanted: str, printed: str, place: int) -> Iterator[re.Match[str]]:
    """Places where the line stands but for its numbers."""
    words = [re.escape(part) for part in NUMBER.split(wanted)]
    pattern = re.compile(NUMBER.pattern.join(words), re.I)
    while found := pattern.search(printed, place):
        yield found
        place = found.start() + 1


def _close(wanted: str, printed: str) -> bool:
    pairs = zip(NUMBER.findall(wanted), NUMBER.findall(printed), strict=True)
    return all(_same(a, b) for a, b in pairs)


def _same(a: str, b: str) -> bool:
    first, second = (float(text.replace(",", "").replace("−", "-")) for text in (a, b))
    last_place = 10.0 ** -len(a.lower().partition("e")[0].partition(".")[2])
    if "e" in a.lower():
        last_place *= 10.0 ** math.floor(math.log10(abs(first) or 1.0))
    return abs(first - second) <= max(1.01 * last_place if "." in a else 0.0, SHARE * abs(first))


def commands(text: str) -> list[tuple[list[str], str]]:
    """Commands of a console block, each with the output that the page shows."""
    parts = re.split(r"^\$ ", text, flags=re.M)[1:]
    return [(shlex.split(command), output) for command, _, output in (part.partition("\n") for part in parts)]


def run_command(words: list[str]) -> str:
    """What a command of this project prints; it has to succeed."""
    assert words[0] == "pendulum-ident", f"cannot run {words[0]}"
    assert words[1] not in STAYS, f"{words[1]} does not end by itself: put <!-- not run: why --> before the block"
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words[1:])
    assert code == 0, err.getvalue()
    return out.getvalue()


def check(path: Path, found: list[Block]) -> None:
    """Run blocks in order, Python in one namespace; what a page shows of their output must come out."""
    names: dict[str, Any] = {"__name__": "__main__"}
    printed = ""
    for block in found:
        where = f"{path.name}:{block.line}"
        if block.why is not None:
            continue
        if block.language == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile("\n" * block.line + block.text, str(path), "exec"), names)
            printed = out.getvalue()
        elif block.language == "text":
            line = first_untold(block.text, printed)
            assert line is None, f"{where} shows what is not printed: {line}\n\n{printed}"
        elif block.language == "console":
            for words, output in commands(block.text):
                printed = run_command(words)
                line = first_untold(output, printed)
                assert line is None, f"{where}, {' '.join(words)}: shows what is not printed: {line}\n\n{printed}"
