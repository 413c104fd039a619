"""A CiA 402 servo drive behind an slcan adapter on a pseudo-terminal, emulated."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from pendulum_env.backends.emulators.motor import Motor
from pendulum_env.backends.emulators.wire import Wire
from pendulum_env.backends.hardware import cia402
from pendulum_env.backends.hardware.encoder import difference

NODE = 1
RATED = 15.0  # [N m]
REQUEST, RESPONSE = 0x600 + NODE, 0x580 + NODE  # service data objects
NO_OBJECT = 0x06020000  # abort code
OVER_TEMPERATURE, HOST_LOST = 0x4310, 0x8130
POWER_OF = {"switch-on disabled": 0x40, "ready to switch on": 0x21, "switched on": 0x23, cia402.ENABLED: 0x27}


class CanEmulator:
    """Object dictionary, state machine and process data of a drive."""

    def __init__(self, motor: Motor) -> None:
        """Take the motor."""
        self.motor, self._wire, self._line = motor, Wire(), bytearray()
        self._objects: dict[tuple[int, int], bytes] = {cia402.ERROR_CODE: bytes(2)}
        for (parameters, mapping), _ in cia402.PDOS.values():
            self._objects |= {(parameters, k): bytes(4) for k in (1, 2)} | {(mapping, k): bytes(4) for k in range(9)}
        for where in (cia402.CONSUMER_HEARTBEAT, cia402.ON_LOST_HOST, cia402.ON_FAULT, cia402.MODE):
            self._objects[where] = bytes(4)
        self._objects[cia402.RATED_TORQUE] = struct.pack("<I", round(1e3 * RATED))
        self._status, self._control, self._error, self._kept = 0x40, 0, 0, False
        self._operational = False

    @property
    def place(self) -> str:
        """Path of the other end."""
        return self._wire.path

    def settings(self) -> dict[str, Any]:
        """Keys of its table in rig.toml."""
        return {"interface": "slcan", "channel": self.place, "timestamp": True}

    def sources(self) -> dict[int, Callable[[], None]]:
        """The pseudo-terminal."""
        return {self._wire.descriptor: self._come} if self._wire.descriptor >= 0 else {}

    def _come(self) -> None:
        self._line += self._wire.read()
        *lines, rest = self._line.split(b"\r")
        self._line = bytearray(rest[-64:])
        for line in lines:
            try:
                if line[:1] == b"t" and len(line) == 5 + 2 * (length := int(line[4:5])):
                    self._take(int(line[1:4], 16), bytes.fromhex(line[5 : 5 + 2 * length].decode("ascii")))
            except ValueError:
                pass  # damaged

    def _send(self, id: int, data: bytes) -> None:
        self._wire.write(f"t{id:03X}{len(data)}{data.hex().upper()}\r".encode())

    def _take(self, id: int, data: bytes) -> None:
        motor = self.motor
        motor.advance()
        if motor.expired and not self._error:
            self._fail(HOST_LOST)
        if id == cia402.NMT and len(data) == 2 and data[1] in (0, NODE):
            self._operational = data[0] == cia402.START
        elif id == REQUEST and len(data) == 8:
            self._serve(data)
        elif not self._operational:
            return
        elif id == cia402.RPDO1 + NODE and len(data) == cia402.COMMAND.size:
            control, torque = cia402.COMMAND.unpack(data)
            self._obey(control)
            if self._status == POWER_OF[cia402.ENABLED]:
                motor.command(1e-3 * RATED * torque)
        elif id >> 7 == cia402.HEARTBEAT >> 7 and data:
            beat = int.from_bytes(self._objects[cia402.CONSUMER_HEARTBEAT], "little")
            if id - cia402.HEARTBEAT == beat >> 16:
                motor.watchdog = 1e-3 * (beat & 0xFFFF)
                motor.feed()
        elif id == cia402.SYNC:
            counts = difference(motor.counts(), 0)
            torque = round(motor.torque / (1e-3 * RATED))
            self._send(cia402.TPDO1 + NODE, cia402.STATE.pack(self._status, counts, torque))
            if self._identifier(cia402.TPDO2) == cia402.NO_REMOTE | (cia402.TPDO2 + NODE):
                self._send(cia402.TPDO2 + NODE, cia402.STAMP.pack(int(1e6 * motor.moment) % 2**32))

    def _identifier(self, base: int) -> int:
        return int.from_bytes(self._objects[cia402.PDOS[base][0][0], 1], "little")

    def _obey(self, control: int) -> None:
        """State machine, one transition for each controlword that asks for it."""
        reset = control & cia402.FAULT_RESET and not self._control & cia402.FAULT_RESET
        self._control = control
        if self._error:
            if reset and not self._kept:
                self._error, self._status = 0, 0x40
                self.motor.expired = False
            return
        name, onwards = cia402.state(self._status)
        if not control & 0x02:  # disable voltage
            self._status = 0x40
            self.motor.switch(False)
        elif control & 0x0F == onwards and name != cia402.ENABLED:
            order = list(POWER_OF.values())
            self._status = order[order.index(self._status) + 1]
            if self._status == POWER_OF[cia402.ENABLED]:
                self.motor.switch(True)

    def _fail(self, code: int) -> None:
        self._error, self._status = code, 0x08
        self.motor.switch(False)
        self.motor.expired = False

    def _serve(self, data: bytes) -> None:
        """Expedited upload and download of an object."""
        kind, index, subindex = struct.unpack("<BHB", data[:4])
        where = struct.pack("<HB", index, subindex)
        self._objects[cia402.ERROR_CODE] = struct.pack("<H", self._error)
        self._objects[cia402.MODE_SHOWN] = self._objects[cia402.MODE]
        value = self._objects.get((index, subindex))
        if value is None:
            answer = b"\x80" + where + struct.pack("<I", NO_OBJECT)
        elif kind == 0x40:
            answer = bytes([0x43 | (4 - len(value)) << 2]) + where + value.ljust(4, b"\0")
        else:
            size = 4 - (kind >> 2 & 3)
            self._objects[index, subindex] = data[4 : 4 + size]
            answer = b"\x60" + where + bytes(4)
        self._send(RESPONSE, answer)

    def fault(self) -> None:
        """Over-temperature, until the process ends."""
        self._kept = True
        self._fail(OVER_TEMPERATURE)

    def unplug(self) -> None:
        """No cable."""
        self._wire.pull()

    def corrupt(self, probability: float) -> None:
        """A cable beside a strong motor."""
        self._wire.corrupt(probability)

    def close(self) -> None:
        """Let go."""
        self._wire.pull()


def make(motor: Motor) -> CanEmulator:
    """Emulator around a motor."""
    return CanEmulator(motor)
