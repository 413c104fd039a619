"""Recordings of the demo, made by `pendulum-ident record`."""

from functools import partial
from pathlib import Path

from estimators.progress import Progress
from pendulum_env.recording import Source
from workbench.app.session import Session
from workbench.app.state import LoadedRecording
from workbench.cli import parse
from workbench.errors import InputError
from workbench.terminal import Terminal

FITTED, HELD_OUT = "demo.csv", "demo-holdout.csv"
HIDDEN = "stribeck"


def record_demo(folder: Path, progress: Progress) -> list[LoadedRecording]:
    """Record a pendulum with a hidden effect into a folder: one recording to fit, one held out."""
    fitted = _record_once(Source(folder / FITTED), 15, 1)
    progress("recording", 0.5)
    return [fitted, _record_once(Source(folder / HELD_OUT, "holdout"), 10, 2)]


def _record_once(source: Source, seconds: int, seed: int) -> LoadedRecording:
    options = (f"--seconds={seconds}", f"--effect={HIDDEN}", f"--seed={seed}")
    arguments = parse(["record", *options, "-o", str(source.file)])
    arguments.run(arguments, Terminal(quiet=True))
    return LoadedRecording.read(source, origin=options)


def start(session: Session) -> None:
    """Record the demo into a session in the background; raises InputError if it is loaded already."""
    for item in session.state.loaded:
        if item.id in (FITTED, HELD_OUT):
            raise InputError(f"{item.id}: is loaded already: remove it first")
    session.run_task(
        "Recording", partial(record_demo, session.make_folder()), lambda loaded: session.add_recordings(*loaded)
    )
