"""Run an emulated rig: write its rig.toml and serve its serial port."""

import math
import os
import select
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from pendulum_env.backends.emulators.motor import Motor
from pendulum_env.backends.hardware import process
from pendulum_env.backends.hardware.config import load, mark_checked
from pendulum_env.files import write_whole
from pendulum_env.physics import Model
from pendulum_env.plant import PAPER
from pendulum_env.reading import format_toml

MARK = "# written by an emulator, and overwritten by the next one\n"
TICK = 0.01  # [s], longest sleep, and delay of the log; the watchdog acts on time


class Wire:
    """Emulated serial cable: the device's end of a pseudo-terminal.

    Attributes:
        path: path of the host's end.
        descriptor: file descriptor of the device's end; -1 after `disconnect`.
    """

    chunk = 4096  # bytes per read

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        """Set the function that returns the device's answer to received bytes."""
        try:
            import pty
            import tty
        except ImportError:
            raise OSError("pseudo-terminals are needed, which this system has not: use Linux or macOS") from None
        self._answer = answer
        self.descriptor, self._slave = pty.openpty()
        tty.setraw(self._slave)  # kept open, so that the terminal outlives its hosts
        os.set_blocking(self.descriptor, False)
        self.path = os.ttyname(self._slave)

    def receive(self) -> None:
        """Read received bytes and write the answer."""
        with suppress(BlockingIOError):  # no data, or full buffer
            if answer := self._answer(os.read(self.descriptor, self.chunk)):
                os.write(self.descriptor, answer)

    def disconnect(self) -> None:
        """Disconnect the cable; may be called repeatedly."""
        for end in (self.descriptor, self._slave):
            if end >= 0:
                os.close(end)
        self.descriptor = self._slave = -1


class EmulatedRig(NamedTuple):
    """Motor with its connection."""

    motor: Motor
    wire: Wire
    adapter: str
    keys: Mapping[str, Any]  # keys of the adapter's table in rig.toml


def emulate(
    make_rig: Callable[[Motor], EmulatedRig],
    plant: Model,
    config: Path,
    rate: float,
    settings: Mapping[str, Mapping[str, Any]],
    report: Callable[[str], None],
    *,
    first_count: int = 0,
    realtime: bool = False,
    log: Path | None = None,
) -> None:
    """Run an emulated rig until an interrupt or the input `quit`; other lines turn the pendulum, see `_turn_pendulum`.

    Args:
        make_rig: function that connects the motor, for example `make_serial`.
        plant: model of the pendulum.
        config: path of the rig.toml to write.
        rate: rate of the loop [Hz].
        settings: further keys of the rig.toml, by table.
        report: function of a progress line; the first line comes when the rig is ready.
        first_count: first reading of the counter.
        realtime: whether emulator and loop request real-time priority.
        log: path of the motor's log.

    Raises:
        ModuleNotFoundError: if the extra `hardware` is not installed.
        FileExistsError: if `config` exists and was not written by an emulator.
    """
    if realtime:
        process.request_realtime()
    _refuse_overwrite(config)
    rig = make_rig(Motor(plant, first_count=first_count, log=log))
    try:
        # the pendulum hangs down at the first count only; later, friction may hold it elsewhere
        tables = {rig.adapter: rig.keys, "encoder": {"zero": first_count % 2**32}, "plant": _find_plant_ranges(plant)}
        for name, values in settings.items():
            tables[name] = {**tables.get(name, {}), **values}
        lines = format_toml({"adapter": rig.adapter, "rate": rate, "realtime": realtime})
        lines += [line for name, table in tables.items() for line in ("", f"[{name}]", *format_toml(table))]
        write_whole(config, MARK + "\n".join([*lines, ""]))
        mark_checked(load(config))  # an emulator needs no check of the rig
        report(f"ready: an emulated {rig.adapter} rig at {rig.wire.path}, described by {config}")
        _serve(rig, report)
    finally:
        rig.wire.disconnect()


def _serve(rig: EmulatedRig, report: Callable[[str], None]) -> None:
    keyboard = sys.stdin.fileno() if sys.stdin is not None else -1
    while True:
        listening = keyboard if keyboard >= 0 and _is_in_foreground(keyboard) else -1
        ready, _, _ = select.select([end for end in (rig.wire.descriptor, listening) if end >= 0], [], [], TICK)
        if rig.wire.descriptor in ready:
            rig.wire.receive()
        if keyboard in ready:
            line = os.read(keyboard, 1000).decode(errors="replace")
            if not line:
                keyboard = -1  # no keyboard: go on until interrupted
            for words in filter(None, map(str.split, line.splitlines())):
                if words == ["quit"]:
                    return
                report(_turn_pendulum(rig.motor, words))
        rig.motor.advance()


def _is_in_foreground(terminal: int) -> bool:
    """Return whether the process may read a terminal; reading would stop a background process."""
    return not os.isatty(terminal) or os.tcgetpgrp(terminal) == os.getpgrp()


def _turn_pendulum(motor: Motor, words: list[str]) -> str:
    """Turn and hold the pendulum (`hold ANGLE` [degrees]) or release it (`hold`); return the message."""
    try:
        angle = math.radians(float(words[1])) if len(words) > 1 else None
    except ValueError:
        angle = math.nan
    if words[0] != "hold" or (angle is not None and math.isnan(angle)):
        return f"'{' '.join(words)}' is not understood: write hold ANGLE, hold or quit"
    motor.hold(angle)
    return " ".join(words)


def _find_plant_ranges(plant: Model) -> dict[str, Any]:
    """Return the table [plant] of the plausibility check, which is off for a plant with effects."""
    values = dict(zip((column.name for column in plant.columns), map(float, plant.theta), strict=True))
    return {name: values.get(name, 0.0) for name in PAPER} | {"watch": not plant.effects}


def _refuse_overwrite(path: Path) -> None:
    """Refuse to overwrite a file that was not written by an emulator."""
    if path.exists() and not (path.is_file() and path.read_bytes().startswith(MARK.encode())):
        raise FileExistsError(f"{path}: exists, and no emulator wrote it: name another file, as -o emulated.toml")
