"""Recordings of the demo: the command line's own `record`, run by a worker."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Literal

from estimators.progress import Progress
from pendulum_env.recording import Source
from workbench.app.recordings import LoadedRecording
from workbench.app.session import Session
from workbench.cli import parse
from workbench.errors import InputError
from workbench.terminal import Terminal

RUNS: dict[
    str, tuple[Literal["fit", "holdout"], tuple[str, ...]]
] = {  # role and options of `record` by file, of a pendulum that hides something
    "demo.csv": ("fit", ("--seconds=15", "--effect=stribeck", "--seed=1")),
    "demo-holdout.csv": ("holdout", ("--seconds=10", "--effect=stribeck", "--seed=2")),
}


class QuietTerminal(Terminal):
    """A terminal that prints nothing and hands on progress."""

    def __init__(self, tell: Progress) -> None:
        """Take who is told."""
        super().__init__(quiet=True)
        self._tell = tell

    @contextmanager
    def progress(self, title: str, timed: bool = False, lines: bool = False) -> Iterator[Callable[[str, float], None]]:
        """Hand progress on."""
        self._tell(title, 0.0)
        yield lambda what, share: self._tell(title, share)


def record(folder: Path, progress: Progress) -> list[LoadedRecording]:
    """Record the runs of the demo into files of a folder, and read them."""
    loaded = []
    for name, (role, options) in RUNS.items():
        arguments = parse(["record", *options, f"--output={folder / name}"])
        arguments.run(arguments, QuietTerminal(progress))
        loaded.append(LoadedRecording.of(Source(folder / name, role), origin=options))
    return loaded


def start(session: Session) -> None:
    """Record the runs into a session in the background; raises InputError if one is loaded."""
    for one in session.state.loaded:
        if one.id in RUNS:
            raise InputError(f"{one.id}: is loaded already: remove it first")
    session.work("Recording", partial(record, session.place()), lambda loaded: session.keep(*loaded))
