"""`rig.toml`: how the rig is wired, what it may do, and what happens on a fault; checked when it is read.

Each table of the file is a frozen dataclass, each key one of its fields, with its admissible range beside it: what is
unknown, missing, of the wrong type or out of its range is refused with its name.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pendulum_env.files import write_whole
from pendulum_env.interface import MAX_TORQUE
from pendulum_env.lookup import find
from pendulum_env.plant import PAPER
from pendulum_env.reading import LARGE, Unreadable, read_text, read_toml, shown

S = TypeVar("S")
LONGEST = 1000  # characters of a text
CHECKED = ".checked"  # ending of the file beside a configuration that says which wiring has passed the check


class ConfigError(ValueError):
    """A configuration cannot be used; the message names the file, the key, what is wrong and what to do."""


def number(low: float, high: float = math.inf, default: float | None = None) -> Any:
    """A field: a number from low to high."""
    return field(default=MISSING if default is None else default, metadata={"low": low, "high": high})


def whole(low: int, high: int, default: int | None = None) -> Any:
    """A field: a whole number from low to high."""
    return field(default=MISSING if default is None else default, metadata={"low": low, "high": high, "whole": True})


def choice(*known: Any, default: Any = MISSING) -> Any:
    """A field: one of the known values."""
    return field(default=default, metadata={"known": known})


def text(default: Any = MISSING) -> Any:
    """A field: a text."""
    return field(default=default, metadata={"text": True})


@dataclass(frozen=True)
class EncoderSettings:
    """The encoder."""

    counts: int = whole(1, 2**31, 1_024_000)  # per turn, after quadrature
    sign: int = choice(1, -1, default=1)  # of counts for a turn counter-clockwise
    zero: int | None = field(default=None, metadata={"low": -(2**31), "high": 2**32, "whole": True, "also": "start"})
    # count at which the arm hangs down; "start": it does when the rig is opened


@dataclass(frozen=True)
class Limits:
    """What the guard allows."""

    torque: float = number(0.0, MAX_TORQUE, 6.0)  # [N m]
    unchecked_torque: float = number(0.0, 2.0, 2.0)  # [N m], until `hardware check` has passed
    slew: float = number(0.0, default=1000.0)  # [N m/s], how fast the torque may change
    soft_velocity: float = number(0.0, default=25.0)  # [rad/s], from which torque that speeds up fades out
    hard_velocity: float = number(0.0, default=35.0)  # [rad/s], a fault
    gap: float = number(0.0, default=0.05)  # [s], longest between two commands
    behind: float = number(0.0, default=0.2)  # [s] that the loop may be behind its ticks
    overruns: int = whole(0, 2**31, 1000)  # ticks that an episode may miss
    stall_torque: float = number(0.0, default=4.0)  # [N m], more than gravity and dry friction together
    stall_time: float = number(0.0, default=0.5)  # [s] for which the counts may stand still under stall_torque
    reply: float = number(0.001, 5.0, 0.02)  # [s], to wait for the drive's answer
    watchdog: float = number(0.005, 5.0, 0.08)  # [s] after which the drive itself takes the torque away


@dataclass(frozen=True)
class Fault:
    """What happens on a fault that leaves the drive in reach and the encoder credible."""

    action: str = choice("zero", "brake", default="zero")
    gain: float = number(0.0, default=0.5)  # [N m s/rad] of the braking torque
    seconds: float = number(0.0, 2.0, 1.0)  # of braking, at most


@dataclass(frozen=True)
class Rest:
    """How a reset waits for the arm, without power."""

    velocity: float = number(0.0, default=0.02)  # [rad/s], of an arm at rest
    seconds: float = number(0.0, 60.0, 0.3)  # for which it has to rest
    timeout: float = number(0.0, default=20.0)  # [s]


@dataclass(frozen=True)
class SerialSettings:
    """A microcontroller with DAC, counter and watchdog."""

    port: str = text()
    baud: int = whole(9600, 12_000_000, 2_000_000)


@dataclass(frozen=True)
class CanSettings:
    """A CiA 402 servo drive on any bus of python-can."""

    interface: str = text()
    channel: str = text()
    node: int = whole(1, 127, 1)
    rated_torque: float = number(0.001, default=15.0)  # [N m]; the drive counts in thousandths of it
    bitrate: int = whole(10_000, 1_000_000, 1_000_000)
    host: int = whole(1, 127, 127)  # node number of this computer, for its heartbeat
    timestamp: bool = choice(True, False, default=False)  # the drive has object 1013h and maps it


@dataclass(frozen=True)
class DaqSettings:
    """A National Instruments card and the Dynaserv's own analogue drive."""

    torque: str = text()  # analogue output, +-10 V
    encoder: str = text()  # counter
    enable: str = text()  # digital output line to servo-enable, which the card's watchdog lets fall
    fault: str | None = text(None)  # digital input line from the drive's fault output
    fault_active: str = choice("low", "high", default="low")
    newton_metres_per_volt: float = number(0.001, default=1.5)  # 15 N m at 10 V
    volts_offset: float = number(-1.0, 1.0, 0.0)  # [V] at which the motor gives no torque
    decoding: str = choice("X_1", "X_2", "X_4", default="X_4")
    server: str | None = text(None)  # host:port of an NI gRPC device server; without it, the driver here


