"""A servo drive with CANopen, CiA 402, in cyclic synchronous torque mode, on any bus of python-can."""

from __future__ import annotations

import logging
import math
import queue
import struct
import time

import can
import canopen
from canopen.sdo.exceptions import SdoError

from pendulum_env.backends.hardware import cia402
from pendulum_env.backends.hardware.clock import DriveClock
from pendulum_env.backends.hardware.config import CanSettings, RigConfig
from pendulum_env.backends.hardware.drive import OPENING, DriveError, Reading, Sent

POLL = 0.002  # [s] between looks whether the bus has died
SWITCHING = 2.0  # [s] that a drive may take to switch on
PER_MILLE = 1e-3


for library in ("can", "canopen"):  # what they find wrong comes as an exception, too, and is told once
    logging.getLogger(library).addHandler(logging.NullHandler())


class _Listener(can.Listener):
    """Lets the thread that receives end in silence: `Network.check` hands on what ended it."""

    def on_message_received(self, msg: can.Message) -> None:
        """Others listen to messages."""

    def on_error(self, exc: Exception) -> None:
        """It is kept."""


class _Network(canopen.Network):
    """A network that never waits forever for a bus that takes nothing."""

    def __init__(self, timeout: float) -> None:
        super().__init__()
        self._timeout = timeout
        self.listeners.append(_Listener())  # type: ignore[arg-type]  # any listener of python-can will do

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        message = can.Message(arbitration_id=can_id, is_extended_id=False, data=data, is_remote_frame=remote)
        with self.send_lock:
            if self.bus is None:
                raise RuntimeError("the bus is closed")
            self.bus.send(message, timeout=self._timeout)


