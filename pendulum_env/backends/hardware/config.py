"""Read and check `rig.toml`: wiring, limits and fault reaction of a rig.

Each table of the file is a frozen dataclass, and each key a field with its admissible range. Keys that are unknown,
missing, of the wrong type or out of range are refused by name.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from msgspec import Meta

from pendulum_env.backends.hardware import Settings, find_adapter, list_adapters
from pendulum_env.errors import FileError, UserError
from pendulum_env.files import write_whole
from pendulum_env.plant import PAPER
from pendulum_env.reading import MAX_NUMBER, NonNegative, Text, convert, read_text, read_toml
from pendulum_env.spaces import MAX_TORQUE

CHECKED = ".checked"  # suffix of the note on the wiring that has passed the check


class ConfigError(UserError):
    """Invalid configuration; the message has file, key, fault and remedy."""


@dataclass(frozen=True)
class EncoderSettings:
    """Settings of the encoder."""

    counts: Annotated[int, Meta(ge=1, le=2**31)] = 1_024_000  # per turn, after quadrature
    sign: Literal[1, -1] = 1  # sign of the counts of a counter-clockwise turn
    zero: Annotated[int, Meta(ge=-(2**31), le=2**32)] | None = None
    # count of the hanging pendulum; "start": the count when the rig is opened


@dataclass(frozen=True)
class GuardLimits:
    """Limits of the guard."""

    torque: Annotated[float, Meta(ge=0.0, le=MAX_TORQUE)] = 6.0  # [N m]
    unchecked_torque: Annotated[float, Meta(ge=0.0, le=2.0)] = 2.0  # [N m], until `hardware check` has passed
    slew: NonNegative = 1000.0  # [N m/s], largest rate of change of the torque
    soft_velocity: NonNegative = 25.0  # [rad/s], speed from which accelerating torque fades out
    hard_velocity: NonNegative = 35.0  # [rad/s], speed of a fault
    gap: NonNegative = 0.05  # [s], longest time between two commands
    behind: NonNegative = 0.2  # [s], largest delay of the loop behind its ticks
    overruns: Annotated[int, Meta(ge=0, le=2**31)] = 1000  # most missed ticks of an episode
    stall_torque: NonNegative = 4.0  # [N m], above the sum of gravity and dry friction
    stall_time: NonNegative = 0.5  # [s], longest standstill of the counts under stall_torque
    reply: Annotated[float, Meta(ge=0.001, le=5.0)] = 0.02  # [s], timeout of the device's answer
    watchdog: Annotated[float, Meta(ge=0.005, le=5.0)] = 0.08  # [s], timeout of the device's watchdog


@dataclass(frozen=True)
class FaultReaction:
    """Reaction to a fault while amplifier and encoder still work."""

    action: Literal["zero", "brake"] = "zero"
    gain: NonNegative = 0.5  # [N m s/rad], gain of the braking torque
    seconds: Annotated[float, Meta(ge=0.0, le=2.0)] = 1.0  # [s], longest braking


@dataclass(frozen=True)
class Rest:
    """Settings of the wait for rest at a reset, without power."""

    velocity: NonNegative = 0.02  # [rad/s], largest speed of a pendulum at rest
    seconds: Annotated[float, Meta(ge=0.0, le=60.0)] = 0.3  # [s], duration of rest
    timeout: NonNegative = 20.0  # [s], longest wait


@dataclass(frozen=True)
class SerialSettings:
    """Microcontroller with DAC, counter and watchdog."""

    port: Text
    baud: Annotated[int, Meta(ge=9600, le=12_000_000)] = 2_000_000

    @property
    def device(self) -> str:
        """Return the name of the device for its lock."""
        return f"serial {os.path.realpath(self.port)}"


@dataclass(frozen=True)
class DaqSettings:
    """National Instruments card with the amplifier of the Dynaserv."""

    torque: Text  # analogue output, +-10 V
    encoder: Text  # counter
    enable: Text  # digital output line to the enable input, cleared by the card's watchdog
    fault: Text | None = None  # digital input line from the amplifier's fault output
    fault_active: Literal["low", "high"] = "low"
    newton_metres_per_volt: Annotated[float, Meta(ge=0.001, le=MAX_NUMBER)] = 1.5  # 15 N m at 10 V
    volts_offset: Annotated[float, Meta(ge=-1.0, le=1.0)] = 0.0  # [V], voltage of zero torque
    decoding: Literal["X_1", "X_2", "X_4"] = "X_4"
    server: Text | None = None  # host:port of an NI gRPC device server; None: the local driver

    @property
    def device(self) -> str:
        """Return the name of the device for its lock."""
        return f"nidaq {self.server or 'local'} {self.torque}"


@dataclass(frozen=True)
class PlantRanges:
    """Ranges of the pendulum's parameters; motion that is impossible within them is a fault."""

    watch: bool = True  # whether the motion is checked
    inertia: Annotated[float, Meta(ge=1e-6, le=MAX_NUMBER)] = PAPER["inertia"]  # [kg m^2]
    gravity: NonNegative = PAPER["gravity"]  # [N m], torque that holds the pendulum horizontal
    viscous: NonNegative = PAPER["viscous"]  # [N m s/rad]
    coulomb: NonNegative = PAPER["coulomb"]  # [N m], dry friction
    share: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.5  # inertia and gravity may differ by a factor of 1 + share
    slack: NonNegative = 0.3  # [N m], bound of all other torques
    delay: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01  # [s], longest delay of the torque


