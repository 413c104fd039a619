"""Signals: the motor first, then what they are for."""

import os
import signal
import threading

import pytest

from pendulum_env.backends.hardware.process import Signals
from tests.patience import PATIENCE

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of Unix")


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
