"""What the path of a recording tells: `arm3/elbow/2026-03-01.csv` is of a robot, a joint and a date."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import PurePosixPath
from string import Formatter

from pendulum_env.lookup import find
from pendulum_env.recording.storage import READERS
from workbench.mistakes import InputError

LABELS = ("robot", "joint", "kind", "date")
MOST_STARS = 4  # of which each makes a path that does not match a hundred times as long to try
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
    """What a pattern such as `{robot}/{joint}_{date}` takes from a path; `*` stands for anything but a slash.

    Raises:
        InputError: if the pattern makes no sense, or the path does not match it.
    """
    if pattern.count("*") > MOST_STARS:
        raise InputError(f"{pattern}: a pattern of names has at most {MOST_STARS} stars, not {pattern.count('*')}")
    expression = "(?:.*/)?"
    try:
        for plain, word, *_ in Formatter().parse(pattern):
            expression += re.escape(plain).replace(r"\*", "[^/]*")
            if word is not None:
                find("part of a name", word, dict.fromkeys(LABELS))
                expression += f"(?P<{word}>[^/]+?)"
        match = re.fullmatch(expression, str(path.parent / _stem(path)))
    except (ValueError, re.error) as error:
        raise InputError(f"{pattern}: {error}: write names as {{robot}}/{{joint}}_{{date}}, or use a table") from None
    if match is None:
        raise InputError(f"{path}: does not read as {pattern}: mend --names, or use a table")
    return match.groupdict()


def _stem(path: PurePosixPath) -> str:
    ending = next((ending for ending in READERS if path.name.lower().endswith(ending)), path.suffix)
    return path.name[: len(path.name) - len(ending)]
