"""A pendulum, simulated or real, that runs in real time while the six schemes estimate its parameters.

Meanwhile it is followed: whether the model still predicts, and which effect it lacks (`following`).
"""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from estimators.schemes.identification import Convergence, Identification, Identified
from estimators.schemes.six import SCHEMES
from estimators.wrappers import EstimateParameters
from estimators.wrappers.options import smoothing_of
from pendulum_env._typing import Array
from pendulum_env.backends.hardware.config import load
from pendulum_env.backends.hardware.drive import DriveError
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.interface import MAX_TORQUE
from pendulum_env.physics import BASE, Model
from pendulum_env.policy import Controller
from pendulum_env.recording import Recording
from pendulum_env.registration import PENDULUM
from workbench.app.following import Follower, Following
from workbench.app.torques import LEARNT, torque_of
from workbench.mistakes import MISTAKES, sentence
from workbench.processes import Quiet
from workbench.rig import controller, cut_at

RATE = 500.0  # [Hz]
LONGEST = 120.0  # [s] of a run
SLICE = 0.02  # [s] of the run between two looks at the clock
LOOK = 0.1  # [s] between two entries of the history
FRAMES = 50  # samples of the motion that the page draws between two looks
UNSEEN = 8.0  # [s] after which a run that no page asks about stops
UNSEEN_RIG = 3.0  # [s], of a motor that nobody watches
GRACE = 5.0  # [s] in which a motor has to be let go of, once that was asked for
LOST = "the program that ran the motor ended unexpectedly: the drive's watchdog has taken its torque away"
REFUSALS = (*MISTAKES, ValueError, DriveError, ModuleNotFoundError)
SETTLED = 0.5  # [s] from the start, before which standard errors mean nothing


@dataclass(frozen=True)
class Setup:
    """What to run.

    Attributes:
        backend: of the environment.
        excitation: name of the torque signal, or of a policy.
        amplitude: bound of the torque [N m]; None for the usual one.
        effects: hidden in a simulated plant.
        seconds: length of the run.
        seed: of all random numbers.
        recording: file that a replay plays.
        rig: configuration of the rig, for the backend "dm1015b".
    """

    backend: str
    excitation: str
    amplitude: float | None
    effects: tuple[str, ...]
    seconds: float
    seed: int
    recording: Path | None = None
    rig: Path | None = None


@dataclass(frozen=True, eq=False)
class Look:
    """A run as of one moment.

    Attributes:
        time: seconds that have passed in the run.
        pace: seconds of the run in one second.
        motion: time [s], position [rad] and torque [N m] of the last moments (K, 3).
        identification: estimates of the schemes and how they came about; None before anything is known.
        truth: parameters of the simulated plant, by name; empty where nobody knows them.
        running: whether it goes on.
        trouble: why it ended, if it should not have.
        remark: what else is to be known of it.
        following: what is said of its model.
    """

    time: float
    pace: float
    motion: Array
    identification: Identification | None
    truth: dict[str, float]
    running: bool
    trouble: str
    remark: str
    following: Following


class Slice(NamedTuple):
    """What a run measured since it told last."""

    rows: list[tuple[float, float, float]]  # time [s], position [rad], torque [N m]
    entry: tuple[float, Array, Array] | None  # time, theta and standard errors of the schemes (S, P), now and then
    pace: float


