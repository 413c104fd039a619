"""A pendulum, simulated or real, that runs in real time while the six schemes estimate its parameters.

Meanwhile it is followed: whether the model still predicts, and which effect it lacks (`following`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Lock, Thread
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.pilot import Pilot
from estimators.schemes.identification import Convergence, Identification, Identified
from estimators.schemes.six import SCHEMES
from estimators.signals.measurements import Smoothing
from estimators.wrappers import EstimateParameters
from estimators.wrappers.options import smoothing_of
from pendulum_env._typing import Array
from pendulum_env.backends.hardware.config import load
from pendulum_env.backends.hardware.drive import DriveError
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.excitation import Excitation
from pendulum_env.interface import MAX_TORQUE
from pendulum_env.physics import BASE, Model
from pendulum_env.policy import transitions
from pendulum_env.recording import Recording
from pendulum_env.registration import PENDULUM
from workbench.app.following import Follower, Following
from workbench.app.torques import LEARNT, torque_of
from workbench.mistakes import MISTAKES, InputError, sentence
from workbench.processes import LOST, Done, Failed, Worker
from workbench.rig import controller, cut_at

RATE = 500.0  # [Hz]
LONGEST = 120.0  # [s] of a run
SLICE = 0.02  # [s] of the run between two looks at the clock
LOOK = 0.1  # [s] between two entries of the history
FRAMES = 50  # samples of the motion that the page draws between two looks
UNSEEN = 8.0  # [s] after which a run that no page asks about stops
UNSEEN_RIG = 3.0  # [s], of a motor that nobody watches
GRACE = 2.5  # [s] in which a motor has to be let go of, once that was asked for, and again before it is ended
LOST_RIG = "the program that ran the motor ended unexpectedly: the drive's watchdog has taken its torque away"
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
        begun: what it told first.
        running: whether it goes on.
        trouble: why it ended, if it should not have.
        following: what is said of its model.
    """

    time: float
    pace: float
    motion: Array
    identification: Identification | None
    begun: Begun
    running: bool
    trouble: str
    following: Following


@dataclass(frozen=True)
class Begun:
    """What a run tells first."""

    rate: float  # samples per second [Hz]
    smoothing: Smoothing
    truth: dict[str, float]  # parameters of the simulated plant, by name; empty where nobody knows them
    remark: str  # what else is to be known of it


class Slice(NamedTuple):
    """What a run measured since it told last."""

    rows: list[tuple[float, float, float]]  # time [s], position [rad], torque [N m]
    entry: tuple[float, Array, Array] | None  # time, theta and standard errors of the schemes (S, P), now and then
    pace: float


def go(setup: Setup, connection: Connection[Any, Any]) -> str:
    """Go through a run, in a process of its own as a motor cannot wait for a server that draws.

    Whatever comes from the server, its end included, is the word to stop. Returns the fault that ended it, if one did.

    Raises:
        InputError: if the run cannot be, as its settings are unknown or out of range, or the rig is out of reach.
    """
    try:
        rig = None if setup.rig is None else load(setup.rig)
        command = _command(setup, RATE if rig is None else rig.rate)
        env = _environment(setup, command)
    except REFUSALS as mistake:
        raise InputError(sentence(mistake)) from None
    with closing(env):
        bare: Any = env.unwrapped
        rate = float(bare.rate)
        plant: Model | None = bare.model if getattr(bare, "simulated", False) else None
        truth = {name: e.value for name, e in plant.estimates.items()} if plant is not None else {}
        remark = "" if rig is None else cut_at(rig, command)
        connection.send(Begun(rate, smoothing_of(env, rate), truth, remark))
        try:
            return _told(transitions(env, controller(command, rate), setup.seed), setup.seconds, rate, connection)
        except REFUSALS as mistake:
            return sentence(mistake)


def _told(steps: Iterable[Any], seconds: float, rate: float, connection: Connection[Any, Any]) -> str:
    """Tell of a run's steps slice by slice, not faster than real time; returns the fault that ended it, if any."""
    began, due, rows, pace = time.monotonic(), LOOK, [], 1.0
    info: dict[str, Any] = {}
    for number, (row, info) in enumerate(steps, 1):
        rows += [row] if row is not None else []
        now = float(info["time"])
        if number % max(1, round(SLICE * rate)) and now < seconds:
            continue
        passed = time.monotonic() - began
        pace = min(1.0, now / passed)
        entry = _entry(info) if now >= due and info["estimates_time"] > SETTLED else None
        connection.send(Slice(rows, entry, pace))
        rows, due = [], now + LOOK if now >= due else due
        time.sleep(max(0.0, now - passed))
        if now >= seconds or connection.poll():
            break
    connection.send(Slice(rows, None, pace))
    return str(info.get("fault", ""))


