"""One owner of a rig, by a lock in a folder in which anybody may have put anything."""

import os
import subprocess
import sys

import pytest

from pendulum_env.backends.hardware.drive import DriveError
from pendulum_env.backends.hardware.owner import Ownership

WHAT = "serial /dev/ttyACM0"

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links and pipes of Unix")


@pytest.fixture
def lock(tmp_path, monkeypatch):
    """Where the lock of a rig lies."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    owner = Ownership(WHAT)
    owner.acquire()
    owner.release()
    (path,) = tmp_path.iterdir()
    return path


def test_a_rig_has_one_owner_until_that_lets_go(lock):
    first, second = Ownership(WHAT), Ownership(WHAT)
    first.acquire()
    first.acquire()
    with pytest.raises(DriveError, match=rf"{WHAT} is in use by process {os.getpid()}: close its environment"):
        second.acquire()
    Ownership("serial /dev/ttyACM1").acquire()  # another rig
    first.release()
    first.release()
    second.acquire()
    second.release()


def test_the_lock_of_a_killed_process_is_free(lock):
    code = "import os, sys; from pendulum_env.backends.hardware.owner import Ownership as O; O(sys.argv[1]).acquire();"
    subprocess.run(
        [sys.executable, "-c", code + "os.kill(os.getpid(), 9)", WHAT], env={**os.environ, "TMPDIR": str(lock.parent)}
    )
    Ownership(WHAT).acquire()


@pytest.mark.parametrize("put", [os.symlink, os.link, lambda _, lock: os.mkfifo(lock), lambda _, lock: lock.mkdir()])
def test_what_is_no_plain_file_in_the_place_of_the_lock_is_refused_at_once_and_not_followed(lock, tmp_path, put):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    lock.unlink()
    put(victim, lock)
    with pytest.raises(DriveError, match=rf"cannot be locked: {lock}: .* remove it"):
        Ownership(WHAT).acquire()
    assert victim.read_text() == "precious"


def test_a_link_to_nowhere_makes_no_file(lock, tmp_path):
    lock.unlink()
    lock.symlink_to(tmp_path / "new")
    with pytest.raises(DriveError, match="cannot be locked"):
        Ownership(WHAT).acquire()
    assert not (tmp_path / "new").exists()
