"""Emulated rigs by name: each is a process that listens, and writes the rig.toml by which it is reached."""

from __future__ import annotations

import importlib
import math
import os
import select
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pendulum_env.backends.emulators.motor import MISREADINGS, Motor
from pendulum_env.backends.hardware.adapters import need
from pendulum_env.backends.hardware.config import load, mark_checked
from pendulum_env.backends.hardware.pacing import realtime
from pendulum_env.files import write_whole
from pendulum_env.lookup import find
from pendulum_env.physics import Model
from pendulum_env.plant import PAPER
from pendulum_env.reading import Unreadable, read_text

EMULATORS = {  # where each is
    "canopen402": "can_emulator",
    "serial": "serial_emulator",
    "nidaq": "daq_emulator",
}
MARK = "# written by an emulator, and overwritten by the next one\n"
TICK = 0.01  # [s], longest sleep: how soon the log tells of the watchdog, which acts in time anyway
MISHAPS = {
    "fault": "the drive reports over-temperature",
    "unplug": "the cable is pulled",
    "corrupt": "P: each bit on the cable is wrong with a probability P",
    "push": "T: somebody pushes the arm with T N m",
    "hold": "D: a hand turns the arm to D degrees and holds it there; without a number it lets go",
    "freeze": "S: the drive hangs for S seconds",
    "encoder": f"{', '.join(MISREADINGS)}: the encoder tells something else",
    "gain": "G: the drive gives G times the torque that it is asked for",
}


class Link(Protocol):
    """One side of a protocol: what a drive does with what it is sent."""

    @property
    def place(self) -> str:
        """Where it listens."""

    def settings(self) -> dict[str, Any]:
        """Keys of its table in rig.toml, by which it is reached."""

    def sources(self) -> dict[int, Callable[[], None]]:
        """File descriptors to watch, and what to call when something comes."""

    def fault(self) -> None:
        """Report a fault from now on, without power."""

    def unplug(self) -> None:
        """Be out of reach from now on."""

    def corrupt(self, probability: float) -> None:
        """Damage bits on the way with a probability."""

    def close(self) -> None:
        """Let go."""


@dataclass(frozen=True)
class Emulation:
    """What is emulated.

    Attributes:
        kind: one of `EMULATORS`.
        plant: the arm on its motor, with effects.
        config: where to write the rig.toml.
        rate: of the loop in it [Hz].
        settings: keys that differ in it, by table.
        realtime: whether emulator and loop ask for real-time priority.
        first: first reading of the counter.
        log: where to write what the motor did, or None.
    """

    kind: str
    plant: Model
    config: Path
    rate: float
    settings: dict[str, dict[str, Any]]
    first: int = 0
    realtime: bool = False
    log: Path | None = None


def emulate(emulation: Emulation, said: Callable[[str], None]) -> None:
    """Run an emulated rig until interrupted or told to `quit`; lines on standard input are mishaps, see `MISHAPS`.

    Args:
        emulation: what to emulate.
        said: called with lines for whoever watches; the first one when the rig is ready.

    Raises:
        ModuleNotFoundError: if the extra `hardware` is not installed.
        ValueError: if there is no such emulator.
        FileExistsError: if the configuration is somebody else's file.
    """
    find("emulator", emulation.kind, EMULATORS)
    need(emulation.kind)
    module = importlib.import_module(f"pendulum_env.backends.emulators.{EMULATORS[emulation.kind]}")
    if emulation.realtime:
        realtime()
    _own(emulation.config)
    motor = Motor(emulation.plant, first=emulation.first, log=emulation.log)
    link: Link = module.make(motor)
    try:
        write_whole(emulation.config, _rig_toml(emulation, link))
        mark_checked(load(emulation.config))  # nobody gets hurt
        said(f"ready: an emulated {emulation.kind} rig at {link.place}, described by {emulation.config}")
        _serve(link, motor, said)
    finally:
        link.close()


def _serve(link: Link, motor: Motor, said: Callable[[str], None]) -> None:
    told = sys.stdin.fileno() if sys.stdin is not None else -1
    while True:
        sources = link.sources()
        listening = [told] if told >= 0 and _in_front(told) else []
        ready, _, _ = select.select([*sources, *listening], [], [], TICK)
        for source in ready:
            if source in sources:
                sources[source]()
        if told in ready:
            line = os.read(told, 1000).decode(errors="replace")
            if not line:
                told = -1  # nobody is there: go on until interrupted
            for words in filter(None, map(str.split, line.splitlines())):
                if words == ["quit"]:
                    return
                said(_mishap(words, link, motor))
        motor.advance()


def _in_front(terminal: int) -> bool:
    """Whether what is typed there is meant for this process: one in the background is stopped when it reads."""
    return not os.isatty(terminal) or os.tcgetpgrp(terminal) == os.getpgrp()


def _mishap(words: list[str], link: Link, motor: Motor) -> str:
    """Let something go wrong; returns what to say."""
    name, *rest = words
    try:
        find("mishap", name, MISHAPS)
        how = (
            find("encoder", rest[0] if rest else "", {word: word for word in MISREADINGS}) if name == "encoder" else ""
        )
        amount = float(rest[0]) if rest and not how else 0.0
    except ValueError as error:
        return str(error)
    if name == "fault":
        link.fault()
    elif name == "unplug":
        link.unplug()
    elif name == "corrupt":
        link.corrupt(amount)
    elif how:
        motor.misread(how)
    elif name == "gain":
        motor.amplify(amount)
    elif name == "hold":
        motor.hold(math.radians(amount) if rest else None)
    elif name == "push":
        motor.advance()
        motor.push = amount
    else:
        motor.hang(amount)
    return " ".join(words)


def _rig_toml(emulation: Emulation, link: Link) -> str:
    """Text of the configuration."""
    # its arm hangs down at the first count, and later rests wherever friction holds it
    tables: dict[str, dict[str, Any]] = {
        emulation.kind: link.settings(),
        "encoder": {"zero": emulation.first % 2**32},
        "plant": _plant(emulation.plant),
    }
    for name, values in emulation.settings.items():
        tables[name] = {**tables.get(name, {}), **values}
    lines = [f'adapter = "{emulation.kind}"', f"rate = {emulation.rate!r}", f"realtime = {_toml(emulation.realtime)}"]
    for name, values in tables.items():
        lines += ["", f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in values.items())]
    return MARK + "\n".join(lines) + "\n"


def _plant(plant: Model) -> dict[str, Any]:
    """What the watch is told of the arm; one with something hidden in it may move as nobody expects."""
    known = dict(zip((column.name for column in plant.columns), map(float, plant.theta), strict=True))
    return {name: known.get(name, 0.0) for name in PAPER} | {"watch": not plant.effects}


def _own(path: Path) -> None:
    """Refuse to overwrite what describes a real rig."""
    try:
        own = not path.exists() or read_text(path).startswith(MARK)
    except Unreadable:  # no text, or no file at all
        own = False
    if not own:
        raise FileExistsError(f"{path}: exists, and no emulator wrote it: name another file, as -o emulated.toml")


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)
