"""The process of a rig: signals stop the motor first, and a lock that anybody may have tampered with has one owner."""

import os
import signal
import threading

import pytest

from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.hardware.process import DeviceLock, Signals
from tests.patience import PATIENCE

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals, links and pipes of Unix")

WHAT = "serial /dev/ttyACM0"


@pytest.fixture
def heard():
    """Somebody else's handlers, and what they were told."""
    heard = []
    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda number, _: heard.append(number)) for number in numbers}
    yield heard
    for number, handler in before.items():
        signal.signal(number, handler)


def test_signals_wait_for_what_is_being_sent_and_none_is_lost(heard):
    stopped = []
    signals = Signals(stopped.append)
    signals.install()
    with signals:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGHUP)
        assert not stopped and not heard
    assert sorted(stopped) == ["SIGHUP", "SIGTERM"]
    assert sorted(heard) == sorted([signal.SIGTERM, signal.SIGHUP])
    signals.restore()


def test_a_signal_while_another_thread_speaks_to_the_drive_ends_in_the_main_one(heard):
    stopped, threads = [], []
    signal.signal(signal.SIGTERM, lambda *_: threads.append(threading.current_thread()))
    signals = Signals(stopped.append)
    signals.install()
    entered, leave = threading.Event(), threading.Event()

    def speak():
        with signals:
            entered.set()
            leave.wait(PATIENCE)

    worker = threading.Thread(target=speak)
    worker.start()
    entered.wait(PATIENCE)
    os.kill(os.getpid(), signal.SIGTERM)
    assert not stopped
    leave.set()
    worker.join()
    assert stopped and threads == [threading.main_thread()]
    signals.restore()


@pytest.fixture
def lock(tmp_path, monkeypatch):
    """Where the lock of a rig lies."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    owner = DeviceLock(WHAT)
    owner.acquire()
    owner.release()
    (path,) = tmp_path.iterdir()
    return path


def test_a_rig_has_one_owner_until_that_lets_go(lock):
    first, second = DeviceLock(WHAT), DeviceLock(WHAT)
    first.acquire()
    first.acquire()
    with pytest.raises(DriveError, match=rf"{WHAT} is in use by another program: close its environment, .*{lock}"):
        second.acquire()
    DeviceLock("serial /dev/ttyACM1").acquire()  # another rig
    first.release()
    first.release()
    second.acquire()
    second.release()


@pytest.mark.parametrize("put", [os.symlink, lambda _, lock: lock.mkdir()])
def test_what_is_no_file_in_the_place_of_the_lock_is_refused(lock, put):
    lock.unlink()
    put(lock.with_name("elsewhere"), lock)
    with pytest.raises(DriveError, match=rf"cannot be locked: {lock}: .* remove it"):
        DeviceLock(WHAT).acquire()
    assert not lock.with_name("elsewhere").exists()
