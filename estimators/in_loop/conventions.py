"""Decide the conventions that a log of a servo leaves open: how its controller acts, and how goals run between rows.

Every command that uses a described servo takes its recordings from here, so that all have the same torque and motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from estimators.findings import Finding, Kind
from estimators.in_loop.controller import read_controller
from estimators.in_loop.goals import make_base, read_goals, with_goals
from estimators.in_loop.rollouts import are_driven, choose_parts
from estimators.regression.least_squares import IdentificationError
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.recording import Recording
from pendulum_env.servo.drive import find_declared_conventions
from pendulum_env.servo.torque import depends_on_past, replace_drive

Recordings = tuple[Recording, ...]


class Conventions(NamedTuple):
    """Recordings to fit and to hold out whose drives leave nothing open, and findings on what was decided."""

    recordings: Recordings
    holdout: Recordings
    findings: tuple[Finding, ...]


def decide_conventions(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = (), base: Sequence[Term] = BASE
) -> Conventions:
    """Decide once, by the base model and the fitted recordings, what the drives of all recordings leave open.

    Recordings without a drive stay as they are. Position control, velocity control and each shaft of the encoder are
    decided apart. A convention that one drive declares, or that is decided, holds for all others of its kind. A kind
    without fitted recordings is decided by its held-out ones.

    Raises:
        IdentificationError: if there is too little motion.
        RecordingError: if the drives of one kind cannot be simulated together.
    """
    every, count = [*recordings, *holdout], len(recordings)
    findings: list[Finding] = []
    for numbers in _group_by_loop(every):
        deciding = [k for k in numbers if k < count] or numbers
        others = [k for k in numbers if k not in deciding]
        decided = _decide_together([every[k] for k in deciding], [every[k] for k in others], base)
        for k, recording in zip((*deciding, *others), (*decided.recordings, *decided.holdout), strict=True):
            every[k] = recording
        is_alone = deciding == list(range(count))
        names = tuple(every[k].name for k in deciding)
        findings += [one if is_alone or one.recordings else replace(one, recordings=names) for one in decided.findings]
    return Conventions(tuple(every[:count]), tuple(every[count:]), tuple(findings))


def _group_by_loop(recordings: Sequence[Recording]) -> list[list[int]]:
    """Return the indices of the recordings whose drives control the same quantity with encoders at the same shaft.

    Recordings without a drive are one more group.
    """
    kinds = [None if r.drive is None else (r.drive.control, r.drive.encoder) for r in recordings]
    return [[k for k, other in enumerate(kinds) if other == kind] for kind in dict.fromkeys(kinds)]


def _decide_together(
    recordings: Sequence[Recording], holdout: Sequence[Recording], base: Sequence[Term]
) -> Conventions:
    """Decide what drives leave open that control the same quantity and have their encoders at the same shaft."""
    parts = tuple(recordings), tuple(holdout)
    if not are_driven(recordings):
        return Conventions(*parts, ())
    base, part = make_base(recordings, base), choose_parts(holdout)[0]
    declared = find_declared_conventions([r.actuator for r in (*recordings, *holdout)])
    recordings, holdout = (_apply_settings(part_recordings, declared) for part_recordings in parts)
    opened = recordings, holdout
    controller = read_controller(recordings, base, part)
    recordings, holdout = (_apply_finding(part_recordings, controller) for part_recordings in opened)
    goals = read_goals(recordings, base, part)
    is_held = goals is None or goals.kind is Kind.GOALS_HELD
    if controller is not None and not is_held:  # was read with held goals, whose error hides that of a controller
        controller = read_controller(with_goals(opened[0], is_held), base, part)
        recordings, holdout = (_apply_finding(part_recordings, controller) for part_recordings in opened)
    if goals is not None and any(r.drive is not None and r.drive.goal for r in holdout):
        undeclared = tuple(r.name for r in recordings if r.drive is None or not r.drive.goal)
        goals = replace(goals, recordings=undeclared)  # a reading of some recordings is not reversed
    findings = tuple(finding for finding in (controller, goals) if finding is not None)
    return Conventions(with_goals(recordings, is_held), with_goals(holdout, is_held), findings)


def apply_conventions(recordings: Sequence[Recording], log_format: Mapping[str, str]) -> Recordings:
    """Return the recordings with the conventions of the log format of a model, where all their drives leave them open.

    The convention of a controller that one drive declares holds for all others of its kind, see `decide_conventions`.
    """
    applied = list(recordings)
    for numbers in _group_by_loop(recordings):
        own = [recordings[k] for k in numbers]
        settings = {**log_format, **find_declared_conventions([r.actuator for r in own])}
        for k, recording in zip(numbers, _apply_settings(own, settings), strict=True):
            applied[k] = recording
    goal = log_format.get("goal")
    return tuple(applied) if goal is None else with_goals(applied, goal == "held")


def complete_conventions(recordings: Sequence[Recording], model: Model) -> Recordings:
    """Return the recordings with the conventions of a model, or else those that a diagnosis would find.

    Goals of a joint that moves too little for the decision are held.
    """
    recordings = apply_conventions(recordings, model.log_format)
    try:
        return decide_conventions(recordings).recordings
    except IdentificationError:
        return with_goals(recordings, is_held=True)


def has_open_torque(recordings: Sequence[Recording]) -> bool:
    """Return whether the torque of a recording is what its drive asked for, and depends on conventions."""
    drives = [r.actuator for r in recordings if not r.has_logged_torque]
    return any(depends_on_past(drive) or drive.open_conventions for drive in drives)


def _apply_settings(recordings: Sequence[Recording], settings: Mapping[str, str | None]) -> Recordings:
    """Return the recordings with conventions of the controller, and the torque that their drives ask for then."""
    return tuple(
        r if r.drive is None else replace_drive(r, drive)
        for r in recordings
        for drive in [r.actuator.complete_conventions(settings)]
    )


def _apply_finding(recordings: Sequence[Recording], controller: Finding | None) -> Recordings:
    """Return the recordings with the conventions of a finding of `read_controller`, if there is one."""
    return _apply_settings(recordings, {} if controller is None else dict(controller.pairs))
