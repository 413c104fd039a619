"""Recordings and sessions that the tests of the app share."""

import base64
import shlex
from pathlib import Path

import numpy as np
import pytest

from estimators.progress import no_progress
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import Model
from pendulum_env.plant import hide, paper_plant
from pendulum_env.recording import Recording, Source, write_recording
from workbench.cli import main


def record_pendulum(
    name: str, seed: int, seconds: float = 8.0, effect: str = "stribeck", rate: float = 500.0
) -> Recording:
    """A pendulum that hides an effect."""
    rng = np.random.default_rng(seed)
    return record(hide(paper_plant(), effect), excitation("paper", rng, seconds), seconds, rate, rng=rng, name=name)


def write_source(recording: Recording, folder: Path, held_out: bool = False) -> Source:
    """A recording in a file of its name."""
    write_recording(recording, folder / f"{recording.name}.csv")
    return Source(folder / f"{recording.name}.csv", "holdout" if held_out else "fit")


def loaded(recording: Recording, held_out: bool = False):
    """The same as a session has it, its file being nowhere."""
    from workbench.app.state import LoadedRecording

    file = f"{recording.name}.csv"
    return LoadedRecording(file, Source(Path(file), "holdout" if held_out else "fit"), recording)


def encode_url(content: bytes) -> str:
    """A file as the page sends it."""
    return f"data:application/octet-stream;base64,{base64.b64encode(content).decode()}"


def select_button(does: str) -> str:
    """Selector of a button by the action that it does."""
    return f'[id*=\'"do":"{does}"\']'


def select_field(name: str) -> str:
    """Selector of a field by its name."""
    return f'[id=\'{{"field":"{name}"}}\']'


def upload(session, name: str, content: bytes) -> None:
    """Drop a file on the page."""
    session.run_action(lambda: session.load_uploads([(name, encode_url(content))], unwrap=False))


def drop(session, *files: Path) -> None:
    """Drop several files on the page at once."""
    session.run_action(
        lambda: session.load_uploads([(file.name, encode_url(file.read_bytes())) for file in files], unwrap=False)
    )


def reload_session(state, folder: Path):
    """Another session, into which a study, a model and recordings are loaded as another session exports them."""
    from workbench.app.downloads import make_file
    from workbench.app.session import Session

    made = dict(make_file(state, what) for what in ("study", "model"))
    read = [one.source.file for one in state.loaded] + ([] if state.robot is None else [state.robot.file])
    made |= {one.name: one.read_bytes() for one in read}
    session = Session(folder)
    session.run_action(
        lambda: session.load_uploads([(name, encode_url(content)) for name, content in made.items()], unwrap=False)
    )
    return session


def fit_state(state):
    """The state with its base model fitted."""
    return state.with_fit(state.make_fit_task()(no_progress))


def assert_same_export(state) -> None:
    """Whether the commands of the stage Export make the state's model, in the working directory with its files."""
    from workbench.app.downloads import write_commands

    Path("model.json").unlink(missing_ok=True)
    assert [main(shlex.split(line)[1:]) for line in write_commands(state).splitlines()].count(2) == 0
    made = Model.load("model.json")
    assert made.effects == state.model.effects
    assert made.theta == pytest.approx(state.model.theta, rel=1e-6)
