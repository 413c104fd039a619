"""Code blocks of Markdown pages: run them, and compare the printed with the shown output."""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pendulum_env.backends import BACKENDS
from pendulum_env.physics import library
from workbench.cli import main

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
BY_HAND = {"hardware.md", "app.md"}  # need a rig or a browser
PAGES = sorted(path for path in (ROOT / "docs").rglob("*.md") if path.name not in BY_HAND)

FENCE = re.compile(
    r"(?:<!-- not run: (?P<why>[^>]+) -->\n+)?^```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^```$", re.M | re.S
)
NUMBER = re.compile(r"[-+−]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?", re.I)
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
ENDLESS = ("app", "emulate")  # commands without an end
MEASURED = re.compile(rf"(?P<value>{NUMBER.pattern})(?:\s*(?:±|\+-)\s*(?P<error>{NUMBER.pattern}))?", re.I)
TOLERANCE = 0.01  # relative tolerance of a number; at least one unit of its last place
STD_TOLERANCE = 0.1  # relative tolerance of a standard error, from about fifty batches


@dataclass(frozen=True)
class Block:
    """Fenced block of a page; `why`: reason for not running it, or None."""

    language: str
    text: str
    start: int  # characters of the page before it
    line: int
    why: str | None


@dataclass(frozen=True)
class Output:
    """Shown and printed text of one output."""

    where: str
    start: int  # characters of the page before it
    shown: str
    printed: str


def blocks(page: str) -> list[Block]:
    """Return the fenced blocks of a page."""
    return [
        Block(found["language"], found["text"], start, page.count("\n", 0, start), found["why"])
        for found in FENCE.finditer(page)
        for start in [found.start("text")]
    ]


def read_runnable_blocks(path: Path) -> list[Block]:
    """Return the blocks of a page that can be run."""
    return blocks(path.read_text(encoding="utf-8"))


def find_missing_line(expected: str, printed: str) -> str | None:
    """Return the first line of `expected` that is missing in `printed`, in order; None if all are there.

    Numbers may differ by rounding. Omitted lines, blanks and line breaks are ignored.
    """
    place = 0
    for line in expected.splitlines():
        if is_left_out(line):
            continue
        found = next((found for found in candidates(line, printed, place) if _close(line, found[0])), None)
        if found is None:
            return line
        place = found.end()
    return None


def is_left_out(line: str) -> bool:
    """Return whether a shown line is empty or marks an omission."""
    return line.strip() in ("", "...")


def candidates(line: str, printed: str, place: int = 0) -> Iterator[re.Match[str]]:
    """Yield the matches of the line in the printed text from `place` on, with any numbers and blanks."""
    words = [re.escape(part).replace(r"\ ", r"\s+") for part in NUMBER.split(" ".join(line.split()))]
    pattern = re.compile(NUMBER.pattern.join(words), re.I)
    while found := pattern.search(printed, place):
        yield found
        place = found.start() + 1


def _close(wanted: str, printed: str) -> bool:
    """Return whether numbers agree within their standard errors, or to rounding if they have none."""
    pairs = zip(MEASURED.finditer(wanted), MEASURED.finditer(printed), strict=True)
    return all(_same(a, b) for a, b in pairs)


def _same(wanted: re.Match[str], printed: re.Match[str]) -> bool:
    value, other = _number(wanted["value"]), _number(printed["value"])
    if wanted["error"] is None:
        return abs(value - other) <= max(_last_place(wanted["value"]), TOLERANCE * abs(value))
    error, its_other = _number(wanted["error"]), _number(printed["error"])
    sure = abs(error - its_other) <= max(_last_place(wanted["error"]), STD_TOLERANCE * error)
    return sure and abs(value - other) <= max(_last_place(wanted["value"]), error)


def _number(text: str) -> float:
    return float(text.replace(",", "").replace("−", "-"))


def _last_place(text: str) -> float:
    """Return 1.01 units of the last decimal; 0 for a number without decimals."""
    mantissa, _, exponent = text.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 1.01 * 10.0 ** (int(exponent or 0) - decimals) if decimals else 0.0


def commands(text: str) -> list[tuple[list[str], int, str]]:
    """Return the commands of a console block, each with the offset and text of its shown output."""
    found = re.finditer(r"^\$ (?P<command>.*)\n(?P<output>(?:(?!\$ ).*\n)*)", text, re.M)
    return [(shlex.split(one["command"]), one.start("output"), one["output"]) for one in found]


def run_command(words: list[str]) -> str:
    """Run a command of this project or an example; return its output, or raise if it fails."""
    if words[0] == "python" and words[1].startswith("examples/"):
        return subprocess.check_output([sys.executable, str(ROOT / words[1]), *words[2:]], env=ENVIRONMENT, text=True)
    assert words[0] == "pendulum-ident", f"cannot run {words[0]}"
    assert words[1] not in ENDLESS, f"{words[1]} does not end by itself: put <!-- not run: why --> before the block"
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words[1:])
    assert code == 0, err.getvalue()
    return out.getvalue()


@contextlib.contextmanager
def isolated_folder(folder: Path) -> Iterator[None]:
    """Run in a folder, and restore the registries of effects and backends afterwards."""
    registries: list[dict[str, Any]] = [library._registered, BACKENDS]
    before = [dict(registry) for registry in registries]
    try:
        with contextlib.chdir(folder):
            yield
    finally:
        for registry, content in zip(registries, before, strict=True):
            registry.clear()
            registry.update(content)


def outputs(path: Path, found: list[Block]) -> Iterator[Output]:
    """Run the blocks in order, Python in one namespace; yield each shown output with the printed text."""
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
            yield Output(where, block.start, block.text, printed)
        elif block.language == "console":
            for words, start, shown in commands(block.text):
                printed = run_command(words)
                yield Output(f"{where}, {' '.join(words)}", block.start + start, shown, printed)


def check(path: Path) -> None:
    """Run a page, and assert that its shown outputs are printed."""
    for output in outputs(path, read_runnable_blocks(path)):
        line = find_missing_line(output.shown, output.printed)
        message = f"{output.where}: shows what is not printed, run `make pages`: {line}"
        assert line is None, f"{message}\n\n{output.printed}"
