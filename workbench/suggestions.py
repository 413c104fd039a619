"""Read the experiment that a diagnosis suggests."""

from typing import Any

from msgspec import Struct

from estimators.diagnosis.result import SCHEMA
from estimators.diagnosis.suggestion import Suggestion
from pendulum_env.errors import FileError
from pendulum_env.reading import Text, convert, read_json
from workbench.errors import InputError


class _Diagnosis(Struct):
    """Next experiment in a diagnosis file."""

    suggestion: dict[str, Any] | None = None
    forbidden: Text | None = None
    inseparable: list[list[Text]] | None = None


def read_suggestion(path: str) -> Suggestion:
    """Read the experiment that a diagnosis suggests.

    Raises InputError if the file is missing or no diagnosis, or nothing is open that an experiment would settle.
    """
    hint = "a diagnosis is what `diagnose --json` writes"
    content = read_json(path, hint)
    if not isinstance(content, dict) or content.get("schema") not in (SCHEMA, "pendulum-ident/diagnosis@1"):
        raise InputError(f"{path}: is not a diagnosis; {hint}")
    try:
        data = convert(content, _Diagnosis)
        if data.suggestion is not None:
            return Suggestion.from_json(data.suggestion, "suggestion")
    except FileError as error:
        raise InputError(f"{path}: {error}") from None
    if data.forbidden is not None:
        raise InputError(f"{path}: {data.forbidden}")
    why = f", and no torque tells {' from '.join(data.inseparable[0])}" if data.inseparable else ""
    raise InputError(f"{path}: this diagnosis leaves nothing open that an experiment would settle{why}")
