"""Output of commands: results on stdout, progress on stderr, colour and bars only on a terminal."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from textwrap import fill
from typing import IO

from rich import box
from rich.console import Console, JustifyMethod
from rich.measure import Measurement
from rich.padding import Padding
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

PLAIN_WIDTH = 1000  # line width in a pipe [characters], so long that lines are not wrapped
STANDARD_OUTPUT = "<standard output>"  # in the place of a path


def parse_json_output(text: str) -> str:
    """Return the path of a JSON file, or `STANDARD_OUTPUT` for `-` and its device."""
    return STANDARD_OUTPUT if text in ("-", "/dev/stdout") else text


class Terminal:
    """Standard output and standard error of one command."""

    def __init__(self, *, quiet: bool = False, has_output: bool = True) -> None:
        """Open both streams; `quiet` suppresses all output, without `has_output` results go to standard error."""
        for stream in (sys.stdout, sys.stderr):
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="replace")  # an unencodable character must not raise
        self._out = _make_console(stderr=not has_output, quiet=quiet)
        self._err = _make_console(stderr=True, quiet=quiet)

    def print_heading(self, text: str, color: str = "default") -> None:
        """Print a blank line and a heading; a pipe has no colour."""
        self._out.print()
        self._out.print(text, style=f"bold {color}")

    def print(self, text: str, style: str | None = None) -> None:
        """Print a paragraph without interpreting markup; on a terminal, its further lines are indented."""
        if self._out.is_terminal and "\n" not in text:
            text = fill(text, self._out.width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
        self._out.print(text, style=style)

    def print_table(self, headers: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[str] = ()) -> None:
        """Print a table; the first column and those in `left` are left-aligned, the others right-aligned.

        If it is wider than the terminal, each row is printed as a block, so that no number is broken.
        """
        flush_left = {0, *(headers.index(header) for header in left)}
        words = headers.index(left[-1]) if left else None  # column with text that may wrap
        table = Table(box=box.SIMPLE_HEAD if self._out.is_terminal else None, pad_edge=False, header_style="bold")
        for place, header in enumerate(headers):
            justify: JustifyMethod = "left" if place in flush_left else "right"
            table.add_column(header, justify=justify, no_wrap=place != words, overflow="fold")
        for row in rows:
            table.add_row(*row)
        prose = max((len(row[words]) for row in rows), default=0) if words is not None else 0
        wide = self._out.options.update_width(PLAIN_WIDTH)
        # the column with wrapped text keeps at least 24 characters
        if Measurement.get(self._out, wide, table).maximum - max(0, prose - 24) <= self._out.width:
            self._out.print(table)
        else:
            self._print_stacked(headers, rows)

    def _print_stacked(self, headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print each row as a block: its first cell, then a line of header and cell for each other column."""
        widest = max(len(header) for header in headers[1:])
        for row in rows:
            self._out.print(row[0], style="bold")
            for header, cell in zip(headers[1:], row[1:], strict=True):
                if cell:
                    self._out.print(Padding(f"{header:{widest}}  {cell}", (0, 0, 0, 2)))

    @contextmanager
    def progress(self, title: str, lines: bool = False, pause: float = 0.0) -> Iterator[Callable[[str, float], None]]:
        """Show a progress bar on stderr; yield a function of the current step and the completed share.

        With `lines`, a stderr that is not a terminal gets a line for each tenth, at least `pause` seconds apart.
        """
        if lines and not self._err.is_terminal:
            printed, last = 0, time.monotonic()

            def print_tenth(step: str, share: float) -> None:
                nonlocal printed, last
                if (tenths := int(10 * share + 1e-9)) > printed and time.monotonic() >= last + pause:
                    printed, last = tenths, time.monotonic()
                    self._err.print(f"{title} {10 * tenths} %: {step}")

            yield print_tenth
            return
        columns = (
            TextColumn("{task.fields[title]}"),
            BarColumn(),
            TimeRemainingColumn(compact=True),
            TextColumn("{task.description}", style="dim"),
        )
        with Progress(*columns, console=self._err, transient=True, disable=not self._err.is_terminal) as bars:
            task = bars.add_task("", title=title, total=1.0)
            yield lambda step, share: bars.update(task, description=step, completed=share)


class _PatientConsole(Console):
    """Console that ignores a closed pipe, so that the command still writes its files."""

    def on_broken_pipe(self) -> None:
        """Stop printing."""
        self.quiet = True
        abandon(self.file)


def abandon(stream: IO[str]) -> None:
    """Redirect a broken stream to os.devnull, so that the flush at exit does not fail."""
    with suppress(OSError, ValueError, AttributeError):  # no descriptor in tests; closed streams may be None
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _make_console(*, stderr: bool, quiet: bool) -> Console:
    console = _PatientConsole(stderr=stderr, quiet=quiet, markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = PLAIN_WIDTH
    return console
