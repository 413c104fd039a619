"""An NI gRPC device server with one card and an analogue drive on it, emulated: the calls that the adapter makes."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
from nidaqmx._stubs import nidaqmx_pb2 as messages
from nidaqmx._stubs.nidaqmx_pb2_grpc import NiDAQmxServicer, add_NiDAQmxServicer_to_server

from pendulum_env.backends.emulators.motor import Motor

DEVICE = "Dev1"
TORQUE, ENCODER, ENABLE, FAULT = "ao0", "ctr0", "port0/line0", "port0/line1"
NEWTON_METRES_PER_VOLT = 1.5
VERSION = 24  # of the driver, to whoever asks
UNKNOWN_CHANNEL, RESERVED = -200170, -50103  # error codes of NI-DAQmx
RESET_TIMER = 0


class DaqEmulator(NiDAQmxServicer):  # type: ignore[misc]
    """Tasks by name, each with its channel; a channel belongs to one task at a time."""

    def __init__(self, motor: Motor) -> None:
        """Take the motor."""
        self.motor = motor
        self._tasks: dict[str, str] = {}  # channel of each
        self._started: set[str] = set()
        self._made, self._faulty = 0, False
        self._watchdog, self._enabled = math.inf, False
        self._server = grpc.server(ThreadPoolExecutor(max_workers=1))  # one call after the other
        add_NiDAQmxServicer_to_server(self, self._server)
        self._port = self._server.add_insecure_port("127.0.0.1:0")
        self._server.start()

    @property
    def place(self) -> str:
        """Host and port."""
        return f"127.0.0.1:{self._port}"

    def settings(self) -> dict[str, Any]:
        """Keys of its table in rig.toml."""
        channels = {"torque": TORQUE, "encoder": ENCODER, "enable": ENABLE, "fault": FAULT}
        return {
            **{name: f"{DEVICE}/{channel}" for name, channel in channels.items()},
            "newton_metres_per_volt": NEWTON_METRES_PER_VOLT,
            "server": self.place,
        }

    def sources(self) -> dict[int, Callable[[], None]]:
        """None: gRPC has its own threads."""
        return {}

    def fault(self) -> None:
        """The fault line falls, until the process ends."""
        self._faulty = True
        self.motor.switch(False)

    def unplug(self) -> None:
        """No network."""
        self._server.stop(None)

    def corrupt(self, probability: float) -> None:
        """TCP lets nothing damaged through."""

    def close(self) -> None:
        """Stop listening."""
        self._server.stop(None)

    # calls, under NI's names

    def GetSystemInfoAttributeUInt32(self, request: Any, context: Any) -> Any:  # noqa: D102
        return messages.GetSystemInfoAttributeUInt32Response(value=VERSION)

    def CreateTask(self, request: Any, context: Any) -> Any:  # noqa: D102
        response = messages.CreateTaskResponse(new_session_initialized=True)
        response.task.name = self._new()
        return response

    def CreateWatchdogTimerTaskEx(self, request: Any, context: Any) -> Any:  # noqa: D102
        self._watchdog = request.timeout
        response = messages.CreateWatchdogTimerTaskExResponse(new_session_initialized=True)
        response.task.name = self._new()
        self._tasks[response.task.name] = "watchdog"
        return response

    def GetTaskAttributeString(self, request: Any, context: Any) -> Any:  # noqa: D102
        return messages.GetTaskAttributeStringResponse(value=request.task.name)

    def CreateAOVoltageChan(self, request: Any, context: Any) -> Any:  # noqa: D102
        self._add(request.task, request.physical_channel, TORQUE, context)
        return messages.CreateAOVoltageChanResponse()

    def CreateCIAngEncoderChan(self, request: Any, context: Any) -> Any:  # noqa: D102
        self._add(request.task, request.counter, ENCODER, context)
        return messages.CreateCIAngEncoderChanResponse()

    def CreateDOChan(self, request: Any, context: Any) -> Any:  # noqa: D102
        self._add(request.task, request.lines, ENABLE, context)
        return messages.CreateDOChanResponse()

    def CreateDIChan(self, request: Any, context: Any) -> Any:  # noqa: D102
        self._add(request.task, request.lines, FAULT, context)
        return messages.CreateDIChanResponse()

    def CfgWatchdogDOExpirStates(self, request: Any, context: Any) -> Any:  # noqa: D102
        return messages.CfgWatchdogDOExpirStatesResponse()

    def StartTask(self, request: Any, context: Any) -> Any:  # noqa: D102
        channel = self._tasks[request.task.name]
        if any(self._tasks[task] == channel for task in self._started - {request.task.name}):
            self._refuse(context, RESERVED, f"the resource {channel} is reserved by another task")
        self._started.add(request.task.name)
        if channel == "watchdog":
            self.motor.watchdog = self._watchdog
            self.motor.feed()
        return messages.StartTaskResponse()

    def StopTask(self, request: Any, context: Any) -> Any:  # noqa: D102
        self._stop(request.task.name)
        return messages.StopTaskResponse()

    def ClearTask(self, request: Any, context: Any) -> Any:  # noqa: D102
        self._stop(request.task.name)
        self._tasks.pop(request.task.name, None)
        return messages.ClearTaskResponse()

    def ControlWatchdogTask(self, request: Any, context: Any) -> Any:  # noqa: D102
        if request.action_raw == RESET_TIMER:
            self.motor.feed()
        else:
            self.motor.expired = False
        return messages.ControlWatchdogTaskResponse()

    def GetWatchdogAttributeBool(self, request: Any, context: Any) -> Any:  # noqa: D102
        self.motor.advance()
        return messages.GetWatchdogAttributeBoolResponse(value=self.motor.expired)  # the only one that is asked for

    def WriteAnalogScalarF64(self, request: Any, context: Any) -> Any:  # noqa: D102
        self.motor.command(NEWTON_METRES_PER_VOLT * request.value)
        return messages.WriteAnalogScalarF64Response()

    def WriteDigitalLines(self, request: Any, context: Any) -> Any:  # noqa: D102
        motor = self.motor
        motor.advance()
        if not motor.expired:  # else the card holds the line
            motor.switch(request.write_array != b"\0" and not self._faulty)
        return messages.WriteDigitalLinesResponse(samps_per_chan_written=1)

    def ReadCounterScalarU32(self, request: Any, context: Any) -> Any:  # noqa: D102
        return messages.ReadCounterScalarU32Response(value=self.motor.counts() % 2**32)

    def ReadDigitalLines(self, request: Any, context: Any) -> Any:  # noqa: D102
        level = struct.pack("?", not self._faulty)
        return messages.ReadDigitalLinesResponse(read_array=level, samps_per_chan_read=1, num_bytes_per_samp=1)

    def _new(self) -> str:
        self._made += 1
        name = f"_unnamedTask<{self._made}>"
        self._tasks[name] = ""
        return name

    def _add(self, task: Any, channel: str, known: str, context: Any) -> None:
        if channel.strip("/") != f"{DEVICE}/{known}":
            self._refuse(context, UNKNOWN_CHANNEL, f"physical channel {channel} does not exist: here is {known}")
        self._tasks[task.name] = known

    def _refuse(self, context: Any, code: int, why: str) -> None:
        context.set_trailing_metadata((("ni-error", str(code)),))
        context.abort(grpc.StatusCode.UNKNOWN, why)

    def _stop(self, task: str) -> None:
        self._started.discard(task)
        if self._tasks.get(task) == "watchdog":
            self.motor.watchdog = math.inf
            self.motor.feed()


def make(motor: Motor) -> DaqEmulator:
    """Emulator around a motor."""
    return DaqEmulator(motor)
