"""Recordings of the demo: a pendulum with a hidden effect, as `pendulum-ident record` makes them."""

from pathlib import Path

from pendulum_env.recording import Source
from workbench.app.session import Session
from workbench.app.state import LoadedRecording
from workbench.app.uploads import guess_role

FOLDER = Path(__file__).with_name("recordings")
RECORDINGS = {"demo.csv.gz": (15, 1), "demo-holdout.csv.gz": (10, 2)}  # duration [s] and seed


def start(session: Session) -> None:
    """Load the demo into a session; raises InputError if it is loaded already."""
    loaded = list[LoadedRecording]()
    for name, (seconds, seed) in RECORDINGS.items():
        options = f"--seconds={seconds}", "--rate=500", "--effect=stribeck", f"--seed={seed}"
        source = Source(FOLDER / name, guess_role(name))
        loaded.append(LoadedRecording.read(source, (*session.state.loaded, *loaded), origin=options))
    session.add_recordings(*loaded)
