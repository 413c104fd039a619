"""National Instruments card: torque by voltage, encoder counts, and the amplifier's enable input by a digital line.

Samples are on demand and unbuffered; each task is started once. The watchdog of an X-series card does not cover
analogue outputs. It clears the line to the enable input, without which the amplifier gives no current.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import grpc
import nidaqmx
from nidaqmx.constants import AngleUnits, EncoderType, Level
from nidaqmx.stream_readers import CounterReader, DigitalSingleChannelReader
from nidaqmx.stream_writers import AnalogSingleChannelWriter, DigitalSingleChannelWriter
from nidaqmx.system.watchdog import DOExpirationState, WatchdogTask

from pendulum_env.backends.hardware import OPENING_TIMEOUT, DriveError, Reading, Sent
from pendulum_env.backends.hardware.config import DaqSettings, RigConfig
from pendulum_env.errors import shorten_error

LOCAL_NOISE, REMOTE_NOISE = 10e-6, 150e-6  # [s], uncertainty of the time of a count: local driver, gRPC server


class _Timeout(grpc.UnaryUnaryClientInterceptor):  # type: ignore[misc]
    """Timeout of calls to the server; nidaqmx has none."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def intercept_unary_unary(self, continuation: Callable[[Any, Any], Any], details: Any, request: Any) -> Any:
        return continuation(details._replace(timeout=self.seconds), request)


