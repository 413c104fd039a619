"""CSV, plain or gzipped, read in blocks so that only the columns in need are ever held."""

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv

from pendulum_env._typing import Array
from pendulum_env.recording.columns import HEADER, Column, find_columns
from pendulum_env.recording.record import RecordingError
from pendulum_env.recording.table import Named, Table, gather, one_line

HEAD = 1 << 16  # bytes in which header and delimiter must show themselves
BLOCK = 1 << 20  # bytes parsed at a time
LINE = re.compile(rb"[^\r\n]*(?:\r\n|\n|\r|\Z)")
NUMBER = re.compile(r"\s*[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|nan|inf(?:inity)?)?\s*", re.IGNORECASE | re.ASCII)


@dataclass(frozen=True)
class Layout:
    """How a text file is laid out, as told by its first lines."""

    headers: tuple[str, ...]
    delimiter: str  # one of , ; tab space
    decimal: str  # . or ,
    offset: int  # bytes before the first data row


def read_csv(path: Path, named: Named = None) -> Table:
    """The columns in need, with empty cells as NaN.

    Comment lines (#) at the top are passed over; if no header follows, the last of them may be it, as written by
    `numpy.savetxt`. Delimiters are comma, semicolon, tab or a single space; with a delimiter other than comma, numbers
    may have a decimal comma.

    Raises:
        RecordingError: if there is no header, a column is missing, or a cell is not a number.
    """
    with _open(path) as stream:
        layout = _layout(stream.read(HEAD))
    columns = find_columns(layout.headers, named)
    try:
        return gather(columns, _blocks(path, layout, [column.index for column in columns.values()]))
    except pa.ArrowInvalid as error:
        if "Empty CSV file" in str(error):
            raise RecordingError("there is a header but no data: record it again") from None
        raise RecordingError(
            _complaint(path, layout, columns) or f"{one_line(error)}: repair or export again"
        ) from None


def _blocks(path: Path, layout: Layout, wanted: list[int]) -> Iterator[list[Array]]:
    names = [str(index) for index in range(len(layout.headers))]  # the file's own may repeat
    kept = [names[index] for index in wanted]
    with _open(path) as stream:
        stream.read(layout.offset)
        reader = pacsv.open_csv(
            stream,
            read_options=pacsv.ReadOptions(column_names=names, block_size=BLOCK),
            parse_options=pacsv.ParseOptions(delimiter=layout.delimiter),
            convert_options=pacsv.ConvertOptions(
                include_columns=kept,
                column_types=dict.fromkeys(kept, pa.float64()),
                null_values=[""],
                decimal_point=layout.decimal,
            ),
        )
        for batch in reader:
            yield [column.to_numpy(zero_copy_only=False) for column in batch.columns]


def _open(path: Path) -> pa.NativeFile:
    return pa.input_stream(str(path), compression="gzip" if path.name.lower().endswith(".gz") else None)


def _layout(head: bytes) -> Layout:
    if not head.strip():
        raise RecordingError("the file is empty: record it again")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise RecordingError("the text is UTF-16: save it as UTF-8")
    if head.startswith(b"\x1f\x8b"):
        raise RecordingError("it is gzipped: let its name end in .csv.gz")
    lines = [(match.end(), _decoded(match.group()).strip("\r\n")) for match in LINE.finditer(head)]
    content = [number for number, (_, line) in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    if not content:
        raise RecordingError(f"there are comments but no header {HEADER} and no data: record it again")
    first = content[0]
    line, start = lines[first][1], lines[first][0]
    if _is_numeric(_cells(line)):  # no header, unless the comment above is one
        comments = [text.lstrip(" #") for _, text in lines[:first] if text.strip()]
        if not comments or len(_cells(comments[-1])) != len(_cells(line)):
            raise RecordingError(f"the first row holds numbers instead of column names: put the header {HEADER} above")
        line, start = comments[-1], lines[first - 1][0]
    delimiter = _delimiter(line)
    samples = [lines[number][1] for number in content[1:]]
    comma = delimiter != "," and any("," in text for text in samples) and not any("." in text for text in samples)
    return Layout(tuple(_cells(line)), delimiter, "," if comma else ".", start)


def _decoded(line: bytes) -> str:
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("latin-1")  # has the degree sign of older Windows programs


def _delimiter(line: str) -> str:
    return max(",;\t", key=line.count) if re.search(r"[,;\t]", line) else " "


def _cells(line: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=_delimiter(line)), [])
    except csv.Error as error:
        raise RecordingError(f"the header cannot be understood ({error}): put {HEADER} there") from None


def _is_numeric(cells: list[str]) -> bool:
    return any(cell.strip() for cell in cells) and all(NUMBER.fullmatch(cell.replace(",", ".")) for cell in cells)


def _complaint(path: Path, layout: Layout, columns: dict[str, Column]) -> str | None:
    """What the fast reader stumbled over, found again by reading line by line; None if this reader finds nothing."""
    with _open(path) as stream:
        stream.read(layout.offset)
        text = io.TextIOWrapper(io.BufferedReader(stream), "utf-8", errors="replace", newline="")
        try:
            rows = (cells for cells in csv.reader(text, delimiter=layout.delimiter) if cells)
            for row, cells in enumerate(rows, start=1):
                where = f"data row {row} (header not counted)"
                if len(cells) != len(layout.headers):
                    remedy = "separate cells by commas" if layout.delimiter == " " else "repair or remove that row"
                    return f"{where} has {len(cells)} cells where the header has {len(layout.headers)}: {remedy}"
                for column in columns.values():
                    cell = cells[column.index]
                    if not NUMBER.fullmatch(cell.replace(layout.decimal, ".")):
                        shown = repr(cell if len(cell) <= 40 else cell[:37] + "...")
                        return f"{where} has {shown} as {column.quantity}, not a number: repair or remove that row"
        except csv.Error as error:
            return f"the text cannot be split into cells ({one_line(error)}): write plain comma-separated numbers"
    return None
