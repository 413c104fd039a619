"""Find the layout of a text file: header, delimiter and start of the data."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from pendulum_env.errors import RecordingError
from pendulum_env.reading import quote_value
from pendulum_env.recording.expression import normalise_name
from pendulum_env.recording.vocabulary import HEADER, UNITS

EMPTY = ["", "NA", "N/A", "NULL", "null", "None", "-", "#N/A", "#DIV/0!"]  # cells without a value
HEAD = 1 << 16  # [bytes], start of a file with header and first rows
LINE = re.compile(rb"[^\r\n]*(?:\r\n|\n|\r|\Z)")
NUMBER = re.compile(
    r"\s*+[+-]?(?:(?:\d++\.?\d*+|\.\d++)(?:e[+-]?\d++)?|nan|inf(?:inity)?)?\s*+", re.IGNORECASE | re.ASCII
)
NAME_COLUMNS = (
    "put a line above that names the {} columns of {} with their units, such as "
    f"{HEADER} (in s, rad, N m) or time_ms,angle_deg,current_mA,pwm"
)


@dataclass(frozen=True)
class Layout:
    """Layout of a text file, from its first lines."""

    headers: tuple[str, ...]
    delimiter: str  # one of , ; tab space
    decimal: str  # . or ,
    offset: int  # bytes before the first data row
    first_cells: tuple[str, ...]  # first non-empty cell of each column


def can_be_number(cell: str, header: str) -> bool:
    """Return whether a column may have numbers, by its first cell; False for an empty column without a name."""
    return bool(NUMBER.fullmatch(cell.replace(",", "."))) if cell else bool(header.strip())


@lru_cache(maxsize=2)  # each joint of an arm reads its columns of the same file
def find_layout(head: bytes) -> Layout:
    """Find the layout of a text from its first bytes, with a preamble above and units below the header."""
    if not head.strip():
        raise RecordingError("the file is empty: record it again")
    lines = [(match.end(), _decode_line(match.group()).strip("\r\n")) for match in LINE.finditer(head)]
    content = [number for number, (_, line) in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    if not content:
        raise RecordingError(f"there are comments but no header {HEADER} and no data: record it again")
    content = content[_count_preamble([lines[number][1] for number in content]) :]
    header_line = content[0]
    line, start, data = lines[header_line][1], lines[header_line][0], content[1:]
    row = lines[content[-2]][1] if len(content) > 2 else line
    width = len(_split_cells(row))
    is_bare = _is_numeric(names := _split_cells(line)) or any("." in cell and NUMBER.fullmatch(cell) for cell in names)
    if is_bare:  # unless the comment above is the header
        comments = [text.lstrip(" #") for _, text in lines[:header_line] if text.strip()] or [""]
        line, start, data = comments[-1], lines[header_line - 1][0], content
    is_sentence = width > 2 and _is_numeric(_split_cells(row)) and not re.search(r"[,;\t]", line)
    if (is_bare or is_sentence) and width not in (len(_split_cells(line)), len(line.split())):
        raise RecordingError(f"the file has no header: {NAME_COLUMNS.format(width, quote_value(row.strip(), 40))}")
    delimiter = _find_delimiter(line)
    headers = _split_cells(re.sub(r"^%\s*", "", line))  # a comment of MATLAB, as of a KUKA log
    if data and _are_units(units := _split_cells(lines[data[0]][1], delimiter), headers):
        headers = [
            f"{name} [{unit.strip(' []()')}]" if unit.strip(" []()-") else name
            for name, unit in zip(headers, units, strict=True)
        ]
        start, data = lines[data[0]][0], data[1:]
    rows = [_split_cells(lines[number][1], delimiter) for number in data[:-1]]  # the last line may be incomplete
    if count := _count_metadata(rows):
        start, data, rows = lines[data[count - 1]][0], data[count:], rows[count:]
    samples = [lines[number][1] for number in data]
    if rows and {len(row) for row in rows} == {width := len(rows[0])}:
        if width == len(headers) + 1 and not any(row[-1].strip() for row in rows):
            headers = [*headers, ""]  # a delimiter ends every row
        elif len(_trim_header(headers)) <= width < len(headers):
            headers = headers[:width]
    numbers = [cell for row in rows for cell in row if NUMBER.fullmatch(cell.replace(",", ".", 1))]
    has_decimal_comma = any("," in cell for cell in numbers) and not any("." in cell for cell in numbers)
    first_cells = _collect_first_cells(samples, delimiter, len(headers))
    return Layout(_number_repeated(headers), delimiter, "," if has_decimal_comma else ".", start, first_cells)


def _number_repeated(headers: Sequence[str]) -> tuple[str, ...]:
    """Number repeated names, so that names are unique."""
    names = [header.strip() for header in headers]
    return tuple(
        f"{name} ({names[: k + 1].count(name)})" if name and names.count(name) > 1 else headers[k]
        for k, name in enumerate(names)
    )


def _trim_header(cells: list[str]) -> list[str]:
    """Remove cells at the end of a header that rows may lack: empty cells and LabVIEW's comment."""
    while cells and cells[-1].strip().lower() in ("", "comment"):
        cells = cells[:-1]
    return cells