@dataclass(frozen=True)
class Plant:
    """What is known of the arm: a motion that no arm within these ranges can make is a fault."""

    watch: bool = choice(True, False, default=True)  # whether the motion is watched at all
    inertia: float = number(1e-6, default=PAPER["inertia"])  # [kg m^2]
    gravity: float = number(0.0, default=PAPER["gravity"])  # [N m], torque that holds the arm out level
    viscous: float = number(0.0, default=PAPER["viscous"])  # [N m s/rad]
    coulomb: float = number(0.0, default=PAPER["coulomb"])  # [N m], dry friction
    share: float = number(0.0, 10.0, 0.5)  # by which inertia and gravity may be more or less: up to 1 + share times
    slack: float = number(0.0, default=0.3)  # [N m] of everything that is not listed here
    delay: float = number(0.0, 1.0, 0.01)  # [s] until a torque acts


Link = SerialSettings | CanSettings | DaqSettings
ADAPTERS: Mapping[str, type[Any]] = MappingProxyType(
    {"serial": SerialSettings, "canopen402": CanSettings, "nidaq": DaqSettings}
)
TABLES: Mapping[str, type[Any]] = MappingProxyType(
    {"encoder": EncoderSettings, "limits": Limits, "fault": Fault, "rest": Rest, "plant": Plant}
)


@dataclass(frozen=True)
class RigConfig:
    """A rig, as its file describes it.

    Attributes:
        adapter: one of `ADAPTERS`.
        link: settings of that adapter.
        rate: of the loop [Hz].
        torque_sign: of the torque that turns the arm counter-clockwise.
        checked: whether `hardware check` has passed with this wiring.
        path: of the file.
        realtime: whether the loop asks for real-time priority.
        log: file for what happens to the rig, or None.
    """

    adapter: str
    link: Link
    rate: float
    torque_sign: int
    encoder: EncoderSettings
    limits: Limits
    fault: Fault
    rest: Rest
    plant: Plant
    checked: bool
    realtime: bool
    path: Path
    log: Path | None

    @property
    def max_torque(self) -> float:
        """Largest torque that the guard lets pass [N m]."""
        return self.limits.torque if self.checked else min(self.limits.torque, self.limits.unchecked_torque)

    @property
    def device(self) -> str:
        """What is owned by one process at a time."""
        link = self.link
        if isinstance(link, SerialSettings):
            return f"serial {os.path.realpath(link.port)}"
        if isinstance(link, CanSettings):
            channel = os.path.realpath(link.channel) if os.path.exists(link.channel) else link.channel
            return f"{link.interface} {channel} node {link.node}"
        return f"nidaq {link.server or 'local'} {link.torque}"


@dataclass(frozen=True)
class _Top:
    adapter: str = choice(*ADAPTERS)
    rate: float = number(10.0, 20_000.0, 1000.0)
    torque_sign: int = choice(1, -1, default=1)
    realtime: bool = choice(True, False, default=False)
    log: str | None = text(None)


def load(path: str | Path) -> RigConfig:
    """Read and check a configuration.

    Raises:
        ConfigError: if it cannot be read or does not make sense.
    """
    path = Path(path)
    try:
        data = read_toml(path)
    except Unreadable as error:
        raise ConfigError(f"{error} (docs/hardware.md has a whole one)") from None
    try:
        return _rig(path, data)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def mark_checked(config: RigConfig) -> Path:
    """Note beside the configuration that its wiring has passed the check; changing the wiring voids it.

    Raises:
        OSError: if the note cannot be written.
    """
    note = _note(config.path)
    write_whole(note, _wiring(config) + "\n")
    return note


