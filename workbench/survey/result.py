"""Files with the result of one recording of a survey, see `diagnose_source`."""

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from pendulum_env._typing import JSON
from pendulum_env.errors import FileError
from pendulum_env.reading import read_bytes


class _Parameter(Struct):
    """Estimate of a parameter; without a value if it is unknown."""

    value: float | None
    std: float | None
    unit: str


class _Row(Struct):
    """Row of a joint."""

    joint: str
    effects: str
    selected: list[str]
    unexplained: bool
    biased: bool
    error_before: float | None
    error_after: float | None
    noise_floor: float | None
    error_unit: str
    position_rms_before: float | None
    position_rms_after: float | None
    parameters: dict[str, _Parameter]


class _Result(Struct):
    """Content of a file."""

    start: float | None
    rows: Annotated[list[_Row], Meta(min_length=1)]


def read_result(file: Path) -> JSON | None:
    """Read a result; None if there is none, or it is damaged."""
    try:
        content: JSON = msgspec.to_builtins(msgspec.json.decode(read_bytes(file), type=_Result))
    except (FileError, msgspec.MsgspecError):
        return None
    return content
