"""What tests of the app share; they are left out where Dash is not installed."""

from importlib.util import find_spec

import pytest

collect_ignore_glob = ["test_*.py"] if find_spec("dash") is None else []


@pytest.fixture
def session(tmp_path):
    """A session of its own."""
    from workbench.app.session import Session

    return Session(tmp_path / "session")
