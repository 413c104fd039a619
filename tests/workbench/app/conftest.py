"""What tests of the app share; they are left out where Dash is not installed."""

import pickle
from importlib.util import find_spec

import pytest

from estimators.progress import no_progress

collect_ignore_glob = ["test_*.py"] if find_spec("dash") is None else []


@pytest.fixture(autouse=True)
def jobs_end_at_once(request, monkeypatch):
    """Jobs of sessions, as they travel to another process, are done in this one at once."""
    from workbench.app.session import Session
    from workbench.errors import USER_ERRORS, InputError, format_mistake

    class Done:
        def __init__(self, task):
            self.task = pickle.dumps(task)

        @property
        def result(self):
            try:
                return pickle.loads(pickle.dumps(pickle.loads(self.task)(no_progress)))
            except USER_ERRORS as mistake:
                raise InputError(format_mistake(mistake)) from None

    def run(self, title, task, ended):
        self._fitting = None
        ended(Done(task))

    if "workers" not in request.fixturenames:
        monkeypatch.setattr(Session, "run", run)


@pytest.fixture
def session(tmp_path):
    """A session of its own."""
    from workbench.app.session import Session

    return Session(tmp_path / "session")