@dataclass(frozen=True, kw_only=True)
class RigFile:
    """Keys and tables of the file, without the tables of adapters."""

    adapter: Text
    rate: Annotated[float, Meta(ge=10.0, le=20_000.0)] = 1000.0  # rate of the loop [Hz]
    torque_sign: Literal[1, -1] = 1  # sign of the torque of a counter-clockwise turn
    realtime: bool = False  # whether the loop requests real-time priority
    log: Text | None = None  # file of the rig's log, relative to the configuration
    encoder: EncoderSettings = EncoderSettings()
    limits: GuardLimits = GuardLimits()
    fault: FaultReaction = FaultReaction()
    rest: Rest = Rest()
    plant: PlantRanges = PlantRanges()


@dataclass(frozen=True, kw_only=True)
class RigConfig(RigFile):
    """Configuration of a rig."""

    link: Settings  # settings of the adapter
    path: Path  # path of the file
    checked: bool = False  # whether this wiring has passed `hardware check`

    @property
    def max_torque(self) -> float:
        """Return the torque limit of the guard [N m]."""
        return self.limits.torque if self.checked else min(self.limits.torque, self.limits.unchecked_torque)

    @property
    def wiring(self) -> str:
        """Return a digest of the settings that `hardware check` tests: the wiring, without limits."""
        link = asdict(cast(Any, self.link))  # `find_adapter` refuses other types
        checked_settings = [self.adapter, link, self.torque_sign, asdict(self.encoder)]
        return hashlib.sha256(json.dumps(checked_settings, default=str).encode()).hexdigest()

    @property
    def note_path(self) -> Path:
        """Return the path of the note on the wiring that has passed the check."""
        return self.path.with_name(self.path.name + CHECKED)


def load(path: str | Path) -> RigConfig:
    """Read and check a configuration; raises ConfigError if the file cannot be read or a setting is invalid."""
    path = Path(path)
    try:
        data = read_toml(path)
    except FileError as error:
        raise ConfigError(f"{error} (docs/hardware.md has a whole one)") from None
    try:
        config = _build_config(path, data)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    try:
        return replace(config, checked=read_text(config.note_path).strip() == config.wiring)
    except FileError:  # no note
        return config


def mark_checked(config: RigConfig) -> Path:
    """Write the note that this wiring has passed the check, which holds until the wiring changes.

    Raises:
        OSError: if the note cannot be written.
    """
    write_whole(config.note_path, config.wiring + "\n")
    return config.note_path


def _build_config(path: Path, data: dict[str, Any]) -> RigConfig:
    if isinstance(encoder := data.get("encoder"), dict) and encoder.get("zero") == "start":
        del encoder["zero"]
    adapter_tables = {*list_adapters(), str(data.get("adapter"))}
    file = convert({name: value for name, value in data.items() if name not in adapter_tables}, RigFile)
    settings = find_adapter(file.adapter).settings
    if file.adapter not in data:
        raise ValueError(f"adapter is '{file.adapter}' but there is no table [{file.adapter}]: add it")
    link = convert(data[file.adapter], settings, file.adapter)
    config = RigConfig(**vars(file), link=link, path=path.resolve())
    limits, rest = config.limits, config.rest
    if limits.soft_velocity > limits.hard_velocity:
        raise ValueError("limits.soft_velocity is above limits.hard_velocity: torque has to fade out before the fault")
    if limits.gap * config.rate < 2:
        raise ValueError(f"limits.gap is below two periods of {1 / config.rate:g} s: make it longer, or rate higher")
    if limits.gap > limits.watchdog:
        raise ValueError("limits.gap is above limits.watchdog: the drive would let go before the guard says why")
    if rest.timeout <= rest.seconds:
        raise ValueError("rest.timeout is not above rest.seconds: no pendulum would ever be at rest in time")
    return config
