"""Recordings from a simulated pendulum: the command line's own `record`, run by a worker."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from estimators.progress import Progress
from pendulum_env.files import write_whole
from pendulum_env.recording import Recording, read_recording
from workbench.app.jobs import Job, Workers
from workbench.app.session import Session
from workbench.app.state import Loaded, State
from workbench.app.torques import LEARNT
from workbench.cli import parse
from workbench.mistakes import InputError
from workbench.terminal import Terminal

DIAGNOSIS = "diagnosis.json"
LONGEST = 120.0  # [s]
DEMO = (  # what is hidden in the demo, and what each of its recordings is for
    ("demo.csv", ("--seconds=15", "--effect=stribeck", "--seed=1"), False),
    ("demo-holdout.csv", ("--seconds=10", "--effect=stribeck", "--seed=2"), True),
)


class Quiet(Terminal):
    """A terminal that prints nothing and hands on progress."""

    def __init__(self, tell: Progress) -> None:
        """Take who is told."""
        self._tell = tell

    def say(self, text: str, style: str | None = None) -> None:
        """Keep quiet."""

    @contextmanager
    def progress(self, title: str) -> Iterator[Callable[[str, float], None]]:
        """Hand progress on."""
        self._tell(title, 0.0)
        yield lambda what, share: self._tell(title, share)


def record(runs: Sequence[tuple[Path, Sequence[str]]], progress: Progress) -> list[Recording]:
    """Run `pendulum-ident record` for each file with its options, and read what it wrote."""
    recordings = []
    for file, options in runs:
        arguments = parse(["record", *options, f"--output={file}"])
        arguments.run(arguments, Quiet(progress))
        recordings.append(read_recording(file))
    return recordings


def start(session: Session, workers: Workers, runs: Sequence[tuple[str, tuple[str, ...], bool]]) -> None:
    """Record into a session in the background: name, options and whether it is held out, of each recording.

    Raises:
        InputError: if a name is taken.
    """
    files = [session.place(name) for name, _, _ in runs]
    task = partial(record, [(file, options) for file, (_, options, _) in zip(files, runs, strict=True)])

    def done(job: Job, recordings: list[Recording]) -> None:
        loaded = [
            Loaded(file, recording, held_out, options)
            for file, recording, (_, options, held_out) in zip(files, recordings, runs, strict=True)
        ]
        session.finish(job, lambda: session.keep(*loaded))

    def failed(job: Job, why: str) -> None:
        for file in files:
            file.unlink(missing_ok=True)
        session.fail(job, why)

    session.start(Job("Recording", task, workers, done, failed))


def start_suggested(session: Session, workers: Workers) -> None:
    """Record the experiment that the diagnosis suggests, on the simulated pendulum of the first recording.

    Raises:
        InputError: if it suggests none, or the recordings are not of a simulated pendulum.
    """
    state = session.state
    plant = simulated(state)
    if state.diagnosis is None or state.diagnosis.suggestion is None or plant is None:
        raise InputError("there is no experiment to record: only a simulated pendulum can be recorded from here")
    diagnosis = session.folder / DIAGNOSIS
    write_whole(diagnosis, json.dumps(state.diagnosis.json()))
    seed = 1 + len(state.loaded)
    words = (*plant, "--excitation=suggested", f"--diagnosis={diagnosis}", f"--seed={seed}")
    start(session, workers, [(free_name(session), words, False)])


def simulated(state: State) -> tuple[str, ...] | None:
    """Options of `record` that make the plant of the first recording, None if it was not recorded here."""
    if not state.loaded or not state.loaded[0].origin:
        return None
    return tuple(word for word in state.loaded[0].origin if word.startswith("--effect="))


def free_name(session: Session) -> str:
    """A name for the next recording."""
    return next(name for k in range(1, 1000) if not (session.folder / (name := f"recording-{k}.csv")).exists())


def options(
    excitation: str, seconds: float | None, effect: str, amplitude: float | None, seed: float | None
) -> tuple[str, ...]:
    """Options of `record` from the controls of a form; each is one word, so that none can be taken for another."""
    if seconds is None or not 1 <= seconds <= LONGEST:
        raise InputError(f"a recording from here lasts from 1 to {LONGEST:g} s: use the command line for more")
    words = [f"--seconds={seconds:.15g}"]
    words += (
        ["--excitation=rl", f"--policy={LEARNT[excitation]}"]
        if excitation in LEARNT
        else [f"--excitation={excitation}"]
    )
    if amplitude is not None:
        words.append(f"--amplitude={amplitude:.15g}")
    if effect:
        words.append(f"--effect={effect}")
    return (*words, f"--seed={seed or 0:.15g}")