def _rig(path: Path, data: dict[str, Any]) -> RigConfig:
    tables = {name: value for name, value in data.items() if isinstance(value, dict)}
    top = _read(_Top, "", {name: value for name, value in data.items() if name not in tables})
    for name in tables:
        find("table", name, {**TABLES, **ADAPTERS})
    if top.adapter not in tables:
        raise ValueError(f"adapter is '{top.adapter}' but there is no table [{top.adapter}]: add it")
    encoder = _read(EncoderSettings, "encoder", tables.get("encoder", {}))
    limits = _read(Limits, "limits", tables.get("limits", {}))
    link: Link = _read(ADAPTERS[top.adapter], top.adapter, tables[top.adapter])
    if not limits.soft_velocity <= limits.hard_velocity:
        raise ValueError("limits.soft_velocity is above limits.hard_velocity: torque has to fade out before the fault")
    if limits.gap * top.rate < 2:
        raise ValueError(f"limits.gap is below two periods of {1 / top.rate:g} s: make it longer, or rate higher")
    if limits.gap > limits.watchdog:
        raise ValueError("limits.gap is above limits.watchdog: the drive would let go before the guard says why")
    rest = _read(Rest, "rest", tables.get("rest", {}))
    if rest.timeout <= rest.seconds:
        raise ValueError("rest.timeout is not above rest.seconds: no arm would ever be at rest in time")
    log = None if top.log is None else path.parent / top.log
    config = RigConfig(
        top.adapter,
        link,
        top.rate,
        top.torque_sign,
        encoder,
        limits,
        _read(Fault, "fault", tables.get("fault", {})),
        rest,
        _read(Plant, "plant", tables.get("plant", {})),
        checked=False,
        realtime=top.realtime,
        path=path.resolve(),
        log=log,
    )
    try:
        checked = read_text(_note(config.path)).strip() == _wiring(config)
    except Unreadable:  # there is none
        checked = False
    return replace(config, checked=checked)


def _read(kind: type[S], table: str, given: dict[str, Any]) -> S:
    """Record of a kind from the keys of a table."""
    known = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
    for name in given:
        find(f"key in [{table}]" if table else "key", name, known)
    values = {}
    for name, f in known.items():
        where = f"{table}.{name}" if table else name
        if name in given:
            values[name] = _value(where, f.metadata, given[name])
        elif f.default is MISSING:
            raise ValueError(f"{where} is missing: docs/hardware.md says what it means")
    return kind(**values)


def _value(where: str, asked: Any, value: Any) -> Any:
    """A value that is what is asked for.

    Raises:
        ValueError: if it is not.
    """
    if "known" in asked:
        if any(value == one and type(value) is type(one) for one in asked["known"]):
            return value
        raise ValueError(f"{where} is {shown(value)}: it has to be one of {', '.join(map(str, asked['known']))}")
    if "text" in asked:
        if isinstance(value, str) and 0 < len(value) <= LONGEST:
            return value
        raise ValueError(f"{where} is {shown(value)}: it has to be a text in quotes, of up to {LONGEST} characters")
    if "also" in asked and value == asked["also"]:
        return None
    kinds = (int,) if "whole" in asked else (int, float)
    if isinstance(value, bool) or not isinstance(value, kinds) or not asked["low"] <= value <= asked["high"]:
        what = "a whole number" if "whole" in asked else "a number"
        reach = f" from {asked['low']:g}" + (f" to {asked['high']:g}" if math.isfinite(asked["high"]) else " on")
        also = f', or "{asked["also"]}"' if "also" in asked else ""
        raise ValueError(f"{where} is {shown(value)}: it has to be {what}{reach}{also}")
    if not math.isfinite(value):
        raise ValueError(f"{where} is {value!r}: it has to be finite")
    if not abs(value) <= max(LARGE, asked["low"]) and not math.isfinite(asked["high"]):
        raise ValueError(f"{where} is {shown(value)}: it has to be {LARGE:g} at most")
    return value if "whole" in asked else float(value)


def _note(path: Path) -> Path:
    return path.with_name(path.name + CHECKED)


def _wiring(config: RigConfig) -> str:
    """Digest of all that the check has tried: other limits do not void it, another wiring does."""
    tried = [config.adapter, asdict(config.link), config.torque_sign, asdict(config.encoder)]
    return hashlib.sha256(json.dumps(tried).encode()).hexdigest()
