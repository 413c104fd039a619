"""Microcontroller with DAC, counter and watchdog on a serial port, with the protocol of `frames.py`."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import serial

from pendulum_env.backends.hardware import OPENING_TIMEOUT, DriveError, Reading, Sent, driver_errors, frames
from pendulum_env.backends.hardware.config import RigConfig, SerialSettings
from pendulum_env.backends.hardware.encoder import DeviceClock


class SerialAdapter:
    """Amplifier with an analogue input, connected to a microcontroller."""

    settings = SerialSettings
    noise = 0.0  # readings have a time stamp
    max_refusals = 5  # consecutive torques not set for a fault; damaged frames cause fewer
    max_tries = 4  # requests within the timeout, so that a damaged frame is repeated

    def __init__(self, config: RigConfig) -> None:
        """Set port, timeout and watchdog."""
        assert isinstance(config.link, SerialSettings)
        self._link, self._reply, self._watchdog = config.link, config.limits.reply, config.limits.watchdog
        self._gap = config.limits.gap
        self._port: serial.Serial | None = None
        self._is_on = False  # whether the power should be on
        self._micro_torque, self._n_refused = 0, 0  # last torque [uN m], and consecutive answers with another torque

    def open(self) -> None:
        """Open the port, wait for the board, which may restart, and set the watchdog."""
        link, self._is_on = self._link, False
        self._sequence, self._clock, self._splitter = 0, DeviceClock(), frames.Splitter()
        with driver_errors(f"serial port {link.port} cannot be opened", "check serial.port"):
            self._port = serial.Serial(
                link.port,
                link.baud,
                timeout=min(self._reply, self._gap) / self.max_tries,
                write_timeout=self._reply,
                exclusive=True,
            )
            self._port.reset_input_buffer()
            self._port.write(b"\0")  # ends a partial frame
        self._request(frames.SETUP, round(1e3 * self._watchdog), timeout=max(OPENING_TIMEOUT, self._reply))

    def enable(self) -> None:
        """Set the watchdog, in case the board has restarted, and switch the power on."""
        self._request(frames.SETUP, round(1e3 * self._watchdog), timeout=self._reply)
        state, *_ = self._request(frames.POWER, 1)
        if not state.flags & frames.POWERED:
            raise DriveError(
                f"the drive does not switch on: {_describe_fault(state) or 'check its emergency stop and supply'}"
            )
        self._is_on, self._micro_torque, self._n_refused = True, 0, 0

    def write(self, torque: float) -> Sent:
        micro_torque = round(torque / frames.MICRO)
        start = time.monotonic()
        self._send(frames.TORQUE, micro_torque)
        self._micro_torque = micro_torque
        return Sent(start + self._clock.delay, frames.MICRO * micro_torque)

    def read(self) -> Reading:
        state, *times = self._request(frames.READ)
        fault = _describe_fault(state)
        if fault is None and self._is_on and not state.flags & frames.POWERED:
            fault = "it has no power any more: check its emergency stop and supply, it may have started anew"
        self._n_refused = self._n_refused + 1 if self._is_on and state.torque != self._micro_torque else 0
        if fault is None and self._n_refused >= self.max_refusals:
            torque = frames.MICRO * self._micro_torque
            fault = f"it does not set {torque:.3g} N m: firmware and limits.torque have to agree"
        return Reading(self._clock.convert_time(state.microseconds, *times), state.counts, fault)

    def disable(self) -> None:
        self._is_on = False
        state, *_ = self._request(frames.POWER, 0)
        if state.flags & frames.POWERED:
            raise DriveError("the drive says that it has power still: use the emergency stop")

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with suppress(OSError):  # unplugged
                port.close()

    def _request(self, kind: int, *values: int, timeout: float | None = None) -> tuple[frames.BoardState, float, float]:
        """Send a request until it is answered; return the answer, and the times of request and answer [s]."""
        timeout_of_try = (timeout or min(self._reply, self._gap)) / self.max_tries
        timeout = timeout or self._reply
        deadline = time.monotonic() + timeout
        request_times: dict[int, float] = {}  # by number of the request; an answer may come after the next request
        while (time_of_try := time.monotonic()) < deadline:
            request_times[self._send(kind, *values)] = time_of_try
            for state in self._read_answers(min(time_of_try + timeout_of_try, deadline)):
                if state.sequence in request_times:
                    return state, request_times[state.sequence], time.monotonic()
        n_damaged = self._splitter.n_damaged
        hint = f"{n_damaged} damaged frames: check cable and baud rate" if n_damaged else "check its supply and cable"
        raise DriveError(f"the drive on {self._link.port} did not answer within {1e3 * timeout:.0f} ms: {hint}")

    def _send(self, kind: int, *values: int) -> int:
        self._sequence = (self._sequence + 1) % 256
        with self._get_port() as port:
            port.write(frames.pack(kind, self._sequence, *values))
        return self._sequence

    def _read_answers(self, deadline: float) -> Iterator[frames.BoardState]:
        """Yield the states that arrive until a time [s]."""
        while time.monotonic() < deadline:
            with self._get_port() as port:
                data = port.read(1)
                data += port.read(port.in_waiting) if data else b""
            for kind, *values in self._splitter.feed(data):
                if kind == frames.STATE:
                    yield frames.BoardState(*values)

    @contextmanager
    def _get_port(self) -> Iterator[serial.Serial]:
        """Yield the port; turn its errors into DriveErrors."""
        if self._port is None:
            raise DriveError("the serial port is not open")
        with driver_errors(f"serial port {self._link.port} was lost", "check its plug"):
            yield self._port


def _describe_fault(state: frames.BoardState) -> str | None:
    faults = [text for bit, text in frames.FAULTS.items() if state.faults & bit]
    if state.flags & frames.EXPIRED:
        faults.append("its watchdog ran out and took the power away: commands came too late")
    elif not faults and state.faults:
        faults.append(f"fault 0x{state.faults:02x}")
    return ", ".join(faults) or None
