"""A CiA 402 servo drive behind an slcan adapter on a pseudo-terminal, emulated."""

import struct
from collections.abc import Iterator
from typing import Any

from pendulum_env.backends.emulators.motor import Motor
from pendulum_env.backends.emulators.wire import Wire
from pendulum_env.backends.hardware import cia402
from pendulum_env.backends.hardware.measuring import difference

POWER_OF = {  # statuswords
    "switch-on disabled": 0x40,
    "ready to switch on": 0x21,
    "switched on": 0x23,
    cia402.ENABLED: 0x27,
}


class ServoDrive:
    """Object dictionary, state machine and process data of a drive."""

    node = 1
    rated = 15.0  # [N m]
    no_object = 0x06020000  # abort code
    over_temperature, host_lost = 0x4310, 0x8130  # error codes
    fault = 0x08  # statusword

    def __init__(self, motor: Motor) -> None:
        self.motor, self._line = motor, bytearray()
        settings = (cia402.CONSUMER_HEARTBEAT, cia402.ON_LOST_HOST, cia402.ON_FAULT, cia402.MODE)
        self._objects: dict[tuple[int, int], bytes] = dict.fromkeys(settings, bytes(4))
        for (parameters, mapping), _ in cia402.PDOS.values():
            self._objects |= dict.fromkeys([(parameters, 1), (parameters, 2)], bytes(4))
            self._objects |= dict.fromkeys([(mapping, k) for k in range(9)], bytes(4))
        self._objects[cia402.RATED_TORQUE] = struct.pack("<I", round(1e3 * self.rated))
        self._status, self._control, self._error = 0x40, 0, 0
        self._operational = False

    def answer(self, data: bytes) -> bytes:
        """What the adapter sends when these bytes have come: messages of the bus as lines, `tIIILDD...`."""
        self._line += data
        *lines, rest = self._line.split(b"\r")
        self._line = bytearray(rest[-64:])
        sent = [message for line in lines for message in self._heard(bytes(line))]
        return b"".join(f"t{id:03X}{len(data)}{data.hex().upper()}\r".encode() for id, data in sent)

    def _heard(self, line: bytes) -> list[tuple[int, bytes]]:
        try:
            if line[:1] == b"t" and len(line) == 5 + 2 * int(line[4:5]):
                return list(self._take(int(line[1:4], 16), bytes.fromhex(line[5:].decode("ascii"))))
        except ValueError:
            pass  # damaged
        return []

    def _take(self, id: int, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Identifiers and data of its answers to a message."""
        motor = self.motor
        motor.advance()
        if motor.faulty or motor.expired:
            self._error, self._status = self.over_temperature if motor.faulty else self.host_lost, self.fault
            motor.switch(False)
            motor.expired = False
        if id == cia402.NMT and len(data) == 2 and data[1] in (0, self.node):
            self._operational = data[0] == cia402.START
        elif id == cia402.REQUEST + self.node and len(data) == cia402.SDO.size:
            yield cia402.ANSWER + self.node, self._serve(*cia402.unpack_sdo(data))
        elif not self._operational:
            return
        elif id == cia402.RPDO1 + self.node and len(data) == cia402.COMMAND.size:
            control, torque = cia402.COMMAND.unpack(data)
            self._obey(control)
            if self._status == POWER_OF[cia402.ENABLED]:
                motor.command(1e-3 * self.rated * torque)
        elif id >> 7 == cia402.HEARTBEAT >> 7 and data:
            beat = int.from_bytes(self._objects[cia402.CONSUMER_HEARTBEAT], "little")
            if id - cia402.HEARTBEAT == beat >> 16:
                motor.watchdog = 1e-3 * (beat & 0xFFFF)
                motor.feed()
        elif id == cia402.SYNC:
            counts = difference(motor.counts(), 0)
            torque = round(motor.torque / (1e-3 * self.rated))
            yield cia402.TPDO1 + self.node, cia402.STATE.pack(self._status, counts, torque)
            (parameters, _), _ = cia402.PDOS[cia402.TPDO2]
            if int.from_bytes(self._objects[parameters, 1], "little") == cia402.NO_REMOTE | (cia402.TPDO2 + self.node):
                yield cia402.TPDO2 + self.node, cia402.STAMP.pack(int(1e6 * motor.moment) % 2**32)

    def _obey(self, control: int) -> None:
        """State machine, one transition for each controlword that asks for it."""
        reset = control & cia402.FAULT_RESET and not self._control & cia402.FAULT_RESET
        self._control = control
        if self._error:
            if reset and not self.motor.faulty:
                self._error, self._status = 0, 0x40
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

    def _serve(self, command: int, where: tuple[int, int], value: bytes) -> bytes:
        """Answer to a request for an object."""
        known = self._objects | {
            cia402.ERROR_CODE: struct.pack("<H", self._error),
            cia402.MODE_SHOWN: self._objects[cia402.MODE],
        }
        if where not in known:
            return cia402.pack_sdo(cia402.ABORTED, where, struct.pack("<I", self.no_object))
        if command == cia402.UPLOAD:
            return cia402.pack_sdo(cia402.UPLOADED, where, known[where])
        self._objects[where] = value
        return cia402.pack_sdo(cia402.DOWNLOADED, where)


def make(motor: Motor) -> tuple[Wire, dict[str, Any]]:
    """The adapter's cable to a drive around a motor, and keys of its table in rig.toml."""
    wire = Wire(ServoDrive(motor).answer)
    return wire, {"interface": "slcan", "channel": wire.place, "timestamp": True}