class Canopen402:
    """The drive: torque to it in RPDO1 at once, counts from it in TPDO1 (and its clock in TPDO2) at each SYNC.

    It hears this computer's heartbeat from `write` only, and lets go when that stays away for the watchdog's time.
    """

    def __init__(self, link: CanSettings, reply: float, watchdog: float) -> None:
        """Take the bus, the time to wait for a reply and that of the watchdog [s]."""
        self._link, self._reply, self._watchdog = link, reply, watchdog
        self._network: _Network | None = None
        self._come: queue.SimpleQueue[tuple[int, bytes, float]] = queue.SimpleQueue()
        self._clock = DriveClock()
        self._beat = 0.0  # time of the last heartbeat
        self.noise = 0.0 if link.timestamp else 50e-6  # [s]; of a SYNC on a bus

    def open(self) -> None:
        """Join the bus and lay out the messages."""
        link, network = self._link, _Network(self._reply)
        options = {"sleep_after_open": 0.0} if link.interface == "slcan" else {}
        try:
            network.connect(interface=link.interface, channel=link.channel, bitrate=link.bitrate, **options)
        except Exception as error:  # each kind of bus has a driver of its own, which raises what it likes
            raise DriveError(
                f"the CAN bus {link.interface} {link.channel} cannot be opened ({error}): check canopen402.interface "
                "and channel"
            ) from None
        self._network, self._clock = network, DriveClock()
        try:
            self._lay_out(network)
        except (SdoError, can.CanError, OSError, struct.error) as error:
            raise DriveError(
                f"node {link.node} on {link.channel} does not take its settings ({error}): check its supply, the bus's "
                "cable and termination, and canopen402.node"
            ) from None

    def _lay_out(self, network: _Network) -> None:
        link = self._link
        objects = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
        node = network.add_node(canopen.RemoteNode(link.node, objects))
        node.sdo.RESPONSE_TIMEOUT = max(OPENING, self._reply)
        self._sdo = node.sdo
        network.send_message(cia402.NMT, bytes([cia402.PRE_OPERATIONAL, link.node]))

        def put(index: int, subindex: int, layout: str, value: int) -> None:
            self._sdo.download(index, subindex, struct.pack(layout, value))

        for base, ((parameters, mapping), entries) in cia402.PDOS.items():
            if base == cia402.TPDO2 and not link.timestamp:
                continue
            identifier = base + link.node
            if base != cia402.RPDO1:
                network.subscribe(identifier, self._received)
                identifier |= cia402.NO_REMOTE
            put(parameters, 1, "<I", cia402.INVALID | identifier)
            put(parameters, 2, "<B", cia402.AT_ONCE if base == cia402.RPDO1 else cia402.AT_SYNC)
            put(mapping, 0, "<B", 0)
            for k, entry in enumerate(entries, start=1):
                put(mapping, k, "<I", entry)
            put(mapping, 0, "<B", len(entries))
            put(parameters, 1, "<I", identifier)
        (rated,) = struct.unpack("<I", self._sdo.upload(*cia402.RATED_TORQUE))
        if not math.isclose(1e-3 * rated, link.rated_torque, rel_tol=0.01):
            raise DriveError(
                f"the drive's rated torque is {1e-3 * rated:g} N m (object 6076h), canopen402.rated_torque says "
                f"{link.rated_torque:g}: every torque would be wrong by as much, write the drive's there"
            )
        put(*cia402.MODE, "<b", cia402.TORQUE_MODE)
        put(*cia402.ON_LOST_HOST, "<h", 1)
        put(*cia402.ON_FAULT, "<h", 0)
        put(*cia402.CONSUMER_HEARTBEAT, "<I", link.host << 16 | round(1e3 * self._watchdog))
        network.send_message(cia402.NMT, bytes([cia402.START, link.node]))
        network.send_message(cia402.RPDO1 + link.node, cia402.COMMAND.pack(cia402.DISABLE_VOLTAGE, 0))
        node.sdo.RESPONSE_TIMEOUT = self._reply

    def _received(self, id: int, data: bytearray, timestamp: float) -> None:
        self._come.put((id, bytes(data), time.monotonic()))

    def enable(self) -> None:
        """Go through the states of CiA 402 up to operation."""
        until = time.monotonic() + SWITCHING
        last = cia402.DISABLE_VOLTAGE
        while True:
            status, _ = self._sync()
            name, control = cia402.state(status)
            mode = self._mode() if name == cia402.ENABLED else None
            if mode == cia402.TORQUE_MODE:
                return
            if time.monotonic() > until:
                if mode is not None:
                    raise DriveError(
                        f"the drive is in mode {mode} (object 6061h), not in cyclic synchronous torque, 10"
                    )
                raise DriveError(f"the drive stays in state '{name}' ({self._error()}): mend that, or switch it on")
            if control == last == cia402.FAULT_RESET:
                control = cia402.DISABLE_VOLTAGE  # the reset acts at the edge
            self._send(control, 0)
            last = control

    def write(self, torque: float) -> Sent:
        """Set the torque [N m], in thousandths of the rated one."""
        unit = PER_MILLE * self._link.rated_torque
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
                raise DriveError("the drive says that it has power still: use the emergency stop")

    def close(self) -> None:
        """Leave the bus."""
        network, self._network = self._network, None
        if network is not None:
            try:
                network.disconnect()
            except Exception:
                pass  # the bus is gone

    def _send(self, control: int, torque: int) -> float:
        """Controlword and torque, and a heartbeat when it is due; returns when they were sent [s]."""
        now = time.monotonic()
        self._post(cia402.RPDO1 + self._link.node, cia402.COMMAND.pack(control, torque))
        if now - self._beat > self._watchdog / 8:
            self._post(cia402.HEARTBEAT + self._link.host, bytes([cia402.OPERATIONAL]))
            self._beat = now
        return now

    def _post(self, id: int, data: bytes) -> None:
        if self._network is None:
            raise DriveError("the CAN bus is not open")
        try:
            self._network.send_message(id, data)
        except Exception as error:  # python-can lets through what its many buses raise
            raise self._lost(error) from None
        self._alive()

    def _sync(self) -> tuple[int, Reading]:
        """Statusword and counts at a SYNC."""
        while not self._come.empty():
            self._come.get_nowait()
        sent = time.monotonic()
        self._post(cia402.SYNC, b"")
        state = stamp = None
        while state is None or (stamp is None and self._link.timestamp):
            try:
                id, data, arrived = self._come.get(timeout=POLL)
            except queue.Empty:
                if time.monotonic() > sent + self._reply:
                    raise DriveError(
                        f"the drive, node {self._link.node}, did not answer within {1e3 * self._reply:.0f} ms: check "
                        "its supply and the bus's cable"
                    ) from None
                self._alive()
                continue
            if id == cia402.TPDO1 + self._link.node and len(data) == cia402.STATE.size:
                state = cia402.STATE.unpack(data)
            elif id == cia402.TPDO2 + self._link.node and len(data) == cia402.STAMP.size:
                stamp = cia402.STAMP.unpack(data)
        status, counts, _ = state
        when = sent if stamp is None else self._clock.take(stamp[0], sent, arrived)
        return status, Reading(when, counts)

    def _alive(self) -> None:
        """Notice that the thread which receives has ended: it keeps what ended it."""
        assert self._network is not None
        try:
            self._network.check()
        except Exception as error:
            raise self._lost(error) from None

    def _lost(self, error: Exception) -> DriveError:
        return DriveError(f"the CAN bus {self._link.channel} was lost ({error}): check its plug")

    def _mode(self) -> int:
        """Mode of operation that the drive is in."""
        try:
            return int.from_bytes(self._sdo.upload(*cia402.MODE_SHOWN)[:1], "little", signed=True)
        except (SdoError, can.CanError, OSError) as error:
            raise DriveError(f"the drive does not say in which mode it is ({error}): check the bus's cable") from None

    def _error(self) -> str:
        """What the drive says is wrong."""
        try:
            (code,) = struct.unpack("<H", self._sdo.upload(*cia402.ERROR_CODE))
        except (SdoError, can.CanError, OSError, struct.error):
            return "it does not say why"
        return cia402.ERRORS.get(code, f"error code 0x{code:04x}")


def make(config: RigConfig) -> Canopen402:
    """Drive of a configuration."""
    assert isinstance(config.link, CanSettings)
    return Canopen402(config.link, config.limits.reply, config.limits.watchdog)
