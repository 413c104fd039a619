"""Time between torque and motion of several recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.checks.alignment import Alignment, TorqueTiming
from estimators.checks.channel import estimate_alignments
from estimators.decisions.criterion import Criterion
from pendulum_env.physics import Term
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class Timing:
    """Time between torque and motion of each recording, by which late or filtered torque is corrected.

    `str(timing)` has a sentence for each finding.

    Attributes:
        alignments: of each recording.
        names: of the recordings.
        logged: recordings before the correction; empty in a result.
    """

    alignments: tuple[Alignment, ...] = ()
    names: tuple[str, ...] = ()
    logged: tuple[Recording, ...] = ()

    @classmethod
    def from_recordings(
        cls, logged: Sequence[Recording], terms: Sequence[Term], criterion: Criterion, is_model: bool = False
    ) -> Timing:
        """Estimate the timing of recordings under some terms, see `estimate_alignments`."""
        alignments = tuple(estimate_alignments(logged, terms, criterion, is_model))
        return cls(alignments, tuple(recording.name for recording in logged), tuple(logged))

    def reduce_delays(self, joint: str, dead_time: float, std: float) -> Timing:
        """Return the timing with the delay of late torque at a joint shorter by a dead time [s], see `reduce_delay`."""
        laws = (
            law.reduce_delay(dead_time, std) if law.is_late and law.joint == joint else law for law in self.alignments
        )
        return replace(self, alignments=tuple(laws))

    @cached_property
    def recordings(self) -> tuple[Recording, ...]:
        """Return the recordings with corrected torque; none in a result, which lacks the logged ones."""
        if not self.logged:
            return ()
        return tuple(law.apply(recording) for law, recording in zip(self.alignments, self.logged, strict=True))

    @property
    def findings(self) -> tuple[TorqueTiming, ...]:
        """Return findings on corrected torque, and on torque that acts late."""
        return (*self.corrections, *self.find(is_late=False))

    def __str__(self) -> str:
        return "\n".join(map(str, self.findings)) or "Torque and motion are in time."

    def select(self, numbers: Sequence[int]) -> Timing:
        """Return the timing of some recordings, numbered from 0; unchanged without alignments."""
        if not self.alignments:
            return self
        return replace(
            self, alignments=tuple(self.alignments[k] for k in numbers), names=tuple(self.names[k] for k in numbers)
        )

    @property
    def has_moved(self) -> bool:
        """Return whether the torque of a recording was logged late, and so corrected."""
        return any(alignment.is_late for alignment in self.alignments)

    @property
    def has_delay(self) -> bool:
        """Return whether the torque of a recording was logged late or filtered, other than by half a sample."""
        return any(alignment.is_late and not alignment.is_half_sample for alignment in self.alignments)

    def count_parameters(self) -> int:
        """Count the delays and lags of torque that was logged late or filtered, other than by half a sample."""
        laws = {law.channel for law in self.alignments if law.is_late and not law.is_half_sample}
        return sum((law.delay != 0) + (law.lag != 0) for law in laws)

    def is_late_at(self, joint: str) -> bool:
        """Return whether a delay of the log was corrected at a joint and at no other."""
        return any(law.delay > 0 and law.is_late and law.joint == joint for law in self.alignments)

    def agrees(self, other: Timing) -> bool:
        """Return whether another timing has the same alignments, within the errors of this one; unknown ones agree."""
        return all(
            np.isinf(alignment.delay_std)
            or (
                alignment.is_late == counterpart.is_late
                and alignment.agrees(replace(counterpart, delay_std=0.0, lag_std=0.0))
            )
            for alignment, counterpart in zip(self.alignments, other.alignments, strict=True)
        )

    def contradicts(self, other: Timing) -> bool:
        """Return whether torque is late or acts late by this timing, and is not late or late by another one."""
        pairs = zip(self.alignments, other.alignments, strict=True)
        return any(law.is_found and law.is_late != counterpart.is_late for law, counterpart in pairs)

    @property
    def corrections(self) -> list[TorqueTiming]:
        """Findings on torque that was logged late and is corrected."""
        return [replace(finding, is_corrected=True) for finding in self.find(is_late=True)]

    def find(self, is_late: bool) -> tuple[TorqueTiming, ...]:
        """Return findings on torque that is logged late if `is_late`, else on torque that acts late.

        Findings name their recordings, unless all recordings share one alignment.
        """
        findings, names = list[TorqueTiming](), list[list[str]]()
        for name, alignment in zip(self.names, self.alignments, strict=True):
            if alignment.is_late != is_late or (finding := alignment.finding) is None:
                continue
            if finding not in findings:
                findings.append(finding)
                names.append([])
            names[findings.index(finding)].append(name)
        if all(alignment is self.alignments[0] for alignment in self.alignments):
            return tuple(findings)
        pairs = zip(findings, names, strict=True)
        return tuple(replace(finding, recordings=tuple(own_names)) for finding, own_names in pairs)
