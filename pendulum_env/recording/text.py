"""Text, plain or gzipped, and sheets of Excel: read in blocks so that only the columns in need are ever held."""

import csv
import io
import re
import zipfile
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv

from pendulum_env._typing import Array
from pendulum_env.reading import blocks, refuse_archive, refuse_size
from pendulum_env.recording.columns import Column, find_columns
from pendulum_env.recording.expression import letters
from pendulum_env.recording.record import RecordingError
from pendulum_env.recording.table import LARGEST, REMEDY, Find, Table, gather, need, one_line, since
from pendulum_env.recording.vocabulary import HEADER, UNITS

HEAD = 1 << 16  # bytes in which header and delimiter must show themselves
BLOCK = 1 << 20  # bytes parsed at a time
LONG = f"a line is longer than {BLOCK} characters: write one line for each sample"
TAG = re.compile(rb"(</table:table-row|</table:table|<table:table-row|<table:(?:covered-)?table-cell)(?=[\s/>])[^>]*>")
TIMES = re.compile(rb'table:number-(?:rows|columns)-repeated="(\d{1,18})"')
LONGEST_TAG = 4096  # bytes
CELL = re.compile(rb"""\br\s*=\s*["']([A-Z]{1,3})(\d{1,7})["']""")  # where a cell of a sheet stands: r="B7"
SHARED = re.compile(  # of a cell whose text stands elsewhere, and its number where the cell holds it and nothing else
    rb"""\bt\s*=\s*["']s["']"""
    rb"""(?:(?:\s+\w+\s*=\s*"[^"<>]{0,99}"){0,3}\s*>\s*<(?:\w+:)?v>(\d{1,9})</(?:\w+:)?v>\s*</(?:\w+:)?c>)?"""
)
PLAIN = re.compile(  # a tag that no reader takes for another
    rb"""</?(?:[\w.-]+:)?[\w.-]+(?:\s+[\w:.-]+\s*=\s*(?:"[^"<>]*"|'[^'<>]*'))*\s*/?>"""
)
DECLARATION = re.compile(rb"""(?:\xef\xbb\xbf)?<\?xml[^<>]*\?>""")
TEXT = re.compile(
    rb"<(/?)(?:[\w.-]+:)?(si|t)(?=[\s/>])[^>]*?(/?)>"
)  # a text that cells share, and what is written in it
CELL_BYTES = 32  # of a cell in memory
LINE = re.compile(rb"[^\r\n]*(?:\r\n|\n|\r|\Z)")
NUMBER = re.compile(r"\s*[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|nan|inf(?:inity)?)?\s*", re.IGNORECASE | re.ASCII)


STAMP = re.compile(r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d{1,9})?)?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?\s*")


@dataclass(frozen=True)
class Layout:
    """How a text file is laid out, as told by its first lines."""

    headers: tuple[str, ...]
    delimiter: str  # one of , ; tab space
    decimal: str  # . or ,
    offset: int  # bytes before the first data row
    first: tuple[str, ...]  # cells of the first data row


Opened = Callable[[], pa.NativeFile]  # the text, from its beginning


def read_csv(path: Path, find: Find = find_columns, largest: float = LARGEST) -> Table:
    """The columns in need, with empty cells as NaN.

    Comment lines (#) and lines of fewer cells at the top are passed over; if no header follows, the last comment may
    be it, as written by `numpy.savetxt`. A row of units may stand below the header. Delimiters are comma, semicolon,
    tab or a single space; with a delimiter other than comma, numbers may have a decimal comma. Time may be ISO 8601:
    then it is counted from the first row.

    Raises:
        RecordingError: if there is no header, a column is missing, or a cell is not a number.
        Unreadable: if it holds more than `largest` bytes, as text or as numbers.
    """
    if not path.name.lower().endswith(".gz"):
        return read_text(lambda: pa.input_stream(str(path)), find, largest)
    return read_text(
        lambda: pa.PythonFile(_UpTo(pa.input_stream(str(path), compression="gzip"), largest)), find, largest
    )


