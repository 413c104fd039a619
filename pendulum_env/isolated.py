"""Parsers of what strangers wrote, in a process of their own: whatever a file does to one, it does not do it here.

The helper has bounds of memory, of processor time and of open files (of memory on Linux alone; on Windows it has the
clock's only), says nothing on any stream, and answers with a record of JSON and with plain arrays of numbers or texts:
nothing that it says can run anything. It is begun when it is first needed, waits for more work, and ends with its
parent. One that dies takes one file with it.
"""

import atexit
import json
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendulum_env.mistake import Mistake
from pendulum_env.reading import LARGEST, REMEDY, Unreadable, amount

Answer = tuple[Any, Sequence[NDArray[Any]]]  # a record that JSON holds, and arrays


@dataclass(frozen=True)
class Bounds:
    """What a helper may take."""

    room: int = 500_000_000  # bytes of memory beside `size`: 110 MB for the libraries, the rest to unpack with
    seconds: int = 20  # of processor time, where `size` is as usual; in proportion where it is more
    patience: float = 10.0  # times as long by the clock, for a machine that does other things as well
    files: int = 64  # that may be open
    record: int = 1 << 26  # bytes of a record
    idle: int = 2  # helpers that wait for more work
    watched: float = 0.5  # [s] between looks at whether the parent is alive


BOUNDS = Bounds()
HERE = os.path.dirname(__file__)
BARE = {"pendulum_env": HERE, "pendulum_env.arms": os.path.join(HERE, "arms")}  # whose contents a helper begins without
SERVE = f"""
import sys, types
for name, folder in {BARE}.items():
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = [folder]
from pendulum_env.isolated import serve; serve()
"""
ALONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}  # reserve little


def isolated(work: Callable[..., Answer], *arguments: object, size: float = LARGEST, remedy: str = REMEDY) -> Answer:
    """What `work(*arguments)` returns in a helper.

    Args:
        work: a function of a module.
        arguments: that can be pickled.
        size: bytes that the arrays may take; memory and time are bounded in proportion.
        remedy: what helps where they do not suffice.

    Raises:
        Mistake: what `work` raises; of the same class if it takes the message alone.
        Unreadable: if the helper fails, takes too long, or answers with more than `size` bytes.
    """
    helper = _ready()
    try:
        head, arrays = helper.ask(work, arguments, size, remedy)
    except BaseException:
        helper.end()
        raise
    if len(_idle) < BOUNDS.idle:
        _idle.append(helper)
    else:
        helper.end()
    if "mistake" in head:
        kinds = [Mistake]
        for kind in kinds:
            kinds += kind.__subclasses__()
        raise next((kind for kind in kinds if kind.__name__ == head["mistake"]), Unreadable)(str(head["told"]))
    return head.get("record"), arrays


