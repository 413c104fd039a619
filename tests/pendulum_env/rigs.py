"""Emulated rigs, each in a process of its own."""

import functools
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.hardware.guard import Fault
from tests.once import ROOT
from tests.patience import PATIENCE, wait_until
from workbench.commands.hardware import CheckFailed

FIRST = """
import contextlib, os
with contextlib.suppress(OSError, AttributeError):
    os.nice(-15)  # where it is allowed, a machine that is busy with other things does not disturb
"""
EMULATOR = """
import json, sys
from pathlib import Path
from pendulum_env.backends.emulators import emulate
from pendulum_env.plant import make_plant
asked = json.loads(sys.argv[1])
emulate(
    make, make_plant(effects=asked["effects"]), Path(asked["config"]), asked["rate"],
    asked["settings"], lambda text: print(text, flush=True), first_count=asked["first"], log=Path(asked["log"]),
)
"""
MADE = {
    "serial": "from pendulum_env.backends.emulators import make_serial as make",
    "nidaq": "from tests.emulators.nidaq import make_nidaq as make",
}
KINDS = tuple(MADE)
RATES = {"serial": 500.0, "nidaq": 100.0}  # [Hz], that they hold on a machine that is busy
SLOW = (  # what the guard says where the machine was too slow,
    "was held up or is too slow",
    "commands came too late",
)
LATE = (*SLOW, "did not answer within", "does not move under")  # or may have been: a push may be slept through
ATTEMPTS = 40  # at what is disturbed every time: a mistake
PATIENT = {"watchdog": 2.0, "gap": 1.5, "reply": 1.5}  # where something else than the watchdog is tested


class Disturbed(AssertionError):
    """The machine was the first thing to go wrong: a busy one is that now and then, a mistake every time.

    So is a rig that is `LATE` where a test does not expect that.
    """


def until_in_time(test: Callable[..., None]) -> Callable[..., None]:
    """A test that begins anew where the machine disturbed it, and fails if it always did.

    What has to be safe is never tried twice: an assertion that fails, fails.
    """

    @functools.wraps(test)
    def until_tested(*args: object, **kwargs: object) -> None:
        for attempt in range(1, ATTEMPTS + 1):
            try:
                return test(*args, **kwargs)
            except (Disturbed, Fault, DriveError, CheckFailed) as error:
                disturbed = isinstance(error, Disturbed) or any(text in str(error) for text in LATE)
                if attempt == ATTEMPTS or not disturbed:
                    raise
            time.sleep(0.1 * attempt)

    return until_tested


class EmulatedRig:
    """An emulator, its configuration and its log."""

    def __init__(self, folder: Path, kind: str, *, rate=None, effects=(), first=0, limits=None, **tables):
        self.kind, self.folder, self.rate = kind, folder, rate or RATES[kind]
        self.config, self.log = folder / "rig.toml", folder / "motor.log"
        settings = {"limits": {"reply": 0.25, "overruns": 10**9, "behind": 60.0, "gap": 0.07, **(limits or {})}}
        settings |= {"rest": {"seconds": 0.1}, **tables}
        asked = {
            "effects": list(effects), "config": str(self.config), "rate": self.rate,
            "settings": settings, "first": first, "log": str(self.log),
        }  # fmt: skip
        code = FIRST + MADE[kind] + EMULATOR
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, json.dumps(asked)], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        try:
            self.heard(b"ready")
        except BaseException:
            self.close()
            raise

    def heard(self, text: bytes) -> None:
        """Wait until the emulator says something."""
        line = self.process.stdout.readline()
        assert line.startswith(text), line

    def tell(self, line: str) -> None:
        """Type a line in its terminal."""
        self.process.stdin.write(line.encode() + b"\n")
        self.process.stdin.flush()

    def signal(self, number: int) -> None:
        os.kill(self.process.pid, number)

    def events(self) -> list[tuple[float, str, float]]:
        """What the motor did: monotonic time [s], event, value."""
        rows = [line.split() for line in self.log.read_text().splitlines()]
        return [(float(at), event, float(value)) for at, event, value in rows]

    def wait_for(self, event: str, value: float) -> None:
        """Wait until the log has an event."""
        wait_until(
            lambda: any(row[1:] == (event, value) for row in self.events()),
            lambda: f"no {event} {value} in {self.events()[-5:]}",
        )

    def off_after(self) -> float:
        """Time from the last command with torque until the torque was zero for good [s]; the power is off too."""
        events = self.events()
        states = [value for _, event, value in events if event == "torque"]
        assert states and states[-1] == 0, "the torque is on"
        assert [value for _, event, value in events if event == "power"][-1] == 0, "the power is on"
        off = max(at for at, event, value in events if event == "torque" and value == 0)
        return off - max(at for at, event, value in events if event == "command" and value != 0 and at <= off)

    def close(self) -> None:
        try:
            self.signal(signal.SIGCONT)
            self.process.stdin.write(b"quit\n")
            self.process.stdin.close()
        except (OSError, ValueError):
            pass
        try:
            self.process.wait(3)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.process.wait()
        self.process.stdout.close()


class Host:
    """A program that uses a rig, in a process of its own."""

    def __init__(self, code: str, *arguments: object):
        self.process = subprocess.Popen(
            [sys.executable, "-c", FIRST + code, *map(str, arguments)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def heard(self, text: str) -> str:
        """Next line that it says, which has to begin so."""
        line = self.process.stdout.readline()
        assert line.startswith(text), line + (self.process.stderr.read() if not line else "")
        return line.removeprefix(text).strip()

    def says(self, seconds: float = 10.0) -> bool:
        """Whether it says something within a time."""
        return bool(select.select([self.process.stdout], [], [], seconds)[0])

    def finish(self, seconds: float = PATIENCE) -> tuple[int, str, str]:
        """Exit code and what is left of both streams."""
        out, err = self.process.communicate(timeout=seconds)
        return self.process.returncode, out, err

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()
