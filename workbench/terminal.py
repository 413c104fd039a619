"""What is printed where: results on stdout, progress on stderr, colour and bars only where a person watches."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

PLAIN_WIDTH = 1000  # characters; a pipe has no width of its own, and lines are better not broken there


class Terminal:
    """Standard output and standard error of one command."""

    def __init__(self) -> None:
        for stream in (sys.stdout, sys.stderr):
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="replace")  # a sign that the terminal lacks must not end a diagnosis
        self._out = _console(stderr=False)
        self._err = _console(stderr=True)

    def heading(self, text: str) -> None:
        """Start a new part."""
        self._out.print()
        self._out.print(text, style="bold")

    def say(self, text: str, style: str | None = None) -> None:
        """Print a paragraph; brackets in it are brackets."""
        self._out.print(text, style=style)

    def table(self, headers: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[str] = ()) -> None:
        """Print rows under headers: the first column and those named in `left` flush left, the others right."""
        table = Table(box=box.SIMPLE_HEAD if self._out.is_terminal else None, pad_edge=False, header_style="bold")
        for place, header in enumerate(headers):
            flush_left = place == 0 or header in left
            table.add_column(header, justify="left" if flush_left else "right", no_wrap=place == 0, overflow="fold")
        for row in rows:
            table.add_row(*row)
        self._out.print(table)

    @contextmanager
    def progress(self, title: str) -> Iterator[Callable[[str, float], None]]:
        """Bar on stderr, gone when the work is done: call what is yielded with what is being done and its share."""
        columns = (TextColumn("{task.fields[title]}"), BarColumn(), TextColumn("{task.description}", style="dim"))
        with Progress(*columns, console=self._err, transient=True, disable=not self._err.is_terminal) as bars:
            task = bars.add_task("", title=title, total=1.0)
            yield lambda what, share: bars.update(task, description=what, completed=share)


def _console(*, stderr: bool) -> Console:
    console = Console(stderr=stderr, markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = PLAIN_WIDTH
    return console