def read_excel(path: Path, find: Find = find_columns, largest: float = LARGEST) -> Table:
    """The first sheet of a workbook that is not empty, read as the text of its cells.

    Raises:
        RecordingError: as `read_csv`, or if python-calamine is not installed.
    """
    need("python_calamine")
    from python_calamine import CalamineWorkbook

    if zipfile.is_zipfile(path):
        refuse_archive(path, largest, REMEDY)
        _refuse_spread(path, largest)
    book = CalamineWorkbook.from_path(path)
    rows = next((rows for name in book.sheet_names if (rows := book.get_sheet_by_name(name).to_python())), [])
    text = io.StringIO()
    csv.writer(text).writerows(
        [cell.isoformat() if hasattr(cell, "isoformat") else cell for cell in row] for row in rows
    )
    content = pa.py_buffer(text.getvalue().encode())
    return read_text(lambda: pa.BufferReader(content), find, largest)


def _refuse_spread(path: Path, largest: float) -> None:
    """Refuse a sheet whose farthest cell is so far that the table up to it fills the memory, were it all empty."""
    with zipfile.ZipFile(path) as archive:
        lengths, longest = _shared_texts(archive)
        for name in archive.namelist():
            if name == "content.xml":  # of OpenDocument
                with archive.open(name) as file:
                    refuse_size(_repeated(blocks(file, 1 << 62)), largest, REMEDY)
            if not name.startswith("xl/worksheets/"):
                continue
            row = column = shared = 0
            with archive.open(name) as file:
                rest, more = b"", True
                while more:
                    block = file.read(BLOCK)
                    more, block = bool(block), rest + block
                    end = max(0, len(block) - LONGEST_TAG) if more else len(block)
                    for place, digits in CELL.findall(block):
                        row = max(row, int(digits))
                        column = max(column, sum((c - 64) * 26**k for k, c in enumerate(reversed(place))))
                    for cell in SHARED.finditer(block):
                        if cell.start() < end:  # and else in the next block
                            index = int(cell[1] or -1)
                            shared += lengths[index] if 0 <= index < len(lengths) else longest
                    rest = block[end:]
            refuse_size(CELL_BYTES * row * column + shared, largest, REMEDY)


def _shared_texts(archive: zipfile.ZipFile) -> "tuple[array[int], int]":
    """Bytes of the texts that cells of a workbook of Excel share, and of the longest; each cell becomes a copy of one.

    Where the texts are written such that another reader may number them otherwise, as with comments, all are one.
    """
    lengths, whole, plain = array("Q"), 0, True
    for number, info in enumerate(
        info for info in archive.infolist() if info.filename.lower() == "xl/sharedstrings.xml"
    ):
        plain = plain and number == 0
        read, begun, written, rest = 0, -1, False, b""  # bytes before the block, where a text began
        with archive.open(info) as file:
            while block := file.read(BLOCK):
                whole += len(block)
                block = rest + block
                if not read and (declaration := DECLARATION.match(block)):
                    block, read = block[declaration.end() :], declaration.end()
                end = block.rfind(b"<")
                if end < 0 or block.find(b">", end) >= 0:
                    end = len(block)
                plain = plain and len(block) - end < LONGEST_TAG
                plain = plain and block.count(b"<", 0, end) == sum(1 for _ in PLAIN.finditer(block, 0, end))
                for tag in TEXT.finditer(block, 0, end) if plain else ():
                    closes, name, empty = tag.groups()
                    if name == b"t":
                        written = True
                    elif closes and begun >= 0 and written:
                        lengths.append(read + tag.start() - begun)
                        begun = -1
                    elif closes or empty or begun >= 0:
                        plain = False
                        break
                    else:
                        begun, written = read + tag.end(), False
                read, rest = read + end, block[end:] if plain else b""
        plain = plain and begun < 0
    return (lengths, max(lengths, default=0)) if plain else (array("Q"), whole)


def _repeated(content: Iterator[bytes]) -> int:
    """Bytes of a sheet of OpenDocument: its cells up to the last row and column with a value, and texts that repeat."""
    row = rows = place = column = columns = texts = begun = ended = 0
    repeats, copies, valued, rest = 1, 1, False, b""
    for block in content:
        block, end = rest + block, 0
        for tag in TAG.finditer(block):
            texts += (begun + tag.start() - ended) * (copies - 1)
            end, copies = tag.end(), 1
            ended = begun + end
            times = TIMES.search(tag[0])
            number = min(int(times[1]), 10**9) if times is not None else 1
            if tag[1] == b"</table:table":  # the next sheet begins anew
                row = 0
            elif tag[1] == b"</table:table-row":
                row += repeats
                if valued:
                    rows, columns = max(rows, row), max(columns, column)
            elif tag[1] == b"<table:table-row":
                repeats, valued, place, column = number, False, 0, 0
            else:
                place += number
                if b"office:value-type" in tag[0]:
                    valued, column, copies = True, place, number * repeats
        end = max(end, len(block) - LONGEST_TAG)
        begun, rest = begun + end, block[end:]
    return CELL_BYTES * rows * columns + texts


