"""What several tests of arms share."""

import pytest

from benchmarks import six_joint
from tests import two_link


@pytest.fixture(scope="session")
def body():
    """The plane arm of two links."""
    return two_link.body()


@pytest.fixture(scope="session")
def six():
    """The arm of six joints."""
    return six_joint.body()
