"""What the tests of environments share."""

import contextlib
import itertools
import os

import pytest

from pendulum_env.backends.hardware import find_adapter
from tests.options import options as options
from tests.pendulum_env.rigs import EmulatedRig, Host

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # windows of mode human need no screen


@pytest.fixture
def make_emulated_rig(tmp_path):
    """Make emulated rigs, which end with the test."""
    rigs, count = [], itertools.count()

    def make(kind, **options):
        try:
            find_adapter(kind)
        except ModuleNotFoundError as error:
            pytest.skip(str(error))
        while rigs:  # of an attempt that was not in time
            rigs.pop().close()
        folder = tmp_path / f"rig{next(count)}"
        folder.mkdir()
        rigs.append(EmulatedRig(folder, kind, **options))
        return rigs[-1]

    usual = os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(OSError):  # as for the emulators, see rigs.FIRST
        os.setpriority(os.PRIO_PROCESS, 0, -15)
    yield make
    for rig in rigs:
        rig.close()
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, usual)


@pytest.fixture
def start_host():
    """Start host programs, which end with the test."""
    hosts = []

    def start(code, *arguments):
        hosts.append(Host(code, *arguments))
        return hosts[-1]

    yield start
    for one in hosts:
        one.close()