class Loop:
    """A run from its environment on; where it goes through it, it blocks.

    Attributes:
        rate: samples per second [Hz].
        truth: parameters of the simulated plant.
        remark: what is to be known of it.
        smoothing: of its measurement.
    """

    def __init__(self, setup: Setup) -> None:
        """Make the environment; a rig is owned and connected from now on, and has no power.

        Raises:
            ValueError: if an argument is unknown or out of its range, or the rig's configuration cannot be used.
            RecordingError: if a replay's recording cannot be read.
            DriveError: if the rig cannot be reached or is in use.
            ModuleNotFoundError: if the extra `hardware` is not installed.
        """
        rng = np.random.default_rng(setup.seed)
        self.setup = setup
        replayed = setup.recording is not None
        if replayed and setup.excitation in LEARNT:
            raise ValueError("a replay does not follow a policy: choose another backend, or any signal")
        rig = None if setup.rig is None else load(setup.rig)
        command = torque_of(setup.excitation, rng, setup.seconds, setup.amplitude, RATE if rig is None else rig.rate)
        self.remark = "" if rig is None else cut_at(rig, command)
        options: dict[str, Any] = {"effects": list(setup.effects)}
        if replayed:
            options = {"recording": setup.recording}
        elif rig is not None:
            options = {"config": rig.path}
        env = gym.make(
            PENDULUM,
            max_episode_steps=-1,
            backend=setup.backend,
            rate=RATE,
            torque_noise=0.0 if replayed else TORQUE_NOISE,
            max_torque=max(MAX_TORQUE, command.amplitude),
            **options,
        )
        try:
            self._env = EstimateParameters(env)
        except ValueError:
            env.close()
            raise
        self.rate = float(env.unwrapped.rate)  # type: ignore[attr-defined]
        self.smoothing = smoothing_of(env, self.rate)
        self._policy = controller(command, self.rate)
        plant: Model | None = env.unwrapped.model if getattr(env.unwrapped, "simulated", False) else None  # type: ignore[attr-defined]
        self.truth = {name: e.value for name, e in plant.estimates.items()} if plant is not None else {}

    def go(self, tell: Callable[[Slice], None], goes_on: Callable[[], bool]) -> str:
        """Run to the end, or as long as it is to go on; returns what went wrong."""
        try:
            return self._run(tell, goes_on)
        except REFUSALS as mistake:
            return sentence(mistake)
        finally:
            self._env.close()

    def _run(self, tell: Callable[[Slice], None], goes_on: Callable[[], bool]) -> str:
        policy, state = self._policy, None
        observation, info = self._env.reset(seed=self.setup.seed)
        began, due = time.monotonic(), LOOK
        ended, first = False, True
        while not ended and goes_on():
            rows = []
            for _ in range(max(1, round(SLICE * self.rate))):
                if isinstance(policy, Controller):
                    action: Any = np.array([policy.torque(info)])
                else:
                    action, state = policy.predict(observation, state, np.array(first))
                row = info["time"], info["position"]
                observation, _, terminated, truncated, info = self._env.step(action)
                first, ended = False, terminated or truncated or info["time"] >= self.setup.seconds
                if "fault" not in info:  # with one, nothing was measured
                    rows.append((*row, info["torque"]))  # the torque acts from the sample before
                if ended:
                    break
            now, passed = float(info["time"]), time.monotonic() - began
            entry = _entry(info) if now >= due and info["estimates_time"] > SETTLED else None
            tell(Slice(rows, entry, min(1.0, now / passed) if passed > 0 else 1.0))
            if now >= due:
                due = now + LOOK
            time.sleep(max(0.0, now - passed))
        return str(info.get("fault", ""))


class Apart:
    """A loop in a process of its own, as a motor cannot wait for a server that draws; it ends with the server."""

    def __init__(self, setup: Setup) -> None:
        """Start the process and wait for its environment; raises ValueError for all that a `Loop` raises."""
        self._connection, theirs = multiprocessing.Pipe()
        self._process = Quiet(target=_apart, args=(theirs, setup), daemon=True, name="pendulum-ident rig")
        self._process.start()
        theirs.close()
        try:
            found = self._connection.recv()
        except EOFError:
            found = LOST
        if isinstance(found, str):
            self._process.join()
            raise ValueError(found)
        self.rate, self.truth, self.remark, self.smoothing = found

    def go(self, tell: Callable[[Slice], None], goes_on: Callable[[], bool]) -> str:
        """As that of a `Loop`."""
        until: float | None = None
        try:
            while True:
                if until is None and not goes_on():
                    until = time.monotonic() + GRACE
                    self.halt()
                if until is not None and time.monotonic() > until:
                    self._process.terminate()  # the rig takes the torque away before it ends
                if self._connection.poll(SLICE):
                    heard = self._connection.recv()
                    if isinstance(heard, str):
                        return heard
                    tell(heard)
        except (EOFError, OSError):
            return LOST if until is None else ""
        finally:
            self._end()

    def halt(self) -> None:
        """Tell the motor to stop at once: what was measured may still be looked at when it is to."""
        with suppress(OSError):  # it has ended, and what it has sent is still to be received
            self._connection.send(None)

    def _end(self) -> None:
        """See to it that the process ends, whatever has happened here: it drives a motor."""
        with suppress(OSError):
            self._connection.send(None)
        until = time.monotonic() + GRACE
        while self._process.is_alive() and time.monotonic() < until:
            with suppress(EOFError, OSError):
                while self._connection.poll():
                    self._connection.recv()  # else it could wait for somebody to listen
            self._process.join(SLICE)
        if self._process.is_alive():
            self._process.terminate()  # the rig takes the torque away before it ends
        self._process.join()
        self._connection.close()


