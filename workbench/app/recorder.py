"""Recordings from a simulated pendulum: the command line's own `record`, run by a worker."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from agents.network import NAMES
from estimators.progress import Progress
from pendulum_env.excitation import EXCITATIONS
from pendulum_env.files import write_whole
from pendulum_env.recording import Source
from pendulum_env.words import opening
from workbench.app.session import Session
from workbench.app.state import Loaded, State
from workbench.cli import parse
from workbench.mistakes import InputError
from workbench.terminal import Terminal

DIAGNOSIS = "diagnosis.json"
LONGEST = 120.0  # [s]
LEARNT = {f"rl-{policy}": policy for policy in NAMES}  # the only policies that a page can name


@dataclass(frozen=True)
class Wish:
    """A recording to be made: its file's name, options of `record`, and whether it is held out."""

    name: str
    options: tuple[str, ...]
    held_out: bool = False


FORM = ("excitation", "seconds", "effect", "amplitude")  # controls of a run, in the order of `options`
DEMO = (
    Wish("demo.csv", ("--seconds=15", "--effect=stribeck", "--seed=1")),
    Wish("demo-holdout.csv", ("--seconds=10", "--effect=stribeck", "--seed=2"), held_out=True),
)


class Quiet(Terminal):
    """A terminal that prints nothing and hands on progress."""

    def __init__(self, tell: Progress) -> None:
        """Take who is told."""
        self._tell = tell

    def say(self, text: str, style: str | None = None) -> None:
        """Keep quiet."""

    @contextmanager
    def progress(self, title: str, timed: bool = False) -> Iterator[Callable[[str, float], None]]:
        """Hand progress on."""
        self._tell(title, 0.0)
        yield lambda what, share: self._tell(title, share)


def record(folder: Path, wishes: Sequence[Wish], progress: Progress) -> list[Loaded]:
    """Run `pendulum-ident record` for each wish into a folder, and read what it wrote."""
    loaded = []
    for wish in wishes:
        file = folder / wish.name
        arguments = parse(["record", *wish.options, f"--output={file}"])
        arguments.run(arguments, Quiet(progress))
        origin = tuple(word.replace(f"{folder}/", "") for word in wish.options)
        loaded.append(Loaded.of(Source(file, "holdout" if wish.held_out else "fit"), origin=origin))
    return loaded


def start(session: Session, *wishes: Wish, folder: Path | None = None) -> None:
    """Record into a session in the background.

    Raises:
        InputError: if a name is taken.
    """
    for one in session.state.loaded:
        if one.id in [wish.name for wish in wishes]:
            raise InputError(f"{one.id}: is loaded already: remove it first")
    task = partial(record, folder or session.place(), wishes)
    session.work("Recording", task, lambda loaded: session.keep(*loaded))


def start_suggested(session: Session) -> None:
    """Record the experiment that the diagnosis suggests, on the simulated pendulum of the first recording.

    Raises:
        InputError: if it suggests none, or the recordings are not of a simulated pendulum.
    """
    state = session.state
    plant = simulated(state)
    if state.diagnosis is None or state.diagnosis.suggestion is None or plant is None:
        raise InputError("there is no experiment to record: only a simulated pendulum can be recorded from here")
    folder = session.place()
    write_whole(folder / DIAGNOSIS, json.dumps(state.diagnosis.json()))
    seed = 1 + len(state.loaded)
    words = (*plant, "--excitation=suggested", f"--diagnosis={folder / DIAGNOSIS}", f"--seed={seed}")
    start(session, Wish(free_name(state), words), folder=folder)


def simulated(state: State) -> tuple[str, ...] | None:
    """Options of `record` that make the plant of the first recording, None if it was not recorded here."""
    if not state.loaded or not state.loaded[0].origin:
        return None
    return tuple(word for word in state.loaded[0].origin if word.startswith("--effect="))


def free_name(state: State) -> str:
    """A name for the next recording."""
    known = {one.id for one in state.loaded}
    return next(name for k in range(1, 1000) if (name := f"recording-{k}.csv") not in known)


def torques() -> dict[str, str]:
    """Signals, and policies that ship, which see the motion and what it has taught: names by what `options` takes."""
    signals = {id: opening(id) for id in EXCITATIONS}
    return signals | {id: f"Learnt policy, {bound} torque bounded" for id, bound in LEARNT.items()}


def options(
    torque: str, seconds: float | None, effect: str, amplitude: float | None, seed: float | None
) -> tuple[str, ...]:
    """Options of `record` from the controls of a form; each is one word, so that none can be taken for another."""
    if seconds is None or not 1 <= seconds <= LONGEST:
        raise InputError(f"a run from here lasts from 1 to {LONGEST:g} s: use the command line for more")
    if torque in LEARNT and amplitude is not None:
        raise InputError("a learnt policy has a bound of its own: leave the peak torque empty")
    learnt = ["--excitation=rl", f"--policy={LEARNT[torque]}"] if torque in LEARNT else []
    words = [f"--seconds={seconds:.15g}", *(learnt or [f"--excitation={torque}"])]
    words += [] if amplitude is None else [f"--amplitude={amplitude:.15g}"]
    words += [f"--effect={effect}"] if effect else []
    return (*words, f"--seed={seed or 0:.15g}")