class NiDaq:
    """Amplifier of the Dynaserv with an analogue input, connected to a card."""

    settings = DaqSettings
    full_scale = 10.0  # [V]
    reserved_error = -50103  # error code of NI-DAQmx for a reserved device
    max_tries = 3  # attempts at a reading that takes twice its usual time, and has an uncertain time stamp

    def __init__(self, config: RigConfig) -> None:
        """Set channels, encoder, timeout and watchdog."""
        assert isinstance(config.link, DaqSettings)
        self._link = config.link
        self._pulses = max(1, config.encoder.counts // int(config.link.decoding[-1]))  # X_4: four counts per pulse
        self._reply, self._timeout = config.limits.reply, config.limits.watchdog
        self.noise = LOCAL_NOISE if self._link.server is None else REMOTE_NOISE
        self._tasks: list[Any] = []
        self._channel: grpc.Channel | None = None
        self._call_timeout = _Timeout(self._reply)
        self._reset_time = math.inf  # time of the last watchdog reset [s]; infinite while it is stopped
        self._typical_duration = math.inf  # usual duration of a reading [s]

    def open(self) -> None:
        """Reserve the channels, at zero volts and not enabled."""
        self._call_timeout.seconds = max(OPENING_TIMEOUT, self._reply)
        with self._driver_errors(is_opening=True):
            self._reserve_channels()
        self._call_timeout.seconds = self._reply

    def _reserve_channels(self) -> None:
        link = self._link
        if link.server is not None:
            self._channel = grpc.insecure_channel(link.server)
        torque, encoder, enable = (self._make_task() for _ in range(3))
        torque.ao_channels.add_ao_voltage_chan(link.torque, min_val=-self.full_scale, max_val=self.full_scale)
        encoder.ci_channels.add_ci_ang_encoder_chan(
            link.encoder, decoding_type=EncoderType[link.decoding], units=AngleUnits.TICKS, pulses_per_rev=self._pulses
        )
        enable.do_channels.add_do_chan(link.enable)
        self._volts = AnalogSingleChannelWriter(torque.out_stream, auto_start=False)
        self._counter = CounterReader(encoder.in_stream)
        self._enable = DigitalSingleChannelWriter(enable.out_stream, auto_start=False)
        self._fault = None
        if link.fault is not None:
            fault = self._make_task()
            fault.di_channels.add_di_chan(link.fault)
            self._fault = DigitalSingleChannelReader(fault.in_stream)
        for task in self._tasks:
            task.start()
        self._set_voltage(0.0)
        self._enable.write_one_sample_one_line(False, self._reply)
        device = link.enable.strip("/").partition("/")[0]
        self._watchdog = WatchdogTask(device, timeout=self._timeout, grpc_options=self._make_options())
        self._tasks.append(self._watchdog)
        self._watchdog.cfg_watchdog_do_expir_states([DOExpirationState(link.enable, Level.LOW)])

    def _make_task(self) -> nidaqmx.Task:
        task = nidaqmx.Task(grpc_options=self._make_options())
        self._tasks.append(task)
        return task

    def _make_options(self) -> nidaqmx.GrpcSessionOptions | None:
        if self._channel is None:
            return None
        return nidaqmx.GrpcSessionOptions(grpc.intercept_channel(self._channel, self._call_timeout), "")

    def enable(self) -> None:
        """Set zero volts, start the watchdog, and enable the amplifier."""
        with self._driver_errors():
            self._set_voltage(0.0)
            with suppress(nidaqmx.errors.DaqError):
                self._watchdog.stop()
            self._watchdog.start()
            self._reset_time = time.monotonic()
            with suppress(nidaqmx.errors.DaqError):  # not expired
                self._watchdog.clear_expiration()
            self._enable.write_one_sample_one_line(True, self._reply)

    def write(self, torque: float) -> Sent:
        with self._driver_errors():
            start = time.monotonic()
            applied = self._set_voltage(torque)
            end = time.monotonic()
            if end - self._reset_time > self._timeout / 8:  # not at each command, as the call is slow
                self._watchdog.reset_timer()
                self._reset_time = end
            return Sent(0.5 * (start + end), applied)

    def read(self) -> Reading:
        with self._driver_errors():
            duration, time_of_counts, counts = self._read_counter()
            for _ in range(self.max_tries - 1):
                if duration <= 2 * self._typical_duration:
                    break
                duration, time_of_counts, counts = min((duration, time_of_counts, counts), self._read_counter())
            self._typical_duration = min(1.01 * self._typical_duration, duration)
            level = self._fault.read_one_sample_one_line(self._reply) if self._fault is not None else None
            fault = None
            if level is not None and level == (self._link.fault_active == "high"):
                fault = f"a fault, on {self._link.fault}: read the code on its front"
            elif time_of_counts - self._reset_time > self._timeout and self._watchdog.expired:
                fault = "the card's watchdog ran out and took servo-enable away: commands came too late"
            return Reading(time_of_counts, counts, fault)

    def _read_counter(self) -> tuple[float, float, int]:
        """Read the counter; return the duration of the call [s], the time of its middle [s], and the counts."""
        start = time.monotonic()
        counts = self._counter.read_one_sample_uint32(self._reply)
        end = time.monotonic()
        return end - start, 0.5 * (start + end), counts

    def disable(self) -> None:
        with self._driver_errors():
            try:
                self._set_voltage(0.0)
            finally:  # even if the voltage cannot be set
                self._enable.write_one_sample_one_line(False, self._reply)
            self._watchdog.stop()
            self._reset_time = math.inf

    def close(self) -> None:
        tasks, self._tasks = self._tasks, []
        for task in tasks:
            with suppress(Exception):
                task.close()
            task._close_on_exit = False  # no warning at garbage collection
        channel, self._channel = self._channel, None
        if channel is not None:
            with suppress(Exception):
                channel.close()

    def _set_voltage(self, torque: float) -> float:
        """Set a torque within the range of the voltage; return the torque that acts [N m]."""
        scale, offset = self._link.newton_metres_per_volt, self._link.volts_offset
        volts = min(max(torque / scale + offset, -self.full_scale), self.full_scale)
        self._volts.write_one_sample(volts, self._reply)
        return scale * (volts - offset)

    @contextmanager
    def _driver_errors(self, is_opening: bool = False) -> Iterator[None]:
        """Turn errors of the card into DriveErrors; refuse a closed card unless `is_opening`."""
        if not self._tasks and not is_opening:
            raise DriveError("the card is not open")
        try:
            yield
        except nidaqmx.errors.DaqNotFoundError:
            raise DriveError(
                "the NI-DAQmx driver is not installed: install it (`python -m nidaqmx installdriver`), or name an NI "
                "gRPC device server (nidaq.server)"
            ) from None
        except nidaqmx.errors.RpcError as error:
            raise DriveError(
                f"the device server {self._link.server} did not answer within {1e3 * self._call_timeout.seconds:.0f} "
                f"ms ({shorten_error(error)}): check that it runs, and the network"
            ) from None
        except (nidaqmx.errors.Error, ValueError) as error:  # ValueError: closed gRPC channel
            if getattr(error, "error_code", None) == self.reserved_error:
                raise DriveError(
                    "the card is reserved by another program, or by one that was killed: end it, or reset the device"
                ) from None
            raise DriveError(f"the card refuses ({shorten_error(error)}): check the channels in [nidaq]") from None