def _apart(connection: Connection[Any, Any], setup: Setup) -> None:
    """Go through a loop; whatever comes from the server, its end included, is the word to stop."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server ends it
    with suppress(OSError):  # the server is gone
        try:
            loop = Loop(setup)
        except REFUSALS as mistake:
            connection.send(sentence(mistake))
            return
        connection.send((loop.rate, loop.truth, loop.remark, loop.smoothing))
        connection.send(loop.go(connection.send, lambda: not connection.poll()))


class Run:
    """One run: `start`, then `look` as often as one likes, and `stop`."""

    def __init__(self, setup: Setup) -> None:
        """Make the environment, that of a rig in a process of its own; raises what a `Loop` raises."""
        self._loop = Loop(setup) if setup.rig is None else Apart(setup)
        self.rate = self._loop.rate
        self._patience = UNSEEN if setup.rig is None else UNSEEN_RIG
        self.follower = Follower(self.rate, self._loop.smoothing)
        self._lock, self._stop = Lock(), Event()
        self._rows: list[tuple[float, float, float]] = []
        self._history: list[tuple[float, Array, Array]] = []
        self._pace, self._trouble, self._seen = 1.0, "", time.monotonic()
        self._thread = Thread(target=self._go, daemon=True, name="live view")

    def start(self) -> None:
        """Begin, and return at once."""
        self._thread.start()

    def stop(self) -> None:
        """End the run; the joint is without torque when this returns."""
        self._stop.set()
        if isinstance(self._loop, Apart):
            self._loop.halt()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def running(self) -> bool:
        """Whether it goes on."""
        return self._thread.is_alive()

    def look(self) -> Look:
        """The run as it is now; a run that nobody looks at stops."""
        self._seen = time.monotonic()
        with self._lock:
            rows, history = np.array(self._rows[-round(self.rate) :]).reshape(-1, 3), list(self._history)
            pace, trouble = self._pace, self._trouble
        step = max(1, round(self.rate / FRAMES))
        return Look(
            time=float(rows[-1, 0]) if len(rows) else 0.0,
            pace=pace,
            motion=rows[::-step][::-1],
            identification=_identification(history),
            truth=self._loop.truth,
            running=self.running,
            trouble=trouble,
            remark=self._loop.remark,
            following=self.follower.look(),
        )

    def recording(self, name: str) -> Recording:
        """What has been measured so far.

        Raises:
            RecordingError: if that is too little.
        """
        with self._lock:
            rows = np.array(self._rows).reshape(-1, 3)
        return Recording(name=name, time=rows[:, 0], position=rows[:, 1], torque=rows[:, 2])

    def _go(self) -> None:
        self._trouble = self._loop.go(self._take, self._goes_on)

    def _take(self, part: Slice) -> None:
        with self._lock:
            self._rows += part.rows
            self._pace = part.pace
            if part.entry is not None:
                self._history.append(part.entry)
        self.follower.take(part.rows)

    def _goes_on(self) -> bool:
        return not self._stop.is_set() and time.monotonic() - self._seen <= self._patience


def _entry(info: dict[str, Any]) -> tuple[float, Array, Array]:
    """Time, estimates and standard errors of all schemes (S, P)."""
    found = [info["estimates"][scheme.id] for scheme in SCHEMES]
    theta = np.array([one["theta"] for one in found])
    std = np.array([np.sqrt(np.maximum(np.diag(one["covariance"]), 0.0)) for one in found])
    return float(info["estimates_time"]), theta, std


def _identification(history: list[tuple[float, Array, Array]]) -> Identification | None:
    """The history as an identification has it, so that the same figures show both."""
    if len(history) < 2:
        return None
    time = np.array([entry[0] for entry in history])
    theta, std = (np.array([entry[k] for entry in history]) for k in (1, 2))  # (K, S, P)
    found = {}
    for s, scheme in enumerate(SCHEMES):
        model = Model.build(BASE, theta[-1, s], std[-1, s])
        course = Convergence(time, theta[:, s], std[:, s])
        found[scheme.id] = Identified(scheme.id, model, course, np.nan, scheme.unit, np.nan, (0, 0))
    return Identification(found, (), ())
