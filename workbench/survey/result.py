"""Files with the result of one recording of a survey, see `diagnose_source`."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from pendulum_env._typing import JSON
from pendulum_env.files import write_whole
from pendulum_env.reading import Unreadable, convert, read_json

Finite = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]


class _Parameter(Struct):
    """Estimate of a parameter; without a value if it is unknown."""

    value: Finite | None
    std: Finite | None
    unit: str


class _Row(Struct):
    """Row of a joint."""

    joint: str
    effects: str
    selected: list[str]
    unexplained: bool
    biased: bool
    error_before: Finite | None
    error_after: Finite | None
    noise_floor: Finite | None
    error_unit: str
    position_rms_before: Finite | None
    position_rms_after: Finite | None
    parameters: dict[str, Any]  # of each, as `_Parameter`


class _Result(Struct):
    """Content of a file."""

    start: Finite | None
    rows: Annotated[list[_Row], Meta(min_length=1)]


def write_result(file: Path, result: JSON) -> None:
    """Write a result, whole or not at all; raise OSError if it cannot be written."""
    write_whole(file, json.dumps(result))


def read_result(file: Path) -> JSON | None:
    """Read a result; None if there is none, or it is damaged."""
    try:
        content: JSON = read_json(file, "a result of `survey`")
        for row in convert(content, _Result).rows:
            for name, own in row.parameters.items():
                convert(own, _Parameter, name)
    except Unreadable:
        return None
    return content
