"""Diagnosis of one recording of a survey: settings, rows of the table, and the result file."""

import hashlib
import json
import os
import warnings
from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path

from estimators import Diagnosis, diagnose
from estimators.diagnosis.small_effect import SmallEffect
from pendulum_env._typing import JSON
from pendulum_env.errors import format_error
from pendulum_env.physics.plugin import describe_fault, load_plugin
from pendulum_env.quantity import get_finite
from pendulum_env.recording import Source
from workbench.cli import find_version
from workbench.errors import USER_ERRORS, InputError, format_mistake
from workbench.inputs import open_sources
from workbench.narrator.diagnosis import get_error_unit
from workbench.terminal import Terminal

ASKED = ("only", "without", "fixed", "bounds")  # options passed on to `diagnose`
READING = ("columns", "unwrap", "drive", "joints", "rotors", "no_gravity")
NAMED = ("robot", "model")  # options that name files


def read_result(file: Path) -> JSON | None:
    """Read a result of `diagnose_source` from a file; None if it is missing or damaged."""
    try:
        result = json.loads(file.read_bytes())
        return result if result["rows"] else None
    except (OSError, ValueError, TypeError, KeyError):
        return None


@dataclass(frozen=True)
class Settings:
    """Settings of the diagnoses of a survey."""

    options: Namespace  # options of `diagnose`
    plugins: tuple[str, ...]  # files with the user's effects
    mark: str  # hash of options, file contents and version

    @classmethod
    def from_arguments(cls, arguments: Namespace) -> "Settings":
        """Create the settings from the options of `survey`."""
        options = {name: getattr(arguments, name) for name in (*ASKED, *READING)}
        files = {name: os.path.abspath(path) if (path := getattr(arguments, name)) else None for name in NAMED}
        plugins = tuple(os.path.abspath(path) for path in arguments.plugin or ())
        content = [hash_content(Path(path)) for path in (*files.values(), *plugins) if path]
        mark = hashlib.sha256(repr((find_version(), options, content)).encode()).hexdigest()
        return cls(Namespace(**options, **files, recordings=[]), plugins, mark)

    def make_key(self, source: Source, content: str | None) -> str:
        """Hash the settings, the content of the file, and its reading options."""
        settings_text = repr((self.mark, content, replace(source, file=Path())))
        return hashlib.sha256(settings_text.encode()).hexdigest()[:32]


def hash_content(file: Path) -> str | None:
    """Hash the content of a file; None if it cannot be read."""
    if not file.is_file():  # reading a pipe would block
        return None
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return None


def diagnose_source(source: Source, settings: Settings) -> JSON:
    """Diagnose one recording; it is fitted, also if a study holds it out.

    The result has `start`, the absolute time of the first sample [s since 1970] or None, and `rows`, see `make_rows`.
    Without a diagnosis, it has only `error`, the reason.
    """
    try:
        for path in settings.plugins:
            load_plugin(Path(path))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _diagnose(source, settings.options)
    except Exception as error:  # a bug met in one recording must not stop the survey
        return {"error": describe_error(error, source)}


def describe_error(error: Exception, source: Source) -> str:
    """Format an error as one sentence without the name of the file."""
    error = error if isinstance(error, USER_ERRORS) else describe_fault(error) or InputError(format_error(error))
    return format_mistake(error).removeprefix(f"{source.file}: ")


def _diagnose(source: Source, options: Namespace) -> JSON:
    terminal = Terminal(quiet=True)
    opened = open_sources(options, (replace(source, role="fit"),), terminal)
    data = opened.calibrate(terminal)
    diagnosis = diagnose(
        data.recordings, data.holdout, opened.model.terms, **{name: getattr(options, name) for name in ASKED}
    )
    date = opened.recordings[0].start_date
    return {"start": None if date is None else date.timestamp(), "rows": make_rows(diagnosis)}


def make_rows(diagnosis: Diagnosis) -> list[JSON]:
    """Make a row for each joint of a diagnosis; a pendulum has one unnamed joint."""
    first, last = (step.errors["holdout"] for step in (diagnosis.steps[0], diagnosis.steps[-1]))
    joints, rows = tuple(diagnosis.floors), []
    estimates = [(*_split_joint(name, joints), estimate) for name, estimate in diagnosis.model.readable.items()]
    groups = [(_split_joint(group[0], joints)[0], group) for group in diagnosis.effects]
    small = [_split_joint(found.effect, joints) for found in diagnosis.findings if isinstance(found, SmallEffect)]
    for joint in joints:
        parameters = {name: estimate for at, name, estimate in estimates if at == joint}
        effects = [[_split_joint(effect, (joint,))[1] for effect in group] for at, group in groups if at == joint]
        rows.append(
            {
                "joint": joint,
                "effects": ", ".join(" or ".join(group) for group in effects),
                "selected": sorted(group[0] for group in effects),
                "small_effects": ", ".join(effect for at, effect in small if at == joint),
                "unexplained": any(region.at == joint for region in diagnosis.unexplained),
                "biased": any(parameter.is_biased for parameter in parameters.values()),
                "error_before": get_finite(first.get_joint_error(joint)),
                "error_after": get_finite(last.get_joint_error(joint)),
                "noise_floor": get_finite(diagnosis.floors[joint]),
                "error_unit": get_error_unit(diagnosis, joint),
                "position_rms_before": get_finite(first.position_rms),
                "position_rms_after": get_finite(last.position_rms),
                "parameters": {
                    name: {
                        "value": None if parameter.is_unknown else get_finite(parameter.value),
                        "std": None if parameter.is_unknown else get_finite(parameter.std),
                        "unit": parameter.unit,
                    }
                    for name, parameter in parameters.items()
                },
            }
        )
    return rows


def _split_joint(name: str, joints: tuple[str, ...]) -> tuple[str, str]:
    """Split `stribeck@elbow.velocity` into joint and `stribeck.velocity`; use the first of two joints."""
    _, _, place = name.partition("@")
    matching = [joint for joint in joints if place == joint or place.startswith((f"{joint}.", f"{joint},"))]
    joint = max(matching, key=len, default=joints[0])
    return joint, name.replace(f"@{joint}", "", 1)