def read_text(opened: Opened, find: Find, largest: float = LARGEST) -> Table:
    """The columns in need of a text, see `read_csv`."""
    with opened() as stream:
        layout = _layout(stream.read(HEAD))
    columns = find(layout.headers)
    notes = []
    if dated := _stamp(layout, columns["time"]):
        notes.append(f"time is counted from {dated[0].strip()}")
    try:
        try:
            table = gather(columns, _blocks(opened, layout, columns), largest)
        except pa.ArrowInvalid:  # a logger that was interrupted leaves half a row
            whole = _blocks(lambda: pa.PythonFile(_WithoutLastLine(opened())), layout, columns)
            table = gather(columns, whole, largest)
            notes.append("the last row is cut off: left out")
    except pa.ArrowInvalid as error:
        if "Empty CSV file" in str(error):
            raise RecordingError("there is a header but no data: record it again") from None
        raise RecordingError(
            _complaint(opened, layout, columns) or f"{one_line(error)}: repair or export again"
        ) from None
    return replace(table, notes=tuple(notes))


class _UpTo(io.RawIOBase):
    """A stream of which no more than `largest` bytes are read: what unpacks to more is refused on the way."""

    def __init__(self, stream: pa.NativeFile, largest: float) -> None:
        self._stream, self._largest, self._size = stream, largest, 0

    def readable(self) -> bool:
        """It is."""
        return True

    def read(self, size: int = -1) -> bytes:
        """At most `size` bytes.

        Raises:
            Unreadable: if they are beyond the largest.
        """
        block: bytes = self._stream.read(BLOCK if size < 0 else size)
        self._size += len(block)
        refuse_size(self._size, self._largest, REMEDY)
        return block


class _WithoutLastLine(io.RawIOBase):
    """A stream up to where its last line begins."""

    def __init__(self, stream: pa.NativeFile) -> None:
        self._stream, self._held = stream, b""

    def readable(self) -> bool:
        """It is."""
        return True

    def read(self, size: int = -1) -> bytes:
        """At most `size` bytes of whole lines; all but the last of them are held back until a line ends."""
        size = BLOCK if size < 0 else size
        while self._held.rfind(b"\n") < 0 or len(self._held) <= size:
            if not (block := self._stream.read(BLOCK)):
                break
            self._held += block
            if len(self._held) > size + 2 * BLOCK and self._held.rfind(b"\n") < 0:
                raise RecordingError(LONG)
        ready = min(size, self._held.rfind(b"\n") + 1)
        given, self._held = self._held[:ready], self._held[ready:]
        return given


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:37] + "...")


def _blocks(opened: Opened, layout: Layout, columns: dict[str, Column]) -> Iterator[list[Array]]:
    names = [str(index) for index in range(len(layout.headers))]  # the file's own may repeat
    kept = [names[column.index] for column in columns.values()]
    types = dict.fromkeys(kept, pa.float64())
    if stamp := _stamp(layout, columns["time"]):
        types[names[columns["time"].index]] = pa.timestamp("ns", tz="UTC" if stamp["zone"] else None)
    began = None
    with opened() as stream:
        stream.read(layout.offset)
        reader = pacsv.open_csv(
            stream,
            read_options=pacsv.ReadOptions(column_names=names, block_size=BLOCK),
            parse_options=pacsv.ParseOptions(delimiter=layout.delimiter),
            convert_options=pacsv.ConvertOptions(
                include_columns=kept,
                column_types=types,
                null_values=[""],
                decimal_point=layout.decimal,
            ),
        )
        for batch in reader:
            block = []
            for column in batch.columns:
                if pa.types.is_timestamp(column.type):
                    began = pc.min(column).value if began is None else began
                    column = since(column, began)
                block.append(column.to_numpy(zero_copy_only=False))
            yield block


