"""What can go wrong does, each in a process of its own; whether the torque was gone in time is read in the motor's log.

The motor's watchdog is set to 80 ms: 100 ms after the last good command there must be no torque, whatever happens.
"""

import os
import re
import signal
import time

import numpy as np
import pytest

from tests import slow
from tests.pendulum_env.rigs import KINDS, SLOW, Disturbed

pytestmark = [pytest.mark.realtime, pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals of Unix")]

IN_TIME = 0.1  # [s]
HOST = """
import sys, time
import gymnasium as gym, numpy as np
from pendulum_env.wrappers import RecordMeasurements
config, path, trouble = sys.argv[1:]
env = gym.make("pendulum_env/DirectDrivePendulum-v0", backend="dm1015b", config=config, max_episode_steps=-1)
env = RecordMeasurements(env, path, overwrite=True)
_, info = env.reset()
rate, said = env.unwrapped.rate, False
while True:
    if info["time"] > 0.8 and not said:
        print("running", flush=True)
        said = True
    torque = 0.5 + 3.0 * np.sin(8.0 * info["time"])
    if said and trouble:
        raise ArithmeticError(trouble)
    *_, terminated, _, info = env.step(np.array([torque], dtype=np.float32))
    if terminated:
        print("fault", info["fault"], flush=True)
        break
env.step(np.array([3.0], dtype=np.float32))  # is of no use
env.close()
"""


class Scene:
    """A rig that runs, about to go wrong."""

    def __init__(self, make_emulated_rig, start_host, tmp_path, kind, trouble="", **options):
        self.rig = make_emulated_rig(kind, **options)
        self.path = tmp_path / f"{self.rig.folder.name}.csv"
        self.host = start_host(HOST, self.rig.config, self.path, trouble)
        line = self.host.process.stdout.readline()
        if line.startswith("fault") and any(slow in line for slow in SLOW):
            raise Disturbed(line)
        if not line.startswith("running"):
            raise Disturbed(line + self.host.process.stderr.read())
        self.rig.wait_for("power", 1.0)

    def fault(self, but: str = "lost|did not answer within") -> str:
        """What the host says is wrong, unless the machine was too slow: of that, only what is looked for counts."""
        text = self.host.heard("fault")
        code, _, err = self.host.finish()
        assert code == 0, err
        if any(slow in text for slow in SLOW) and not re.search(but, text):
            raise Disturbed(text)
        return text

    def ended(self) -> tuple[int, str]:
        """Exit code and errors of a host that ends by itself, unless the machine was too slow for it before."""
        code, out, err = self.host.finish()
        if any(slow in out for slow in SLOW):
            raise Disturbed(out)
        return code, err

    def safe(self) -> None:
        """The torque is off in time; the recording is whole."""
        self.rig.wait_for("power", 0.0)
        assert self.rig.off_after() < IN_TIME
        self.recorded()

    def recorded(self) -> None:
        header, *rows = self.path.read_text().splitlines()
        assert header == "time,position,torque,jitter,overruns"
        table = np.array([[float(cell) for cell in row.split(",")] for row in rows])  # no row is half
        np.testing.assert_allclose(table[:, 0], np.arange(len(table)) / self.rig.rate, atol=1e-9)
        assert len(table) > 0.25 * self.rig.rate  # a killed process loses half a second at most
        assert np.isfinite(table).all() and np.ptp(table[:, 1]) > 0.1


each = pytest.mark.parametrize("kind", slow.but_first(KINDS))
one = pytest.mark.parametrize("kind", KINDS[:1])  # what does not depend on the adapter


@pytest.fixture
def scene(make_emulated_rig, start_host, tmp_path):
    return lambda kind, trouble="", **options: Scene(make_emulated_rig, start_host, tmp_path, kind, trouble, **options)


@each
def test_a_host_that_is_killed(scene, kind):
    s = scene(kind)
    s.host.process.kill()
    s.rig.wait_for("power", 0.0)
    s.safe()
    assert any(event == "expired" for _, event, _ in s.rig.events())  # nobody else could have


@one
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_host_that_is_told_to_end(scene, kind, number):
    if signal.getsignal(number) == signal.SIG_IGN:
        pytest.skip("whoever started these tests has them ignore this signal, as nohup does")

    s = scene(kind)
    os.kill(s.host.process.pid, number)
    code, err = s.ended()
    assert code in (128 + number, -number)
    assert ("KeyboardInterrupt" in err) == (number == signal.SIGINT)
    s.safe()
    assert not any(event == "expired" for _, event, _ in s.rig.events())  # the watchdog was not needed


@one
def test_a_policy_that_fails(scene, kind):
    s = scene(kind, "the policy has a mistake")
    code, err = s.ended()
    assert code == 1 and "the policy has a mistake" in err
    s.safe()


@one
def test_a_host_that_is_frozen(scene, kind):
    s = scene(kind)
    os.kill(s.host.process.pid, signal.SIGSTOP)
    s.rig.wait_for("power", 0.0)
    assert s.rig.off_after() < IN_TIME
    os.kill(s.host.process.pid, signal.SIGCONT)
    text = s.fault(but="")
    assert any(part in text for part in SLOW)
    s.safe()  # it did not go on where it was


@each
def test_a_drive_that_hangs(scene, kind):
    s = scene(kind)
    s.rig.signal(signal.SIGSTOP)
    assert "check" in s.fault()
    s.rig.signal(signal.SIGCONT)
    s.safe()


@one
def test_a_second_owner_is_refused_and_the_first_goes_on(scene, start_host, kind):
    s = scene(kind)
    second = start_host(HOST, s.rig.config, s.path.with_name("second.csv"), "")
    drives = second.heard("")  # says nothing unless it has the rig
    if s.host.says(0.0):  # the first had to give it up
        second.close()
        raise Disturbed(s.fault(but=""))
    assert not drives
    code, _, err = second.finish()
    assert code == 1 and "is in use by another program" in err
    assert not s.host.says(0.3)  # no fault
    before = len(s.rig.events())
    time.sleep(0.2)
    assert len(s.rig.events()) > before
    s.host.process.terminate()
    s.host.finish()
    s.safe()
