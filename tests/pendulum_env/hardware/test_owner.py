"""One owner of a rig, by a lock in a folder in which anybody may have put anything."""

import os
import subprocess
import sys

import pytest

from pendulum_env.backends.hardware.drive import DriveError
from pendulum_env.backends.hardware.process import Ownership

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
    with pytest.raises(DriveError, match=rf"{WHAT} is in use by another program: close its environment, .*{lock}"):
        second.acquire()
    Ownership("serial /dev/ttyACM1").acquire()  # another rig
    first.release()
    first.release()
    second.acquire()
    second.release()


def test_the_lock_of_a_killed_process_is_free(lock):
    code = "import os, sys; from pendulum_env.backends.hardware.process import Ownership\n"
    code += "Ownership(sys.argv[1]).acquire(); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code, WHAT], env={**os.environ, "TMPDIR": str(lock.parent)})
    Ownership(WHAT).acquire()


@pytest.mark.parametrize("put", [os.symlink, lambda _, lock: lock.mkdir()])
def test_what_is_no_file_in_the_place_of_the_lock_is_refused(lock, put):
    lock.unlink()
    put(lock.with_name("elsewhere"), lock)
    with pytest.raises(DriveError, match=rf"cannot be locked: {lock}: .* remove it"):
        Ownership(WHAT).acquire()
    assert not lock.with_name("elsewhere").exists()


@pytest.mark.parametrize("put", [os.link, lambda _, lock: os.mkfifo(lock)])
def test_nothing_is_written_to_what_somebody_put_there_and_it_is_not_waited_for(lock, tmp_path, put):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    lock.unlink()
    put(victim, lock)
    Ownership(WHAT).acquire()
    assert victim.read_text() == "precious"