class _Helper:
    """A process that parses, and the pipes to it."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", SERVE],  # what lies in the working directory is no module
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **ALONE, "PYTHONPATH": os.pathsep.join(sys.path)},
            start_new_session=True,  # the keyboard's interrupt is the parent's to answer
        )
        assert self.process.stdin is not None and self.process.stdout is not None
        self._questions, self._answers = self.process.stdin, self.process.stdout

    def ask(self, work: Callable[..., Answer], arguments: tuple[object, ...], size: float, remedy: str) -> Answer:
        seconds = math.ceil(BOUNDS.seconds * max(1.0, size / LARGEST))
        until = time.monotonic() + BOUNDS.patience * seconds
        late = threading.Timer(BOUNDS.patience * seconds, self.process.kill)
        late.daemon = True
        late.start()
        try:
            memory = BOUNDS.room + int(size)
            limits = {"DATA": memory, "FSIZE": int(size), "CPU": seconds, "NOFILE": BOUNDS.files, "CORE": 0}
            self._questions.write(pickle.dumps((_folder(), work, arguments, limits)))
            self._questions.flush()
            return self._heard(size, remedy)
        except Unreadable:
            raise
        except Exception:  # nothing, half an answer, or nonsense
            self.end(after=1.0)
            code = -self.process.returncode
            if code == getattr(signal, "SIGXCPU", None) or time.monotonic() > until:
                raise Unreadable(f"it takes more than {seconds} s to read: {remedy}") from None
            how = signal.Signals(code).name if code > 0 else f"exit code {-code}"
            raise Unreadable(
                f"what reads it crashed ({how}): it is damaged, or takes more than {amount(memory)} of memory: "
                f"export it again, or {remedy}"
            ) from None
        finally:
            late.cancel()

    def _heard(self, size: float, remedy: str) -> Answer:
        head = json.loads(self._answers.readline(BOUNDS.record))
        kinds = [(np.dtype(str(kind)), tuple(map(int, shape))) for kind, shape in head.get("arrays", ())]
        if any(kind.kind not in "biufcU" for kind, _ in kinds):
            raise ValueError("no plain array")
        if (most := sum(math.prod(shape) * kind.itemsize for kind, shape in kinds)) > size:
            raise Unreadable(
                f"it holds {amount(most)} when unpacked, of which at most {amount(size)} are read: {remedy}"
            )
        arrays = [np.empty(shape, kind) for kind, shape in kinds]
        for array in arrays:
            if self._answers.readinto(_bytes(array)) != array.nbytes:  # type: ignore[attr-defined]
                raise ValueError("half an answer")
        return head, arrays

    def end(self, after: float = 0.0) -> None:
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(after)  # so that it can be asked what it died of
        self.process.kill()
        self.process.wait()
        for pipe in (self._questions, self._answers):
            with suppress(OSError):  # of what was not heard
                pipe.close()


_idle: list[_Helper] = []


def _ready() -> _Helper:
    with suppress(IndexError):
        while True:
            helper = _idle.pop()
            if helper.process.poll() is None:
                return helper
            helper.end()
    return _Helper()


@atexit.register
def _end() -> None:
    while _idle:
        _idle.pop().end()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)  # they are the parent's


def _folder() -> str:
    """The working directory; if it is gone, another one."""
    with suppress(OSError):
        return os.getcwd()
    return os.sep


def _bytes(array: NDArray[Any]) -> memoryview:
    return array.reshape(-1).view(np.uint8).data


# ------------------------------------------------------------------------------------------------------- the helper


def serve() -> None:
    """Do what the parent asks for, until it asks for no more."""
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    for name in ("f2py", "testing"):  # SciPy takes all that NumPy has, and these alone take 0.1 s to import
        vars(np)[name] = None
    while True:
        try:
            folder, work, arguments, limits = pickle.load(questions)
        except EOFError:
            return
        os.chdir(folder)  # names of files are relative to where the parent is now
        limits["CPU"] += math.ceil(time.process_time())
        for what, most in limits.items():
            _limit(what, most)
        for part in _answer(work, arguments):
            answers.write(part)
        answers.flush()


def _end_with(parent: int) -> None:
    """End when the parent has: one that was killed closes the pipes, which nobody reads while a file is parsed."""
    while os.getppid() == parent:
        time.sleep(BOUNDS.watched)
    os._exit(1)


def _answer(work: Callable[..., Answer], arguments: tuple[object, ...]) -> Iterator[bytes | memoryview]:
    try:
        record, given = work(*arguments)
    except Mistake as mistake:
        yield json.dumps({"mistake": type(mistake).__name__, "told": str(mistake)}).encode() + b"\n"
        return
    arrays = [np.require(array, requirements="C") for array in given]
    told = {"record": record, "arrays": [(array.dtype.str, array.shape) for array in arrays]}
    yield json.dumps(told).encode() + b"\n"
    yield from map(_bytes, arrays)


def _limit(what: str, most: int) -> None:
    """Bound a resource, where the system knows it, no further than it is bounded."""
    with suppress(ImportError, AttributeError, ValueError, OSError):
        import resource

        kind = getattr(resource, f"RLIMIT_{what}")
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