def _command(setup: Setup, rate: float) -> Excitation | Pilot:
    """What chooses the torque, at so many samples per second [Hz]."""
    if setup.recording is not None and setup.excitation in LEARNT:
        raise ValueError("a replay does not follow a policy: choose another backend, or any signal")
    return torque_of(setup.excitation, np.random.default_rng(setup.seed), setup.seconds, setup.amplitude, rate)


def _environment(setup: Setup, command: Excitation | Pilot) -> gym.Env[Any, Any]:
    """The environment with its estimates; a rig is owned and connected from now on, and has no power."""
    options: dict[str, Any] = {"effects": list(setup.effects)}
    if setup.recording is not None:
        options = {"recording": setup.recording}
    elif setup.rig is not None:
        options = {"config": setup.rig}
    env = gym.make(
        PENDULUM,
        max_episode_steps=-1,
        backend=setup.backend,
        rate=RATE,
        torque_noise=0.0 if setup.recording is not None else TORQUE_NOISE,
        max_torque=max(MAX_TORQUE, command.amplitude),
        **options,
    )
    try:
        return EstimateParameters(env)
    except ValueError:
        env.close()
        raise


class Run:
    """One run in a process of its own: it begins at once; `look` as often as one likes, and `stop`."""

    def __init__(self, setup: Setup, worker: Worker) -> None:
        """Give it to a worker, and wait for its environment.

        Raises:
            InputError: if it cannot be, as its settings are unknown or out of range, or the rig is out of reach.
        """
        self._worker, self._lock, self._stop = worker, Lock(), Event()
        worker.begin(partial(go, setup))
        begun = worker.hear()
        if isinstance(begun, Failed):
            worker.end()
            raise InputError(begun.why)
        self._begun: Begun = begun
        self.rate = begun.rate
        self._lost, self._patience = (LOST, UNSEEN) if setup.rig is None else (LOST_RIG, UNSEEN_RIG)
        self.follower = Follower(self.rate, begun.smoothing)
        self._rows: list[tuple[float, float, float]] = []
        self._history: list[tuple[float, Array, Array]] = []
        self._pace, self._trouble, self._seen = 1.0, "", time.monotonic()
        self._measured: SimpleQueue[list[tuple[float, float, float]] | None] = SimpleQueue()
        Thread(target=self._follow, daemon=True, name="following").start()
        self._thread = Thread(target=self._listen, daemon=True, name="live view")
        self._thread.start()

    def stop(self) -> None:
        """End the run; the joint is without torque when this returns."""
        self._stop.set()
        self._worker.send(None)  # at once: what was measured may still be looked at
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
            begun=self._begun,
            running=self.running,
            trouble=trouble,
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

    def _listen(self) -> None:
        """Take in what the process tells, until it has ended: it may drive a motor."""
        connection, until, word = self._worker.connection, np.inf, None
        try:
            while not isinstance(word, Done | Failed) and time.monotonic() < until:
                if until == np.inf and (self._stop.is_set() or time.monotonic() - self._seen > self._patience):
                    until = time.monotonic() + GRACE
                    self._worker.send(None)
                if connection.poll(SLICE) and isinstance(word := self._worker.hear(), Slice):
                    self._take(word)
        finally:
            self._measured.put(None)
            self._worker.send(None)
            self._worker.end(GRACE)  # in which the rig takes the torque away
        if isinstance(word, Done):
            self._trouble = word.result
        elif until == np.inf:
            self._trouble = self._lost

    def _take(self, part: Slice) -> None:
        with self._lock:
            self._rows += part.rows
            self._pace = part.pace
            if part.entry is not None:
                self._history.append(part.entry)
        self._measured.put(part.rows)

    def _follow(self) -> None:
        """Let the follower take in what is measured, which may take longer than measuring: no motor waits for it."""
        while (rows := self._measured.get()) is not None:
            self.follower.take(rows)


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