def _collect_first_cells(lines: Sequence[str], delimiter: str, width: int) -> tuple[str, ...]:
    """Return the first non-empty cell of each column, or an empty text."""
    first_cells = [""] * width
    for line in lines:
        for k, cell in enumerate(_split_cells(line, delimiter)[:width]):
            first_cells[k] = first_cells[k] or cell.strip()
        if all(first_cells):
            break
    return tuple(first_cells)


def _count_preamble(content: list[str]) -> int:
    """Count the lines above the header, which have fewer cells than columns."""
    if len(content) < 3:
        return 0
    probe = content[-2]  # the last line may be incomplete
    delimiter, width = _find_delimiter(probe), len(_split_cells(probe))
    rows = [_split_cells(line, delimiter) for line in content]
    names = [number for number, cells in enumerate(rows) if len(cells) == width > 1 and _are_names(cells)]
    if names:
        return names[0]
    trimmed, width = [_trim_header(cells) for cells in rows], len(_trim_header(rows[-2]))
    trimmed_names = [number for number, cells in enumerate(trimmed) if len(cells) == width > 1 and _are_names(cells)]
    return trimmed_names[-1] if trimmed_names else 0


def _count_metadata(rows: Sequence[list[str]]) -> int:
    """Count the rows above the data that describe the columns: words in the first column, which has numbers below."""
    first_cells = [row[0].strip() if row else "" for row in rows]
    if len(rows) < 2 or not _is_numeric(first_cells[-1:]):
        return 0
    return next(number for number, cell in enumerate(first_cells) if cell in EMPTY or _is_numeric([cell]))


def _are_names(cells: list[str]) -> bool:
    return all(cell.strip() and not NUMBER.fullmatch(cell) for cell in cells)


def _are_units(cells: list[str], headers: list[str]) -> bool:
    """Return whether a row has units: at least one known unit, and no numbers."""
    if len(cells) != len(headers) or any(NUMBER.fullmatch(cell) for cell in cells if cell.strip()):
        return False
    known_units = {unit for units in UNITS.values() for unit in units}
    return any(normalise_name(cell) in known_units for cell in cells)


def _decode_line(line: bytes) -> str:
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("latin-1")  # degree sign of older Windows programs


def _find_delimiter(line: str) -> str:
    """Return the delimiter of a line, which may have decimal commas."""
    delimiter = max(";\t", key=line.count)
    if line.count(delimiter) and line.count(delimiter) >= line.count(",") - 1:
        return delimiter
    return "," if "," in line else " "


def _split_cells(line: str, delimiter: str | None = None) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter or _find_delimiter(line)), [])
    except csv.Error as error:
        raise RecordingError(f"the header cannot be understood ({error}): put {HEADER} there") from None


def _is_numeric(cells: list[str]) -> bool:
    return any(cell.strip() for cell in cells) and all(NUMBER.fullmatch(cell.replace(",", ".")) for cell in cells)
