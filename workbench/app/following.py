"""What is said of a run while it runs: whether its model still predicts, and which effect it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np

from estimators.online import Diagnoser, OnlineDiagnosis, Verdict, Watch
from estimators.signals.measurements import Smoothing
from pendulum_env.words import listing, name

Row = tuple[float, float, float]  # time [s], position [rad], torque from then on [N m]


@dataclass(frozen=True)
class Event:
    """Something that happened at a time [s]; `alarm` if the model was found wrong."""

    time: float
    text: str
    alarm: bool


class Follower:
    """Follows a run by its rows, wherever the loop runs: a motor does not wait for what is computed here.

    Attributes:
        course: time [s] and evidence that something is missing [nat], once a second of motion.
        events: alarms, and what was added or taken out.
    """

    def __init__(self, rate: float, smoothing: Smoothing) -> None:
        """Take the samples per second [Hz], and the smoothing of the measurement."""
        self._rate, self._smoothing, self._lock = rate, smoothing, Lock()
        self._diagnoser = Diagnoser(rate, smoothing=smoothing)
        (self._monitor,) = self._diagnoser.each
        self.course: list[tuple[float, float]] = []
        self.events: list[Event] = []
        self._time, self._torque = 0.0, 0.0  # the latest ones
        self._renew()

    def _renew(self) -> None:
        """Watch the running model as it is from now on."""
        self._watch = Watch(self._rate, self._monitor.terms, smoothing=self._smoothing)
        self._kind, self._missing = "calibrating", False

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
                if said is not before:
                    self._tell(said)
                if verdict.kind != self._kind:
                    self._warn(verdict)

    def _note(self, text: str, alarm: bool) -> None:
        self.events.append(Event(self._time, text, alarm))

    def _tell(self, said: OnlineDiagnosis) -> None:
        if np.isfinite(said.evidence):
            self.course.append((self._time, said.evidence))
        missing = said.kind == "missing"
        if missing and not self._missing:
            self._note(f"missing: {listing([name(id) for id in said.group], 'or')}", True)
        self._missing = missing

    def _warn(self, verdict: Verdict) -> None:
        self._kind = verdict.kind
        if verdict.kind == "value":
            self._note(f"value changed: {name(verdict.parameter)}", True)
        elif verdict.kind == "structure":
            self._note("structure changed", True)

    def add(self, effect: str) -> None:
        """Take an effect into the model.

        Raises:
            ValueError: if there is none of that id, or it cannot be added.
        """
        with self._lock:
            self._monitor.add(effect)
            self._note(f"added: {name(effect)}", False)
            self._renew()

    def undo(self) -> None:
        """Take out what was added last.

        Raises:
            ValueError: if nothing was.
        """
        with self._lock:
            last = self._monitor.said.added[-1:]
            self._monitor.undo()
            self._note(f"taken out: {name(last[0])}", False)
            self._renew()
