"""An NI gRPC device server with one card and an analogue drive on it, emulated: the calls that the adapter makes."""

import math
import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any

import grpc
from nidaqmx._stubs import nidaqmx_pb2 as messages

from pendulum_env.backends.emulators.emulator import EmulatedRig
from pendulum_env.backends.emulators.motor import Motor

SERVICE = "nidaqmx_grpc.NiDAQmx"
CHANNELS = {"torque": "Dev1/ao0", "encoder": "Dev1/ctr0", "enable": "Dev1/port0/line0", "fault": "Dev1/port0/line1"}
NOTHING_TO_DO = (
    "CreateAOVoltageChan",
    "CreateCIAngEncoderChan",
    "CreateDOChan",
    "CreateDIChan",
    "CfgWatchdogDOExpirStates",
)

Fields = dict[str, Any]  # of a response


class Card:
    """A channel of each kind, and a watchdog that lets servo-enable fall.

    `calls` has what is done at each call of NI's interface, by its name: from the request to fields of the response.
    """

    scale = 1.5  # [N m/V]

    def __init__(self, motor: Motor) -> None:
        self.motor = motor
        self._tasks, self._watchdog = 0, ""  # made so far, and the name of the watchdog's
        self._timeout = math.inf
        self.calls: dict[str, Callable[[Any], Fields]] = dict.fromkeys(NOTHING_TO_DO, lambda request: {}) | {
            "GetSystemInfoAttributeUInt32": lambda request: {"value": 24},  # version of the driver, to whoever asks
            "CreateTask": self._create,
            "CreateWatchdogTimerTaskEx": self._create_watchdog,
            "GetTaskAttributeString": lambda request: {"value": request.task.name},
            "StartTask": lambda request: self._guard(request, self._timeout),
            "StopTask": lambda request: self._guard(request, math.inf),
            "ClearTask": lambda request: self._guard(request, math.inf),
            "ControlWatchdogTask": self._control_watchdog,
            "GetWatchdogAttributeBool": self._is_expired,  # the only one that is asked for
            "WriteAnalogScalarF64": self._set_voltage,
            "WriteDigitalLines": self._set_enable,
            "ReadCounterScalarU32": lambda request: {"value": motor.counts() % 2**32},
            "ReadDigitalLines": self._read_fault,
        }

    def _create(self, request: Any) -> Fields:
        self._tasks += 1
        return {"new_session_initialized": True, "task": {"name": f"_unnamedTask<{self._tasks}>"}}

    def _create_watchdog(self, request: Any) -> Fields:
        created = self._create(request)
        self._timeout, self._watchdog = request.timeout, created["task"]["name"]
        return created

    def _guard(self, request: Any, timeout: float) -> Fields:
        """Start or stop the watchdog; other tasks need neither."""
        if request.task.name == self._watchdog:
            self.motor.watchdog = timeout
            self.motor.feed()
        return {}

    def _control_watchdog(self, request: Any) -> Fields:
        if request.action_raw == 0:  # reset its timer
            self.motor.feed()
        else:
            self.motor.expired = False
        return {}

    def _is_expired(self, request: Any) -> Fields:
        self.motor.advance()
        return {"value": self.motor.expired}

    def _set_voltage(self, request: Any) -> Fields:
        self.motor.command(self.scale * request.value)
        return {}

    def _set_enable(self, request: Any) -> Fields:
        self.motor.advance()
        if not self.motor.expired:  # else the card holds the line
            self.motor.switch(request.write_array != b"\0")
        return {"samps_per_chan_written": 1}

    def _read_fault(self, request: Any) -> Fields:
        return {"read_array": b"\1", "samps_per_chan_read": 1, "num_bytes_per_samp": 1}


class Server:
    """The network to a card, in the place of a wire: a call waits until the emulator's loop lets it `receive`."""

    patience = 5.0  # [s] of a call

    def __init__(self, card: Card) -> None:
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self.descriptor, self._bell = os.pipe()
        handlers = {name: self._handler(name, work) for name, work in card.calls.items()}
        service = grpc.method_handlers_generic_handler(SERVICE, handlers)
        self._server = grpc.server(ThreadPoolExecutor(max_workers=1), handlers=[service])
        self.path = f"127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"
        self._server.start()

    def receive(self) -> None:
        """Answer a call."""
        os.read(self.descriptor, 1)
        self._calls.get()()

    def disconnect(self) -> None:
        """No network."""
        self._server.stop(None)

    def _handler(self, name: str, work: Callable[[Any], Fields]) -> Any:
        """What gRPC does at a call, in a thread of its own."""
        request, response = (getattr(messages, f"{name}{part}") for part in ("Request", "Response"))

        def answer(asked: Any, context: Any) -> Any:
            done: Future[Fields] = Future()
            self._calls.put(lambda: done.set_result(work(asked)))
            os.write(self._bell, b"\0")
            return response(**done.result(self.patience))

        return grpc.unary_unary_rpc_method_handler(answer, request.FromString, response.SerializeToString)


def make_nidaq(motor: Motor) -> EmulatedRig:
    """Put a motor behind a card, at the end of a network."""
    server = Server(Card(motor))
    return EmulatedRig(
        motor, server, "nidaq", {**CHANNELS, "newton_metres_per_volt": Card.scale, "server": server.path}
    )