def _stamp(layout: Layout, time: Column) -> re.Match[str] | None:
    """The first time, if it is a date."""
    return STAMP.fullmatch(layout.first[time.index]) if time.index < len(layout.first) else None


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
    content = content[_preamble([lines[number][1] for number in content]) :]
    first = content[0]
    line, start, data = lines[first][1], lines[first][0], content[1:]
    if _is_numeric(_cells(line)):  # no header, unless the comment above is one
        comments = [text.lstrip(" #") for _, text in lines[:first] if text.strip()]
        if not comments or len(_cells(comments[-1])) != len(_cells(line)):
            raise RecordingError(f"the first row holds numbers instead of column names: put the header {HEADER} above")
        line, start, data = comments[-1], lines[first - 1][0], content
    delimiter = _delimiter(line)
    headers = _cells(line)
    if data and _are_units(units := _cells(lines[data[0]][1], delimiter), headers):
        headers = [
            f"{name} [{unit.strip(' []()')}]" if unit.strip(" []()-") else name
            for name, unit in zip(headers, units, strict=True)
        ]
        start, data = lines[data[0]][0], data[1:]
    samples = [lines[number][1] for number in data]
    comma = delimiter != "," and any("," in text for text in samples) and not any("." in text for text in samples)
    first_row = tuple(_cells(samples[0], delimiter)) if samples else ()
    return Layout(tuple(headers), delimiter, "," if comma else ".", start, first_row)


def _preamble(content: list[str]) -> int:
    """How many lines stand above the header, as measuring programs write them: fewer cells than there are columns."""
    if len(content) < 3:
        return 0
    probe = content[-2]  # the last may be cut off
    delimiter, width = _delimiter(probe), len(_cells(probe))
    numbers = [number for number, line in enumerate(content) if len(_cells(line, delimiter)) == width]
    for number in numbers:
        cells = _cells(content[number], delimiter)
        if width > 1 and all(cell.strip() and not NUMBER.fullmatch(cell) for cell in cells):
            return number
    return 0


def _are_units(cells: list[str], headers: list[str]) -> bool:
    """Whether a row holds the units of the columns: at least one is known, the others are empty or unknown words."""
    if len(cells) != len(headers) or any(NUMBER.fullmatch(cell) for cell in cells if cell.strip()):
        return False
    known = {unit for units in UNITS.values() for unit in units}
    return any(letters(cell) in known for cell in cells)


def _decoded(line: bytes) -> str:
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("latin-1")  # has the degree sign of older Windows programs


def _delimiter(line: str) -> str:
    return max(",;\t", key=line.count) if re.search(r"[,;\t]", line) else " "


def _cells(line: str, delimiter: str | None = None) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter or _delimiter(line)), [])
    except csv.Error as error:
        raise RecordingError(f"the header cannot be understood ({error}): put {HEADER} there") from None


def _is_numeric(cells: list[str]) -> bool:
    return any(cell.strip() for cell in cells) and all(NUMBER.fullmatch(cell.replace(",", ".")) for cell in cells)


def _lines(text: io.TextIOWrapper) -> Iterator[str]:
    """Lines, none longer than a block: one that never ends would fill the memory."""
    while line := text.readline(BLOCK):
        if len(line) == BLOCK:
            raise RecordingError(LONG)
        yield line


def _complaint(opened: Opened, layout: Layout, columns: dict[str, Column]) -> str | None:
    """What the fast reader stumbled over, found again by reading line by line; None if this reader finds nothing."""
    with opened() as stream:
        stream.read(layout.offset)
        text = io.TextIOWrapper(io.BufferedReader(stream), "utf-8", errors="replace", newline="")
        try:
            rows = (cells for cells in csv.reader(_lines(text), delimiter=layout.delimiter) if cells)
            for row, cells in enumerate(rows, start=1):
                where = f"data row {row} (header not counted)"
                if len(cells) != len(layout.headers):
                    remedy = "separate cells by commas" if layout.delimiter == " " else "repair or remove that row"
                    return f"{where} has {len(cells)} cells where the header has {len(layout.headers)}: {remedy}"
                for column in columns.values():
                    cell = cells[column.index]
                    if column.quantity == "time" and STAMP.fullmatch(cell) and _stamp(layout, column):
                        continue
                    if not NUMBER.fullmatch(cell.replace(layout.decimal, ".")):
                        return (
                            f"{where} has {_shown(cell)} as {column.quantity}, not a number: repair or remove that row"
                        )
        except csv.Error as error:
            return f"the text cannot be split into cells ({one_line(error)}): write plain comma-separated numbers"
    return None
