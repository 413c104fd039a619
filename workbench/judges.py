"""The online diagnosis beside a run, which goes on until a verdict stands; for a motor in a process of its own."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from estimators.online import Diagnoser, OnlineDiagnosis
from estimators.signals.measurements import Smoothing
from pendulum_env.backends.hardware.process import restore_priority
from pendulum_env.formatting import join_words
from workbench.narrator.effects import name_effect
from workbench.processes import TaskEnd, Worker, attend

Sample = tuple[float, float, float]  # time [s], position [rad], torque over the period that ends with it [N m]


class OnlineJudge:
    """Diagnoses sample by sample, as the run waits; a verdict stands once its first effect has led for a while."""

    steady = 2.0  # [s]

    def __init__(self, rate: float, smoothing: Smoothing) -> None:
        """Take the samples per second [Hz], and the smoothing of the measurement."""
        self._diagnoser = Diagnoser(rate, smoothing=smoothing)
        self._leader, self._since = "", np.inf  # effect, and time since when it leads [s]

    def has_verdict(self, info: dict[str, Any]) -> bool:
        """Take in a sample; whether a verdict stands."""
        return self.take([(info["time"], info["position"], info["torque"])])

    def take(self, samples: Sequence[Sample]) -> bool:
        """Take in samples; whether a verdict stands."""
        for time, position, torque in samples:
            (found,) = self._diagnoser.take(*(np.array([value]) for value in (time, position, torque)))
            leader = found.group[0] if found.kind == "missing" else ""
            if leader != self._leader:
                self._leader, self._since = leader, time if leader else np.inf
        return bool(samples and time - self._since >= self.steady)

    def close(self) -> OnlineDiagnosis:
        """Return the final diagnosis."""
        return self._diagnoser.diagnoses[0]


class ProcessJudge:
    """Diagnoses in a process of its own: a motor does not wait for a grid that is refined."""

    together = 50  # samples that are sent at once
    ready = 60.0  # [s] in which the process has to be there

    def __init__(self, rate: float, smoothing: Smoothing) -> None:
        """Start the process; takes what `Here` does.

        Raises OSError if it does not come up.
        """
        self._worker = Worker("diagnosis")
        self._worker.send(partial(_diagnose_samples, rate, smoothing))
        if not self._worker.connection.poll(self.ready) or isinstance(self._worker.hear(), TaskEnd):
            self._worker.end()
            raise OSError("the process that diagnoses did not start: try again on a machine that does less")
        self._waiting: list[Sample] = []
        self._stands = False

    def has_verdict(self, info: dict[str, Any]) -> bool:
        """Take in a sample; whether a verdict stood some samples ago."""
        self._waiting.append((info["time"], info["position"], info["torque"]))
        if len(self._waiting) >= self.together and not self._stands:
            self._worker.send(self._waiting)
            self._waiting = []
            while self._worker.connection.poll():
                self._stands = self._worker.hear() is True or self._stands
        return self._stands

    def close(self) -> OnlineDiagnosis:
        """Return the final diagnosis after all samples.

        Raises OSError if the process has died.
        """
        if not self._stands:
            self._worker.send(self._waiting)
        self._worker.send(None)
        while not isinstance(word := self._worker.hear(), TaskEnd):
            pass
        self._worker.end()
        if word.why:
            raise OSError(f"what was measured has no verdict: {word.why}")
        found: OnlineDiagnosis = word.came
        return found


def _diagnose_samples(rate: float, smoothing: Smoothing, connection: Connection[Any, Any]) -> OnlineDiagnosis:
    attend()
    restore_priority()  # a motor's loop, which began this, may be more urgent
    judge = OnlineJudge(rate, smoothing)
    connection.send(False)
    while (samples := connection.recv()) is not None:
        connection.send(judge.take(samples))
    return judge.close()


def describe_verdict(found: OnlineDiagnosis, stands: bool) -> str:
    """Describe the verdict, and list the effects that were not tried."""
    after = f"after {found.motion:.1f} s of motion"
    if found.kind == "calibrating":
        return "too short for a verdict: record some seconds more of motion"
    verdict = f"no effect is significant {after}"
    if found.kind == "missing":
        standing = "the verdict stands" if stands else "the verdict does not stand yet"
        verdict = f"missing: {join_words([name_effect(id) for id in found.group], 'or')} ({standing}, {after})"
    elif found.kind == "changed":
        verdict = f"changed during the run: {join_words([name_effect(id) for id in found.changed], 'and')} ({after})"
    if not found.not_run:
        return verdict
    others = join_words([name_effect(id) for id in found.not_run], "and")
    return f"{verdict}\nnot tried online (run `diagnose` on the recording): {others}"
