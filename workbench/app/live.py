"""A pendulum, simulated or real, that runs in real time while the six schemes estimate its parameters.

Meanwhile it is followed: whether the model still predicts, and which effect it lacks.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from threading import Event as Signal
from threading import Lock, Thread
from typing import Any, NamedTuple

import numpy as np

from estimators.online import Diagnoser, OnlineDiagnosis, Watch
from estimators.schemes.fitting import Convergence, Identified
from estimators.schemes.identification import Identification
from estimators.schemes.six import SCHEMES
from estimators.signals.measurements import Smoothing
from estimators.wrappers import EstimateParameters
from estimators.wrappers.options import smoothing_of
from pendulum_env._typing import Array
from pendulum_env.backends.hardware.drive import DriveError
from pendulum_env.physics import BASE, Model
from pendulum_env.policy import transitions
from pendulum_env.recording import Recording
from pendulum_env.words import listing, name
from workbench.cli import parse
from workbench.mistakes import MISTAKES, InputError, sentence
from workbench.processes import LOST, End, Worker
from workbench.runs import Plan

SLICE = 0.02  # [s] of the run between two looks at the clock
LOOK = 0.1  # [s] between two entries of the history
FRAMES = 50  # samples of the motion that the page draws between two looks
UNSEEN = 8.0  # [s] after which a run that no page asks about stops
UNSEEN_RIG = 3.0  # [s], of a motor that nobody watches
GRACE = 2.5  # [s] in which a motor has to be let go of, once that was asked for, and again before it is ended
LOST_RIG = "the program that ran the motor ended unexpectedly: the drive's watchdog has taken its torque away"
SETTLED = 0.5  # [s] from the start, before which standard errors mean nothing

Row = tuple[float, float, float]  # time [s], position [rad], torque from then on [N m]
Entry = tuple[float, Array, Array]  # time [s], theta and standard errors of the schemes (S, P)


@dataclass(frozen=True)
class Begun:
    """What a run tells first."""

    rate: float  # samples per second [Hz]
    smoothing: Smoothing
    truth: dict[str, float]  # parameters of the simulated plant, by name; empty where nobody knows them
    is_rig: bool
    remark: str  # what else is to be known of it


class Slice(NamedTuple):
    """What a run measured since it told last."""

    rows: list[Row]
    entry: Entry | None  # now and then
    pace: float


def go(options: Sequence[str], connection: Connection[Any, Any]) -> str:
    """Go through a run, in a process of its own as a motor cannot wait for a server that draws.

    `options` are those of `pendulum-ident record`. Whatever comes from the server, its end included, is the word to
    stop. Returns the fault that ended it, if one did.

    Raises InputError if the run cannot be, as its settings are unknown or out of range, or the rig is out of reach.
    """
    arguments = parse(["record", *options, "--output=live.csv"])
    try:
        run = Plan.of(arguments, np.random.default_rng(arguments.seed))
        with closing(run.environment()) as bare:
            env = EstimateParameters(bare)
            plant: Any = bare.unwrapped
            rate = plant.rate  # a replay has its own
            truth = {name: e.value for name, e in plant.model.estimates.items()} if plant.simulated else {}
            connection.send(Begun(rate, smoothing_of(env, rate), truth, run.rig is not None, run.remark))
            return _told(transitions(env, run.controller(rate), arguments.seed), run.seconds, rate, connection)
    except (*MISTAKES, ValueError, DriveError) as mistake:
        raise InputError(sentence(mistake)) from None


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


def _entry(info: dict[str, Any]) -> Entry:
    """Time, estimates and standard errors of all schemes (S, P)."""
    found = [info["estimates"][scheme.id] for scheme in SCHEMES]
    theta = np.array([one["theta"] for one in found])
    std = np.array([np.sqrt(np.maximum(np.diag(one["covariance"]), 0.0)) for one in found])
    return float(info["estimates_time"]), theta, std


@dataclass(frozen=True)
class Event:
    """Something that happened at a time [s]; `alarm` if the model was found wrong."""

    time: float
    text: str
    alarm: bool


class Follower:
    """Follows a run by its rows: a motor does not wait for what is computed here."""

    def __init__(self, rate: float, smoothing: Smoothing) -> None:
        """Take the samples per second [Hz], and the smoothing of the measurement."""
        self._rate, self._smoothing, self._lock = rate, smoothing, Lock()
        self._diagnoser = Diagnoser(rate, smoothing=smoothing)
        (self._monitor,) = self._diagnoser.each
        self.course: list[tuple[float, float]] = []  # time [s] and evidence [nat], once a second of motion
        self.events: list[Event] = []  # alarms, and what was added or taken out
        self._time, self._torque = 0.0, 0.0  # the latest ones
        self._renew()

    def _renew(self) -> None:
        """Watch the running model as it is from now on."""
        self._watch = Watch(self._rate, self._monitor.terms, smoothing=self._smoothing)
        self._kind = "calibrating"  # of its last verdict

    @property
    def said(self) -> OnlineDiagnosis:
        """Which effect is missing."""
        return self._monitor.said

    def take(self, rows: Sequence[Row]) -> None:
        """Take in what was measured since the last time."""
        with self._lock:
            for time, position, torque in rows:
                sample = [np.array([value]) for value in (time, position, self._torque)]
                before = self._monitor.said
                (said,), (verdict,) = self._diagnoser.take(*sample), self._watch.take(*sample)
                self._time, self._torque = time, torque
                if said is not before and np.isfinite(said.evidence):
                    self.course.append((time, said.evidence))
                if said.kind == "missing" and before.kind != "missing":
                    self._note(f"missing: {listing([name(id) for id in said.group], 'or')}", True)
                if verdict.kind != self._kind and verdict.kind == "value":
                    self._note(f"value changed: {name(verdict.parameter)}", True)
                elif verdict.kind != self._kind and verdict.kind == "structure":
                    self._note("structure changed", True)
                self._kind = verdict.kind

    def _note(self, text: str, alarm: bool) -> None:
        self.events.append(Event(self._time, text, alarm))

    def add(self, effect: str) -> None:
        """Take an effect into the model; raises ValueError if there is none of that id, or it cannot be added."""
        with self._lock:
            self._monitor.add(effect)
            self._note(f"added: {name(effect)}", False)
            self._renew()

    def undo(self) -> None:
        """Take out what was added last; raises ValueError if nothing was."""
        with self._lock:
            last = self._monitor.said.added[-1:]
            self._monitor.undo()
            self._note(f"taken out: {name(last[0])}", False)
            self._renew()


class Run:
    """One run in a process of its own, which begins at once."""

    def __init__(self, options: Sequence[str], worker: Worker) -> None:
        """Give a worker the options of `pendulum-ident record`, and wait for the environment.

        Raises InputError if it cannot be, as its settings are unknown or out of range, or the rig is out of reach.
        """
        self._worker, self._stop = worker, Signal()
        worker.send(partial(go, options))
        begun = worker.hear()
        if isinstance(begun, End):
            worker.end()
            raise InputError(begun.why)
        self.begun: Begun = begun  # what it told first
        self.follower = Follower(begun.rate, begun.smoothing)  # says what its model lacks
        self.rows: list[Row] = []  # what it has measured
        self.pace, self.trouble = 1.0, ""  # seconds of the run in one second; why it ended, if it should not have
        self._history: list[Entry] = []
        self._followed, self._following = 0, Lock()
        self.watch()
        self._thread = Thread(target=self._listen, daemon=True, name="live view")
        self._thread.start()

    def stop(self) -> None:
        """End the run; the joint is without torque when this returns."""
        self._stop.set()
        self._worker.send(None)  # at once: what was measured may still be looked at
        self._thread.join()

    def watch(self) -> None:
        """Note that somebody looks; a run that nobody looks at stops."""
        self._seen = time.monotonic()

    def follow(self) -> None:
        """Let the follower take in what is measured, which may take longer than measuring: no motor waits for it."""
        if self._following.acquire(blocking=False):  # else another thread is at it
            try:
                rows = self.rows[self._followed :]
                self._followed += len(rows)
                self.follower.take(rows)
            finally:
                self._following.release()

    @property
    def running(self) -> bool:
        """Whether it goes on."""
        return self._thread.is_alive()

    @property
    def time(self) -> float:
        """How far it is [s]."""
        return self.rows[-1][0] if self.rows else 0.0

    @property
    def motion(self) -> Array:
        """Time [s], position [rad] and torque [N m] of the last second (K, 3)."""
        rows = np.array(self.rows[-round(self.begun.rate) :]).reshape(-1, 3)
        return rows[:: -max(1, round(self.begun.rate / FRAMES))][::-1]

    @property
    def identification(self) -> Identification | None:
        """Estimates of the schemes and how they came about, as figures show them; None before anything is known."""
        history = self._history[:]
        if len(history) < 2:
            return None
        times, theta, std = (np.array([entry[k] for entry in history]) for k in range(3))  # (K,), twice (K, S, P)
        found = {}
        for s, scheme in enumerate(SCHEMES):
            model = Model.build(BASE, theta[-1, s], std[-1, s])
            course = Convergence(times, theta[:, s], std[:, s])
            found[scheme.id] = Identified(scheme.id, model, course, np.nan, scheme.unit, np.nan, (0, 0))
        return Identification(found, (), ())

    def recording(self, name: str) -> Recording:
        """What has been measured so far; raises RecordingError if that is too little."""
        rows = np.array(self.rows).reshape(-1, 3)
        return Recording(name=name, time=rows[:, 0], position=rows[:, 1], torque=rows[:, 2])

    def _listen(self) -> None:
        """Take in what the process tells, until it has ended: it may drive a motor."""
        connection, until, word = self._worker.connection, np.inf, None
        patience = UNSEEN_RIG if self.begun.is_rig else UNSEEN
        try:
            while not isinstance(word, End) and time.monotonic() < until:
                if until == np.inf and (self._stop.is_set() or time.monotonic() - self._seen > patience):
                    until = time.monotonic() + GRACE
                    self._worker.send(None)
                if connection.poll(SLICE) and isinstance(word := self._worker.hear(), Slice):
                    self.rows += word.rows
                    self.pace = word.pace
                    self._history += [word.entry] if word.entry is not None else []
        finally:
            self._worker.send(None)
            self._worker.end(GRACE)  # in which the rig takes the torque away
        if isinstance(word, End) and word.why != LOST:
            self.trouble = word.why or word.came
        elif until == np.inf:
            self.trouble = LOST_RIG if self.begun.is_rig else LOST
