"""What several tests of arms share."""

import pytest

from benchmarks import six_joint
from benchmarks.two_link import TwoLink
from pendulum_env.arms.body import read_body


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    """The plane arm of two links, read from its own file."""
    path = tmp_path_factory.mktemp("robot") / "two.urdf"
    path.write_text(TwoLink().urdf())
    return read_body(path)


@pytest.fixture(scope="session")
def six():
    """The arm of six joints."""
    return six_joint.body()
