"""The serial protocol between this computer and a microcontroller: enough to write its firmware from.

A frame on the wire is `COBS(payload + crc) 0x00`. COBS (Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2),
1999) takes every zero byte out of a frame, so that a zero ends it and a receiver that starts anywhere, or has lost
bytes, is back in step with the next one. The CRC is CRC-16/CCITT-FALSE of the payload (polynomial 0x1021, start 0xFFFF,
nothing reflected, 0x29B1 for "123456789"), low byte first. Frames of another length, with a wrong CRC or an unknown
first byte are dropped without an answer. Numbers are little-endian.

From the computer:

    SETUP   u8 0x01, u8 sequence, u16 watchdog [ms]                                  answered by STATE
    POWER   u8 0x02, u8 sequence, u8 on                                              answered by STATE
    TORQUE  u8 0x03, u8 sequence, i32 torque [uN m]                                  not answered
    READ    u8 0x04, u8 sequence                                                     answered by STATE

From the microcontroller:

    STATE   u8 0x81, u8 sequence of what it answers, u8 flags, u8 faults, u32 time [us], i32 counts, i32 torque [uN m]

flags: bit 0 powered, bit 1 the watchdog has taken the power away. faults: bits, see `FAULTS`; kept until POWER is 1
again. time: of a free-running counter, latched together with the counts; it rolls over. counts: of the encoder after
quadrature, two's complement, rolling over. torque: as it is set.

What the firmware has to do: SETUP sets the watchdog, takes the power away and the torque to zero. POWER 1 clears the
faults that can be cleared, sets the torque to zero, and, unless a fault remains or no SETUP has come since the start,
gives power and starts the watchdog; POWER 0 sets the torque to zero and takes the power away. TORQUE sets the DAC if
there is power and the torque is within what motor and drive stand, and restarts the watchdog; nothing else restarts it.
When the watchdog runs out, or a fault occurs, torque and power go, and come back with POWER 1 only.
"""

from __future__ import annotations

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
FAULTS = {  # by bit
    0x01: "over-current",
    0x02: "over-temperature",
    0x04: "encoder signal lost",
    0x08: "supply voltage out of range",
    0x10: "the servo drive's own fault output",
}
MICRO = 1e-6  # [N m] and [s]
LONGEST = 64  # bytes; what is longer without a zero is noise


class State(NamedTuple):
    """What the microcontroller answers."""

    sequence: int
    flags: int
    faults: int
    microseconds: int
    counts: int
    torque: int  # [uN m]


def pack(kind: int, *values: int) -> bytes:
    """Frame of a kind, ready for the wire."""
    payload = LAYOUTS[kind].pack(kind, *values)
    return encode(payload + struct.pack("<H", crc(payload))) + b"\0"


def unpack(frame: bytes) -> tuple[int, ...] | None:
    """Kind and values of a frame without its final zero; None if it is damaged."""
    data = decode(frame)
    if data is None or len(data) < 3:
        return None
    payload, (check,) = data[:-2], struct.unpack("<H", data[-2:])
    layout = LAYOUTS.get(payload[0])
    if layout is None or layout.size != len(payload) or crc(payload) != check:
        return None
    values: tuple[int, ...] = layout.unpack(payload)
    return values


def crc(data: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode(data: bytes) -> bytes:
    """COBS: the same without zeros, one byte longer for each 254."""
    out = bytearray()
    for block in data.split(b"\0"):
        while len(block) >= 254:
            out += b"\xff" + block[:254]
            block = block[254:]
        out += bytes([len(block) + 1]) + block
    return bytes(out)


def decode(frame: bytes) -> bytes | None:
    """What was encoded; None if this is no COBS frame."""
    out, at = bytearray(), 0
    while at < len(frame):
        code = frame[at]
        block = frame[at + 1 : at + code]
        if code == 0 or len(block) != code - 1 or 0 in block:
            return None
        out += block
        at += code
        if code < 255 and at < len(frame):
            out.append(0)
    return bytes(out)


class Splitter:
    """Cuts what arrives into frames; counts those that are damaged."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.damaged = 0

    def feed(self, data: bytes) -> Iterator[tuple[int, ...]]:
        """Kind and values of each whole frame that these bytes complete."""
        self._buffer += data
        *frames, rest = self._buffer.split(b"\0")
        self._buffer = bytearray(rest[-LONGEST:])
        for frame in frames:
            if not frame:
                continue
            values = unpack(bytes(frame))
            if values is None:
                self.damaged += 1
            else:
                yield values
