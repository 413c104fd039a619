"""Recordings from a simulated pendulum: the command line's own `record`, run by a worker."""

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from dash.development.base_component import Component

from agents.observer import CONSTRAINTS
from estimators.progress import Progress
from pendulum_env.excitation import EXCITATIONS
from pendulum_env.files import write_whole
from pendulum_env.formatting import capitalise
from pendulum_env.physics.library import MEASURED
from pendulum_env.recording import Source
from workbench.app.parts import KEPT, label_control, list_choices, make_dropdown, make_number_field
from workbench.app.recordings import LoadedRecording
from workbench.app.session import Session
from workbench.app.state import State
from workbench.cli import parse
from workbench.errors import InputError
from workbench.narrator.diagnosis import write_diagnosis
from workbench.terminal import Terminal

DIAGNOSIS = "diagnosis.json"
LONGEST = 120.0  # [s]
LEARNT = {f"rl-{policy}": policy for policy in CONSTRAINTS}  # the only policies that a page can name
DEMO, DEMO_HOLDOUT = "demo.csv", "demo-holdout.csv"
Options = tuple[str, ...]  # of `record`


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


def record(
    folder: Path, wishes: Mapping[str, Options], held_out: Collection[str], progress: Progress
) -> list[LoadedRecording]:
    """Run `pendulum-ident record` for each file that is wished for, and read what it wrote."""
    loaded = []
    for name, options in wishes.items():
        arguments = parse(["record", *options, f"--output={folder / name}"])
        arguments.run(arguments, QuietTerminal(progress))
        origin = tuple(word.replace(f"{folder}/", "") for word in options)
        loaded.append(
            LoadedRecording.of(Source(folder / name, "holdout" if name in held_out else "fit"), origin=origin)
        )
    return loaded


def start(
    session: Session, wishes: Mapping[str, Options], held_out: Collection[str] = (), folder: Path | None = None
) -> None:
    """Record files of some names into a session in the background; raises InputError if a name is taken."""
    for one in session.state.loaded:
        if one.id in wishes:
            raise InputError(f"{one.id}: is loaded already: remove it first")
    task = partial(record, folder or session.place(), wishes, held_out)
    session.work("Recording", task, lambda loaded: session.keep(*loaded))


def start_demo(session: Session) -> None:
    """Record two runs of a pendulum that hides something, one of them to check on."""
    lengths = {DEMO: 15, DEMO_HOLDOUT: 10}
    wishes = {
        name: (f"--seconds={seconds}", "--effect=stribeck", f"--seed={seed}")
        for seed, (name, seconds) in enumerate(lengths.items(), 1)
    }
    start(session, wishes, held_out=[DEMO_HOLDOUT])


def start_suggested(session: Session) -> None:
    """Record the experiment that the diagnosis suggests, on the simulated pendulum of the first recording.

    Raises InputError if it suggests none, or the recordings are not of a simulated pendulum.
    """
    state = session.state
    plant = find_plant_options(state)
    if state.diagnosis is None or state.diagnosis.suggestion is None or plant is None:
        raise InputError("there is no experiment to record: only a simulated pendulum can be recorded from here")
    folder = session.place()
    write_whole(folder / DIAGNOSIS, json.dumps(write_diagnosis(state.diagnosis)))
    words = ("--excitation=suggested", f"--diagnosis={folder / DIAGNOSIS}", f"--seed={1 + len(state.loaded)}")
    start(session, {choose_name(state): (*plant, *words)}, folder=folder)


def find_plant_options(state: State) -> Options | None:
    """Find the options of `record` that make the plant of the first recording, None if it was not recorded here."""
    if not state.loaded or not state.loaded[0].origin:
        return None
    return tuple(word for word in state.loaded[0].origin if word.startswith("--effect="))


def choose_name(state: State) -> str:
    """Choose a name for the next recording."""
    known = {one.id for one in state.loaded}
    return next(name for k in range(1, 1000) if (name := f"recording-{k}.csv") not in known)


def make_fields() -> list[Component]:
    """Make the form of a run: its torque, and what is hidden in the plant; `options` reads it."""
    torques = {id: capitalise(id) for id in EXCITATIONS}
    torques |= {id: f"Learnt policy, {bound} torque bounded" for id, bound in LEARNT.items()}
    hidden = {id: text for id, text in list_choices(nothing="nothing").items() if id not in MEASURED}
    return [
        label_control("Excitation", make_dropdown("excitation", torques, "paper", searchable=False, **KEPT)),
        label_control("Hidden effect", make_dropdown("effect", hidden, "", **KEPT)),
        label_control("Peak torque [N m]", make_number_field("amplitude", None, min=0, placeholder="usual")),
        label_control("Length [s]", make_number_field("seconds", 20, min=1, max=LONGEST)),
        label_control("Seed", make_number_field("seed", 0, min=0, step=1)),
    ]


def read_options(form: Mapping[str, Any]) -> Options:
    """Read the options of `record` from the controls of a form, one word each."""
    torque, effect, amplitude, seconds = (form.get(field) for field in ("excitation", "effect", "amplitude", "seconds"))
    if seconds is None or not 1 <= seconds <= LONGEST:
        raise InputError(f"a run from here lasts from 1 to {LONGEST:g} s: use the command line for more")
    words = [f"--seconds={seconds:.15g}", f"--excitation={torque}"]
    if torque in LEARNT:
        if amplitude is not None:
            raise InputError("a learnt policy has a bound of its own: leave the peak torque empty")
        words[1:] = ["--excitation=rl", f"--policy={LEARNT[torque]}"]
    words += [] if amplitude is None else [f"--amplitude={amplitude:.15g}"]
    words += [f"--effect={effect}"] if effect else []
    return (*words, f"--seed={form.get('seed') or 0:.15g}")
