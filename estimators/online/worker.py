"""Online diagnosis in a process of its own, so that a control loop does not compute any part of the models.

A sample costs the loop one write to a pipe, and a new diagnosis one read. The diagnosis is that of `Diagnoser`, some
samples later.
"""

from __future__ import annotations

import multiprocessing
import queue
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from estimators.online.diagnosis import Diagnoser, OnlineDiagnosis
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Term

START_TIME = 60.0  # [s], longest start of the process


class DiagnoserProcess:
    """`Diagnoser` in a process of its own, which ends with `close` or this process.

    Attributes:
        diagnoser: as it was given; the process has a copy.
        each: monitors, one per plant.
        diagnoses: latest diagnosis of each plant.
    """

    def __init__(self, diagnoser: Diagnoser) -> None:
        """Start the process, and wait until it is ready.

        Raises:
            OSError: if it does not start.
        """
        self.diagnoser, self.rate, self.batch = diagnoser, diagnoser.rate, diagnoser.batch
        self.diagnoses, self._n_resets = diagnoser.diagnoses, 0
        self.each = tuple(MonitorProxy(self, b) for b in range(self.batch))
        self._connection, remote = multiprocessing.Pipe()
        ends = remote, self._connection
        self._process = multiprocessing.Process(target=_run, args=(*ends, diagnoser), daemon=True)
        self._process.start()
        remote.close()
        if not self._connection.poll(START_TIME):
            raise OSError("the process of the online diagnosis does not start: set worker=False")
        self._connection.recv()

    def take(self, time: Array, position: Array, torque: Array) -> tuple[OnlineDiagnosis, ...]:
        """Pass a sample of every plant on, as `Diagnoser.take`; return the latest diagnosis of each."""
        self._connection.send((Diagnoser.take, (time, position, torque)))
        while self._connection.poll():
            if (answer := self._receive()) is not None:  # the sample cannot be taken
                raise answer[0]
        return self.diagnoses

    def reset(self, which: Mask | None = None) -> None:
        """Restart plants (B,) with their next sample; all by default."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        if mask.any():
            self._n_resets += 1
            self._connection.send((Diagnoser.reset, (mask,)))
            pairs = zip(mask, self.diagnoser.diagnoses, self.diagnoses, strict=True)
            self.diagnoses = tuple(blank if is_reset else latest for is_reset, blank, latest in pairs)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function of the diagnoser in the process, after all samples so far; return its result.

        Raises:
            ValueError: as the function.
        """
        self._connection.send((function, arguments))
        while (answer := self._receive()) is None:
            pass
        if isinstance(answer[0], Exception):
            raise answer[0]
        return answer[0]

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()
        self._connection.close()

    def _receive(self) -> tuple[Any] | None:
        """Receive diagnoses, or the result of a call (1,)."""
        try:
            n_resets, diagnoses, result = self._connection.recv()
        except (EOFError, OSError):
            raise OSError("the process of the online diagnosis has ended: reset the environment in a new one") from None
        if n_resets == self._n_resets:
            self.diagnoses = diagnoses
        return result


class MonitorProxy:
    """`EffectMonitor` of one plant in the process of a `DiagnoserProcess`."""

    def __init__(self, process: DiagnoserProcess, plant: int) -> None:
        """Refer to a plant of a process."""
        self._process, self._plant = process, plant

    @property
    def diagnosis(self) -> OnlineDiagnosis:
        """Return the latest diagnosis."""
        return self._process.diagnoses[self._plant]

    def add(self, effect: str) -> Term:
        """Add an effect to the running model, as `EffectMonitor.add`."""
        term: Term = self._process.call(_add, self._plant, effect)
        return term

    def undo(self) -> None:
        """Remove the effect that was added last, as `EffectMonitor.undo`."""
        self._process.call(_undo, self._plant)

    def reset(self) -> None:
        """Restart the plant with its next sample."""
        self._process.reset(np.arange(self._process.batch) == self._plant)


def _add(diagnoser: Diagnoser, plant: int, effect: str) -> Term:
    return diagnoser.each[plant].add(effect)


def _undo(diagnoser: Diagnoser, plant: int) -> None:
    diagnoser.each[plant].undo()


def _run(connection: Connection, other_end: Connection, diagnoser: Diagnoser) -> None:
    """Call the functions that arrive, until the connection is closed.

    New diagnoses and results of calls are sent. A thread empties the pipe, so that `take` never waits.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the loop, and this process with it
    other_end.close()  # a copy of it would keep the connection open after the loop
    n_resets, latest = 0, diagnoser.diagnoses
    calls: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_collect_calls, args=(connection, calls), daemon=True).start()
    connection.send("ready")
    while (call := calls.get()) is not None:
        function, arguments = call
        result: Any = None
        n_resets += function is Diagnoser.reset
        try:
            answer = function(diagnoser, *arguments)
        except ValueError as error:
            answer, result = None, (error,)
        if function not in (Diagnoser.take, Diagnoser.reset):
            result = result or (answer,)
        diagnoses = diagnoser.diagnoses
        if result is not None or any(a is not b for a, b in zip(diagnoses, latest, strict=True)):
            latest = diagnoses
            connection.send((n_resets, latest, result))


def _collect_calls(connection: Connection, calls: queue.SimpleQueue[Any]) -> None:
    """Put the calls of a connection into a queue, and None at its end."""
    try:
        while True:
            calls.put(connection.recv())
    except (EOFError, OSError):
        calls.put(None)
