"""Recordings of the demo: a simulated pendulum with hidden Stribeck friction."""

from pathlib import Path

from pendulum_env.recording import Source
from workbench.app.session import Session
from workbench.app.uploads import guess_role

FOLDER = Path(__file__).with_name("recordings")


def start(session: Session) -> None:
    """Load the demo into a session; raises InputError if it is loaded already."""
    session.load(Source(file, guess_role(file.name)) for file in sorted(FOLDER.iterdir(), reverse=True))
