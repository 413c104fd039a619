"""Options of the command line in messages of the libraries."""

from collections.abc import Iterator

import pytest

from pendulum_env.settings import use_writer
from workbench.errors import write_option


@pytest.fixture(autouse=True)
def options() -> Iterator[None]:
    """Let messages name options as on the command line, where they are pasted."""
    before = use_writer(write_option)
    yield
    use_writer(before)
