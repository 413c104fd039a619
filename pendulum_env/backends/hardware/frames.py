"""Serial protocol between this computer and a microcontroller.

docs/hardware.md defines the frames and the firmware. A frame on the wire is `COBS(payload + crc) 0x00`, without zeros
inside (Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999). A receiver that has lost bytes is
synchronised again at the next zero.
"""

import binascii
import struct
from collections.abc import Iterator
from typing import NamedTuple

SETUP, POWER, TORQUE, READ, STATE = 0x01, 0x02, 0x03, 0x04, 0x81
LAYOUTS = {
    SETUP: struct.Struct("<BBH"),
    POWER: struct.Struct("<BBB"),
    TORQUE: struct.Struct("<BBi"),
    READ: struct.Struct("<BB"),
    STATE: struct.Struct("<BBBBIii"),
}
POWERED, EXPIRED = 0x01, 0x02  # flags
FAULTS = {  # text by bit
    0x01: "over-current",
    0x02: "over-temperature",
    0x04: "encoder signal lost",
    0x08: "supply voltage out of range",
    0x10: "the servo drive's own fault output",
}
MICRO = 1e-6  # [N m] and [s]


class BoardState(NamedTuple):
    """Answer of the microcontroller."""

    sequence: int
    flags: int
    faults: int
    microseconds: int
    counts: int
    torque: int  # [uN m]


def pack(kind: int, *values: int) -> bytes:
    """Pack a frame of a kind for the wire."""
    payload = LAYOUTS[kind].pack(kind, *values)
    return encode(payload + struct.pack("<H", compute_crc(payload))) + b"\0"


def unpack(frame: bytes) -> tuple[int, ...] | None:
    """Return kind and values of a frame without its final zero, or None if it is damaged."""
    data = decode(frame)
    if data is None or len(data) < 3:
        return None
    payload, (check,) = data[:-2], struct.unpack("<H", data[-2:])
    layout = LAYOUTS.get(payload[0])
    if layout is None or layout.size != len(payload) or compute_crc(payload) != check:
        return None
    values: tuple[int, ...] = layout.unpack(payload)
    return values


def compute_crc(data: bytes) -> int:
    """Compute CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode(data: bytes) -> bytes:
    """Encode up to 253 bytes by COBS: each run between zeros follows its length plus one."""
    return b"".join(bytes([len(run) + 1]) + run for run in data.split(b"\0"))


def decode(frame: bytes) -> bytes | None:
    """Decode a COBS frame of at most 254 bytes; return None for other bytes."""
    runs, place = [], 0
    while place < len(frame):
        code = frame[place]
        run = frame[place + 1 : place + code]
        if code == 0 or len(run) != code - 1 or 0 in run:
            return None
        runs.append(run)
        place += code
    return b"\0".join(runs)


class Splitter:
    """Splitter of received bytes into frames, with a count of damaged frames."""

    max_length = 64  # bytes of a frame; longer runs without a zero are discarded

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.n_damaged = 0

    def feed(self, data: bytes) -> Iterator[tuple[int, ...]]:
        """Yield kind and values of each frame that the bytes complete."""
        self._buffer += data
        *frames, remainder = self._buffer.split(b"\0")
        self._buffer = bytearray(remainder[-self.max_length :])
        for frame in frames:
            if not frame:
                continue
            values = unpack(bytes(frame))
            if values is None:
                self.n_damaged += 1
            else:
                yield values
