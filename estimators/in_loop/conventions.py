"""Decide undeclared conventions of a servo's log: how its controller acts, and how goals change between rows.

All commands for servos with a drive use these recordings, and so the same torque and motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from estimators.findings import Finding, Kind
from estimators.in_loop.controller import read_controller, read_position, with_reading
from estimators.in_loop.goals import make_base, read_goals, with_goals
from estimators.in_loop.rollouts import are_driven, choose_parts
from estimators.regression.least_squares import IdentificationError
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.recording import Recording
from pendulum_env.servo.drive import find_declared_conventions
from pendulum_env.servo.torque import depends_on_past, replace_drive

Recordings = tuple[Recording, ...]


class Conventions(NamedTuple):
    """Fitted and held-out recordings with all conventions decided, and findings on these decisions."""

    recordings: Recordings
    holdout: Recordings
    findings: tuple[Finding, ...]


def decide_conventions(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = (), base: Sequence[Term] = BASE
) -> Conventions:
    """Decide the undeclared conventions of all drives by fits of the base model to the fitted recordings.

    Recordings without a drive stay as they are. The kinds of drives, by controlled quantity and shaft of the encoder,
    are decided separately. A convention that one drive declares, or that is decided, holds for all drives of its kind.
    A kind without fitted recordings is decided by its held-out ones.

    Raises:
        IdentificationError: if the recordings have too little motion.
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
    """Group the indices of recordings by the controlled quantity and the shaft of the encoder.

    Recordings without a drive are another group.
    """
    kinds = [None if r.drive is None else (r.drive.control, r.drive.encoder) for r in recordings]
    return [[k for k, other in enumerate(kinds) if other == kind] for kind in dict.fromkeys(kinds)]


def _decide_together(
    recordings: Sequence[Recording], holdout: Sequence[Recording], base: Sequence[Term]
) -> Conventions:
    """Decide undeclared conventions of drives with the same controlled quantity and shaft of the encoder."""
    parts = tuple(recordings), tuple(holdout)
    if not are_driven(recordings):
        return Conventions(*parts, ())
    base, part = make_base(recordings, base), choose_parts(holdout)[0]
    declared = find_declared_conventions([r.actuator for r in (*recordings, *holdout)])
    recordings, holdout = (_apply_settings(part_recordings, declared) for part_recordings in parts)
    controller = read_controller(recordings, base, part)
    recordings, holdout = (_apply_finding(part_recordings, controller) for part_recordings in (recordings, holdout))
    goals = read_goals(recordings, base, part)
    is_held = goals is None or goals.kind is Kind.GOALS_HELD
    if goals is not None and any(r.drive is not None and r.drive.goal for r in holdout):
        undeclared = tuple(r.name for r in recordings if r.drive is None or not r.drive.goal)
        goals = replace(goals, recordings=undeclared)  # a reading of some recordings is not reversed
    recordings, holdout = (with_goals(part_recordings, is_held) for part_recordings in (recordings, holdout))
    reads = next((r.actuator.reads for r in (*recordings, *holdout) if r.actuator.reads), None)
    recordings, holdout = (with_reading(part_recordings, reads) for part_recordings in (recordings, holdout))
    position = read_position(recordings, base, part)
    if position is not None and position.kind is Kind.POSITION_READ:
        reads = "counts" if ("reads", "counts") in position.pairs else "exact"
        recordings, holdout = (with_reading(part_recordings, reads) for part_recordings in (recordings, holdout))
    findings = tuple(finding for finding in (controller, goals, position) if finding is not None)
    return Conventions(recordings, holdout, findings)


def apply_conventions(recordings: Sequence[Recording], log_format: Mapping[str, Any]) -> Recordings:
    """Apply the log format of a model to recordings, for conventions that no drive declares.

    A convention of the controller that one drive declares holds for all of its kind, see `decide_conventions`.
    """
    applied = list(recordings)
    for numbers in _group_by_loop(recordings):
        own = [recordings[k] for k in numbers]
        settings = {**log_format, **find_declared_conventions([r.actuator for r in own])}
        for k, recording in zip(numbers, _apply_settings(own, settings), strict=True):
            applied[k] = recording
    goal, reads = log_format.get("goal"), log_format.get("reads")
    applied = applied if reads is None else [*with_reading(applied, reads)]
    return tuple(applied) if goal is None else with_goals(applied, goal == "held")


def complete_conventions(recordings: Sequence[Recording], model: Model) -> Recordings:
    """Complete the conventions of recordings by those of a model, and the others as a diagnosis does.

    Goals are held if the joint moves too little for the decision.
    """
    recordings = apply_conventions(recordings, model.log_format)
    try:
        return decide_conventions(recordings).recordings
    except IdentificationError:
        return with_goals(recordings, is_held=True)


def has_open_torque(recordings: Sequence[Recording]) -> bool:
    """Return whether the torque of a recording is that requested by its drive, and depends on conventions."""
    drives = [r.actuator for r in recordings if not r.has_logged_torque]
    return any(depends_on_past(drive) or drive.open_conventions for drive in drives)


def _apply_settings(recordings: Sequence[Recording], settings: Mapping[str, str | None]) -> Recordings:
    """Apply conventions of the controller to recordings; the requested torque is computed again."""
    return tuple(
        r if r.drive is None else replace_drive(r, drive)
        for r in recordings
        for drive in [r.actuator.complete_conventions(settings)]
    )


def _apply_finding(recordings: Sequence[Recording], controller: Finding | None) -> Recordings:
    """Apply the conventions of a finding of `read_controller` to recordings; None has no conventions."""
    return _apply_settings(recordings, {} if controller is None else dict(controller.pairs))
