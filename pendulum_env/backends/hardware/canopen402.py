"""A servo drive with CANopen, CiA 402, in cyclic synchronous torque mode, on any bus of python-can."""

import logging
import math
import select
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import can

from pendulum_env.backends.hardware import cia402
from pendulum_env.backends.hardware.config import CanSettings, RigConfig
from pendulum_env.backends.hardware.drive import OPENING, STILL_ON, DriveError, Reading, Sent, driver_errors
from pendulum_env.backends.hardware.measuring import DriveClock

SERIAL_LINE: dict[str, Any] = {"sleep_after_open": 0.0}  # of serial adapters

logging.getLogger("can").addHandler(logging.NullHandler())  # what it finds wrong comes as an exception, too


class Canopen402:
    """The drive: torque to it in RPDO1 at once, counts from it in TPDO1 (and its clock in TPDO2) at each SYNC.

    It hears this computer's heartbeat from `write` only, and lets go when that stays away for the watchdog's time.
    """

    switching = 2.0  # [s] that a drive may take to switch on
    stale = 64  # messages, at most, that came too late for what they answered and are passed over

    def __init__(self, config: RigConfig) -> None:
        """Take bus, patience and watchdog."""
        assert isinstance(config.link, CanSettings)
        self._link, self._reply, self._watchdog = config.link, config.limits.reply, config.limits.watchdog
        self._patience = self._reply  # [s] to wait for an answer
        self._bus: can.BusABC | None = None
        self._clock = DriveClock()
        self._beat = 0.0  # time of the last heartbeat
        self.noise = 0.0 if self._link.timestamp else 50e-6  # [s]; of a SYNC on a bus

    def open(self) -> None:
        """Join the bus and lay out the messages."""
        link = self._link
        own = [cia402.TPDO1 + link.node, cia402.TPDO2 + link.node, cia402.ANSWER + link.node]
        remedy = "check canopen402.interface and channel"
        with driver_errors(f"the CAN bus {link.interface} {link.channel} cannot be opened", remedy):
            self._bus = can.Bus(
                interface=link.interface,
                channel=link.channel,
                bitrate=link.bitrate,
                can_filters=[{"can_id": id, "can_mask": 0x7FF, "extended": False} for id in own],
                **(SERIAL_LINE if link.interface == "slcan" else {}),
            )
        self._clock, self._patience = DriveClock(), max(OPENING, self._reply)
        self._lay_out()
        self._patience = self._reply

    def _lay_out(self) -> None:
        link = self._link
        self._post(cia402.NMT, bytes([cia402.PRE_OPERATIONAL, link.node]))
        for base, ((parameters, mapping), entries) in cia402.PDOS.items():
            if base == cia402.TPDO2 and not link.timestamp:
                continue
            sent, when = (0, cia402.AT_ONCE) if base == cia402.RPDO1 else (cia402.NO_REMOTE, cia402.AT_SYNC)
            identifier = base + link.node | sent
            self._put((parameters, 1), "<I", cia402.INVALID | identifier)
            self._put((parameters, 2), "<B", when)
            self._put((mapping, 0), "<B", 0)
            for k, entry in enumerate(entries, start=1):
                self._put((mapping, k), "<I", entry)
            self._put((mapping, 0), "<B", len(entries))
            self._put((parameters, 1), "<I", identifier)
        rated = 1e-3 * int.from_bytes(self._get(cia402.RATED_TORQUE), "little")  # [N m]
        if not math.isclose(rated, link.rated_torque, rel_tol=0.01):
            raise DriveError(
                f"the drive's rated torque is {rated:g} N m (object 6076h), canopen402.rated_torque says "
                f"{link.rated_torque:g}: every torque would be wrong by as much, write the drive's there"
            )
        self._put(cia402.MODE, "<b", cia402.TORQUE_MODE)
        self._put(cia402.ON_LOST_HOST, "<h", 1)
        self._put(cia402.ON_FAULT, "<h", 0)
        self._put(cia402.CONSUMER_HEARTBEAT, "<I", link.host << 16 | round(1e3 * self._watchdog))
        self._post(cia402.NMT, bytes([cia402.START, link.node]))
        self._post(cia402.RPDO1 + link.node, cia402.COMMAND.pack(cia402.DISABLE_VOLTAGE, 0))

    def enable(self) -> None:
        """Go through the states of CiA 402 up to operation."""
        until = time.monotonic() + self.switching
        last = cia402.DISABLE_VOLTAGE
        while True:
            status, _ = self._sync()
            name, control = cia402.state(status)
            mode = struct.unpack("<b", self._get(cia402.MODE_SHOWN)[:1])[0] if name == cia402.ENABLED else None
            if mode == cia402.TORQUE_MODE:
                return
            if time.monotonic() > until:
                why = self._error() if mode is None else f"mode {mode}, object 6061h, not cyclic synchronous torque, 10"
                raise DriveError(f"the drive stays in state '{name}' ({why}): mend that, or switch it on")
            if control == last == cia402.FAULT_RESET:
                control = cia402.DISABLE_VOLTAGE  # the reset acts at the edge
            self._send(control, 0)
            last = control

    def write(self, torque: float) -> Sent:
        """Set the torque [N m], in thousandths of the rated one."""
        unit = 1e-3 * self._link.rated_torque
        steps = min(max(round(torque / unit), -32767), 32767)
        return Sent(self._send(cia402.ENABLE, steps) + self._clock.delay, unit * steps)

    def read(self) -> Reading:
        """Counts now."""
        status, reading = self._sync()
        name, _ = cia402.state(status)
        return reading if name == cia402.ENABLED else reading._replace(fault=f"{name} ({self._error()})")

    def disable(self) -> None:
        """No torque, no power."""
        self._send(cia402.DISABLE_VOLTAGE, 0)
        until = time.monotonic() + self._reply
        while cia402.state(self._sync()[0])[0] == cia402.ENABLED:
            if time.monotonic() > until:
                raise DriveError(STILL_ON)

    def close(self) -> None:
        """Leave the bus."""
        bus, self._bus = self._bus, None
        if bus is not None:
            with suppress(Exception):  # the bus is gone
                bus.shutdown()

    def _send(self, control: int, torque: int) -> float:
        """Controlword and torque, and a heartbeat when it is due; returns when they were sent [s]."""
        now = time.monotonic()
        self._post(cia402.RPDO1 + self._link.node, cia402.COMMAND.pack(control, torque))
        if now - self._beat > self._watchdog / 8:
            self._post(cia402.HEARTBEAT + self._link.host, bytes([cia402.OPERATIONAL]))
            self._beat = now
        return now

    def _sync(self) -> tuple[int, Reading]:
        """Statusword and counts at a SYNC."""
        for _ in range(self.stale):
            if not self._is_waiting() or self._receive(0.0) is None:
                break
        sent = time.monotonic()
        self._post(cia402.SYNC, b"")
        state = stamp = None
        while state is None or (stamp is None and self._link.timestamp):
            id, data = self._answer(sent + self._patience)
            if id == cia402.TPDO1 + self._link.node and len(data) == cia402.STATE.size:
                state = cia402.STATE.unpack(data)
            elif id == cia402.TPDO2 + self._link.node and len(data) == cia402.STAMP.size:
                stamp = cia402.STAMP.unpack(data)
        status, counts, _ = state
        when = sent if stamp is None else self._clock.take(stamp[0], sent, time.monotonic())
        return status, Reading(when, counts)

    def _get(self, where: tuple[int, int]) -> bytes:
        """Value of an object."""
        return self._transfer(where, cia402.UPLOAD, cia402.UPLOADED)

    def _put(self, where: tuple[int, int], layout: str, value: int) -> None:
        """Set an object."""
        self._transfer(where, cia402.DOWNLOAD, cia402.DOWNLOADED, struct.pack(layout, value))

    def _transfer(self, where: tuple[int, int], request: int, granted: int, value: bytes = b"") -> bytes:
        self._post(cia402.REQUEST + self._link.node, cia402.pack_sdo(request, where, value))
        until = time.monotonic() + self._patience
        while True:
            id, data = self._answer(until)
            if id != cia402.ANSWER + self._link.node or len(data) != cia402.SDO.size:
                continue
            answer, about, value = cia402.unpack_sdo(data)
            if about == where and answer == granted:
                return value
            if about == where:
                code = f"abort code {int.from_bytes(value, 'little'):08X}h" if answer == cia402.ABORTED else "segments"
                raise DriveError(
                    f"node {self._link.node} does not take its settings: it answers {code} for object {where[0]:04X}h, "
                    "look that up in its manual, and check canopen402.node"
                )

    def _error(self) -> str:
        """What the drive says is wrong."""
        try:
            code = int.from_bytes(self._get(cia402.ERROR_CODE)[:2], "little")
        except DriveError:
            return "it does not say why"
        return cia402.ERRORS.get(code, f"error code 0x{code:04x}")

    @contextmanager
    def _open_bus(self) -> Iterator[can.BusABC]:
        """The bus, as long as it is there."""
        if self._bus is None:
            raise DriveError("the CAN bus is not open")
        with driver_errors(f"the CAN bus {self._link.channel} was lost", "check its plug"):
            yield self._bus

    def _post(self, id: int, data: bytes) -> None:
        """Send a message; waits no longer than for an answer where the bus takes nothing."""
        with self._open_bus() as bus:
            bus.send(can.Message(arbitration_id=id, is_extended_id=False, data=data), timeout=self._patience)

    def _answer(self, until: float) -> tuple[int, bytes]:
        """Identifier and data of the next message of the drive, which has to come by a time [s]."""
        left = until - time.monotonic()
        found = self._receive(left) if left > 0 else None
        if found is None:
            raise DriveError(
                f"the drive, node {self._link.node}, did not answer within {1e3 * self._patience:.0f} ms: check its "
                "supply, the bus's cable and termination, and canopen402.node"
            )
        return found

    def _receive(self, seconds: float) -> tuple[int, bytes] | None:
        """Identifier and data of a message that comes within a time."""
        with self._open_bus() as bus:
            message = bus.recv(seconds)
        if message is None:
            return None
        return message.arbitration_id, b"" if message.is_error_frame else bytes(message.data)

    def _is_waiting(self) -> bool:
        """Whether something may have come: a serial adapter takes a millisecond to say that nothing has."""
        try:
            return self._bus is None or bool(select.select([self._bus.fileno()], [], [], 0)[0])
        except (NotImplementedError, OSError, ValueError, can.CanError):
            return True  # not every bus tells; reading says what is wrong
