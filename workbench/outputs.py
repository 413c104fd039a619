"""Files that a command writes."""

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from estimators.checks.remedies import WrongColumn
from estimators.findings import Finding
from pendulum_env._typing import JSON
from pendulum_env.files import check_output, format_json, write_whole
from pendulum_env.formatting import format_estimate, join_words
from pendulum_env.physics import Model
from workbench.errors import InputError
from workbench.narrator.findings import advise_inertia, describe
from workbench.terminal import STANDARD_OUTPUT, Terminal


def check_outputs(outputs: Sequence[str | None], inputs: Sequence[str] = ()) -> None:
    """Check output paths before the work begins.

    Raises InputError if an output is `-`, is named twice, or is an input, and OSError if it cannot be written.
    `STANDARD_OUTPUT` is not checked.
    """
    if "-" in outputs:
        raise InputError("results are written to files: give a name such as result.json instead of '-'")
    paths = [check_output(path) for path in outputs if path is not None and path != STANDARD_OUTPUT]
    resolved = [os.path.realpath(path) for path in paths]  # Path.resolve fails on cyclic links
    for path, place in zip(paths, resolved, strict=True):
        if place in map(os.path.realpath, inputs):
            raise InputError(f"{path}: is one of the inputs: name another file to write to")
        if resolved.count(place) > 1:
            raise InputError(f"{path}: is named for two outputs: name two files")


def write_model(model: Model, path: str | None, findings: Sequence[Finding] = ()) -> str | None:
    """Write a model to a path, if given; return the path.

    Raises InputError for a model without positive inertia, unless its inertia is unknown and no finding calls it
    negative.
    """
    inertia = model.estimates.get("inertia")
    turned = next((finding for finding in findings if isinstance(finding, WrongColumn) and finding.inertia), None)
    if path is not None and inertia is not None and (model.lacks_inertia or (turned and inertia.value <= 0)):
        remark = " (the earlier file stays)" if Path(path).is_file() else ""
        value = f"{format_estimate(inertia.value, inertia.std)} {inertia.unit}"
        reason = describe(turned) if turned else f"The inertia came out as {value}. {advise_inertia()}"
        raise InputError(f"{path} is not written{remark}. {reason}")
    if path is not None:
        model.save(path)
    return path


def write_json(path: str | None, content: JSON) -> None:
    """Write data as JSON, if a path is given, or to standard output."""
    if path == STANDARD_OUTPUT:
        print(format_json(content).rstrip("\n"), file=sys.stdout)
    elif path is not None:
        write_whole(path, format_json(content))


def write_page(path: str | None, terminal: Terminal, page: str, *results: Any) -> None:
    """Write a page, if a path is given; `page`: its function as "module:name", imported here because Plotly is slow."""
    if path is not None:
        module, _, name = page.partition(":")
        render = getattr(import_module(module), name)
        with terminal.progress("writing the report"):
            write_whole(path, render(*results))


def report_files(paths: Sequence[str | Path | None], terminal: Terminal) -> None:
    """Print the names of the files that were written."""
    names = [str(path) for path in paths if path not in (None, STANDARD_OUTPUT)]
    if names:
        terminal.print(f"\nwrote {join_words(names)}")
