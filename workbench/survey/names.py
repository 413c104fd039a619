"""What the path of a recording tells: `arm3/elbow/2026-03-01.csv` is of a robot, a joint and a date."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from functools import cache
from pathlib import PurePosixPath

from pendulum_env.lookup import find
from pendulum_env.recording.storage import READERS
from workbench.mistakes import InputError

LABELS = ("robot", "joint", "kind", "date")
WILD = 4  # words and stars between slashes, which take a power of the length of a name to try
DATE = re.compile(r"(?<!\d)\d{4}(-?)\d\d\1\d\d(?:[T_ -]\d\d[-:h]?\d\d(?:[-:m]?\d\d)?)?(?!\d)")


def date_of(text: str) -> datetime | None:
    """A date, UTC unless it says otherwise; None if the text is none."""
    try:
        if DATE.fullmatch(text):
            return datetime.strptime(re.sub(r"\D", "", text).ljust(14, "0"), "%Y%m%d%H%M%S").replace(tzinfo=UTC)
        date = datetime.fromisoformat(text)
        return date.astimezone(UTC) if date.tzinfo else date.replace(tzinfo=UTC)
    except (ValueError, OverflowError):  # of the 31st of February
        return None


def guessed(path: PurePosixPath) -> dict[str, str]:
    """Robot, joint and date: folders name robot and joint, or the file the joint of a folder that is a date."""
    stem = _stem(path)
    folders = [part for part in path.parts[:-1] if part != ".."]
    plain = [part for part in folders if date_of(part) is None]
    dates = [match[0] for part in (stem, *reversed(folders)) if (match := DATE.search(part)) and date_of(match[0])]
    names_joint = not plain or (len(plain) < len(folders) and DATE.search(stem) is None)
    words = ["", *plain, *[DATE.sub("", stem).strip(" _-.") or stem] * names_joint]
    return {"robot": words[-2], "joint": words[-1]} | ({"date": dates[0]} if dates else {})


def matched(path: PurePosixPath, pattern: str) -> dict[str, str]:
    """What a pattern such as `{robot}/{joint}_{date}` takes from a path.

    Raises:
        InputError: if the pattern makes no sense, or the path does not match it.
    """
    match = _expression(pattern).fullmatch(str(path.parent / _stem(path)))
    if match is None:
        raise InputError(f"{path}: does not read as {pattern}: mend --names, or use a table")
    return match.groupdict()


@cache
def _expression(pattern: str) -> re.Pattern[str]:
    try:
        folders = (f"(?>{_folder(folder)}(?=/|\\Z))" for folder in pattern.split("/"))  # each is tried by itself
        return re.compile("(?:.*/)?" + "/".join(folders))
    except (ValueError, re.error) as error:
        raise InputError(f"{pattern}: {error}: write names as {{robot}}/{{joint}}_{{date}}, or use a table") from None


def _folder(pattern: str) -> str:
    parts = re.split(r"(\{\w*\}|\*+)", pattern)
    if len(parts) // 2 > WILD:
        raise InputError(f"holds more than {WILD} words and * between slashes")
    for part in parts[1::2]:
        if part[0] == "{":
            find("part of a name", part[1:-1], dict.fromkeys(LABELS))
    wild = [f"(?P<{part[1:-1]}>[^/]+?)" if part[0] == "{" else "[^/]*" for part in parts[1::2]]
    plain = map(re.escape, parts[::2])
    return next(plain) + "".join(a + b for a, b in zip(wild, plain, strict=True))


def _stem(path: PurePosixPath) -> str:
    ending = next((ending for ending in READERS if path.name.lower().endswith(ending)), path.suffix)
    return path.name[: len(path.name) - len(ending)]
