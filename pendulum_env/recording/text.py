"""Read text files, plain or gzipped, and the cells of Excel sheets and of arrays of texts."""

import csv
import io
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError, shorten_error
from pendulum_env.reading import quote_value
from pendulum_env.recording.clock import CLOCK, STAMP, count_seconds, is_stamp, parse_date
from pendulum_env.recording.columns import NONE, FileColumn, add_labels
from pendulum_env.recording.layout import EMPTY, HEAD, NUMBER, Layout, find_layout
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.table import ColumnFinder, RawTable, convert_series, rank_words, require_module
from pendulum_env.recording.vocabulary import OPTIONAL
from pendulum_env.settings import format_setting

BLOCK = 1 << 20  # bytes parsed at a time
WIDTH = re.compile(r"Row #(?P<row>\d+): Expected (?P<expected>\d+) columns, got (?P<count>\d+)")  # message of pyarrow
CELL = re.compile(r"In CSV column #(?P<column>\d+): Row #(?P<row>\d+): .*?invalid value '(?P<cell>.*)'", re.DOTALL)
TRUE, FALSE = (  # cells for 1 and 0
    [style(word) for word in words for style in (str.lower, str.title, str.upper)]
    for words in (("true", "on", "yes"), ("false", "off", "no"))
)
ARRIVAL = re.compile(rb"^\d\d:\d\d:\d\d\.\d{3} -> ", re.MULTILINE)  # that a serial monitor prints before a line
ELEMENT = rb"[-+]?(?:[.\d][-+.e\d]*|nan|inf(?:inity)?|null|none)"
LIST = re.compile(  # cell with a list of numbers
    rb"""["']?\[\s*(%s(?:[,;\s]+%s)*)[,;\s]*\]["']?""" % (ELEMENT, ELEMENT), re.IGNORECASE
)
NO_LIST = (*EMPTY, "nan", "NaN", "[]")  # cells of a column of lists that have none
DAY = 86400.0  # [s]
TextOpener = Callable[[], pa.NativeFile]  # the text, from its beginning


def read_csv(path: Path, find: ColumnFinder) -> RawTable:
    """Read the needed columns, with NaN for empty cells.

    Comment lines (#) and lines with fewer cells above the header are ignored. Without a header, the last comment may be
    the header, as by `numpy.savetxt`. A row of units may follow the header. Delimiters are comma, semicolon, tab or a
    single space; with a delimiter other than comma, numbers may have a decimal comma. Time may be ISO 8601 and is then
    counted from the first row. Elements of cells with lists are columns, `x[0]`.
    """
    compression = "gzip" if path.name.lower().endswith(".gz") else None
    return read_text_table(lambda: pa.input_stream(str(path), compression=compression), find)


def read_text_table(open_text: TextOpener, find: ColumnFinder) -> RawTable:
    """Read the needed columns of a text, as `read_csv`."""
    open_text = _clean_text(open_text)
    with open_text() as stream:
        layout = find_layout(stream.read(HEAD))
    if any(LIST.match(cell.encode()) for cell in layout.first_cells):
        open_text = _split_lists(open_text, layout)
        with open_text() as stream:
            layout = find_layout(stream.read(HEAD))
    headers, cells = layout.headers, layout.first_cells
    text_columns = [k for k, cell in enumerate(cells) if not NUMBER.fullmatch(cell.replace(",", ".")) or not cell]
    date_columns = [k for k, cell in enumerate(cells) if is_stamp(cell)]
    columns = add_labels(find(headers, text_columns=text_columns, date_columns=date_columns), headers, cells)
    notes = []
    if first_date := STAMP.fullmatch(layout.first_cells[columns["time"].index]):
        notes.append(Note(NoteKind.FIRST_DATE, text=first_date[0].strip()))
    try:
        values = _read_values(open_text, layout, columns)
    except RecordingError as refusal:
        try:  # an interrupted logger leaves a partial row
            values = _read_values(lambda: _drop_last_line(open_text), layout, columns)
        except RecordingError:
            raise refusal from None
        notes.append(Note(NoteKind.LAST_ROW_CUT))
    return RawTable(columns, values, tuple(notes), None if first_date is None else parse_date(first_date[0]))


def _clean_text(open_text: TextOpener) -> TextOpener:
    """Convert UTF-16, remove prefixes of serial monitors, and separate columns that spaces align with tabs.

    Raises RecordingError if the file is binary.
    """
    with open_text() as stream:
        head = stream.read(HEAD)
        if head.startswith((b"\xff\xfe", b"\xfe\xff")):
            text = pa.py_buffer((head + stream.read()).decode("utf-16", errors="replace").encode())
            return _clean_text(lambda: pa.BufferReader(text))
    if b"\0" in head:
        raise RecordingError("is no text, but has binary data: export it as CSV")
    lines = ARRIVAL.sub(b"", head).split(b"\n")[:-1]
    rows = [line for line in lines if _is_aligned(line)]
    is_aligned = any(b"  " in row.strip() or row.startswith(b" ") for row in rows)
    if not (is_aligned or ARRIVAL.search(head)):
        return open_text
    with open_text() as stream:
        content = ARRIVAL.sub(b"", stream.read())
    if is_aligned:
        start, width = content.index(rows[0]), len(rows[0].split())
        top = [_insert_tabs(line, width) for line in content[:start].split(b"\n")]
        data = re.sub(rb"[ \t]+", b"\t", re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", content[start:]))
        content = b"\n".join(top) + data
    return lambda: pa.BufferReader(pa.py_buffer(content))


def _split_lists(open_text: TextOpener, layout: Layout) -> TextOpener:
    """Separate the elements of cells with lists, `"[0.1, 0.2]"`, which become columns `x[0]` and `x[1]`."""
    with open_text() as stream:
        content = stream.read()[layout.offset :]
    joined = LIST.sub(lambda cell: b"[%s]" % b"|".join(re.split(rb"[,;\s]+", cell[1])), content)
    lists = [LIST.fullmatch(cell.encode()) for cell in layout.first_cells]
    widths = [len(re.split(rb"[,;\s]+", cell[1])) if cell else 0 for cell in lists]
    text = io.StringIO()
    writer = csv.writer(text, delimiter=layout.delimiter, lineterminator="\n")
    names = zip(layout.headers, widths, strict=True)
    writer.writerow([part for name, width in names for part in [f"{name}[{k}]" for k in range(width)] or [name]])
    for row in csv.reader(io.StringIO(joined.decode(errors="surrogateescape")), delimiter=layout.delimiter):
        cells = list[str]()
        for cell, width in zip(row, [*widths, *[0] * len(row)], strict=False):
            if width and cell.strip() in NO_LIST:
                cells += [""] * width
            else:
                cells += cell[1:-1].split("|") if width and cell.startswith("[") else [cell]
        writer.writerow(cells)
    return lambda: pa.BufferReader(pa.py_buffer(text.getvalue().encode(errors="surrogateescape")))


def _is_aligned(line: bytes) -> bool:
    """Return whether a line has only numbers separated by spaces."""
    cells = line.decode("latin-1").split()
    return len(cells) > 1 and b"\t" not in line and all(NUMBER.fullmatch(cell.replace(",", ".")) for cell in cells)


def _insert_tabs(line: bytes, width: int) -> bytes:
    """Separate `width` names in a line with tabs; names may have single spaces."""
    splits = (re.split(rb"[ \t]{2,}|\t", line.strip()), line.split())
    return next((b"\t".join(cells) for cells in splits if len(cells) == width), line)


def _drop_last_line(open_text: TextOpener) -> pa.NativeFile:
    with open_text() as stream:
        content = stream.read()
    return pa.BufferReader(pa.py_buffer(content)[: content.rfind(b"\n") + 1])


def _read_values(open_text: TextOpener, layout: Layout, columns: dict[str, FileColumn]) -> dict[str, Array]:
    names = [str(index) for index in range(len(layout.headers))]  # headers may repeat
    column_names = [names[column.index] for column in columns.values()]
    types = {names[column.index]: _choose_cell_type(quantity, layout, column) for quantity, column in columns.items()}
    first_time = layout.first_cells[columns["time"].index]
    if stamp := STAMP.fullmatch(first_time):
        types[names[columns["time"].index]] = pa.timestamp("ns", tz="UTC" if stamp["zone"] else None)
    if is_spelt := bool(CLOCK.fullmatch(first_time) or (stamp and re.search("[,/]|[.].*:", first_time))):
        types[names[columns["time"].index]] = pa.string()
    try:
        with open_text() as stream:
            stream.read(layout.offset)
            table = pacsv.read_csv(
                stream,
                read_options=pacsv.ReadOptions(column_names=names, block_size=BLOCK, use_threads=False),  # counts rows
                parse_options=pacsv.ParseOptions(
                    delimiter=layout.delimiter,
                    invalid_row_handler=lambda row: "skip" if row.text.lstrip().startswith("#") else "error",
                ),
                convert_options=pacsv.ConvertOptions(
                    include_columns=column_names,
                    column_types=types,
                    null_values=EMPTY,
                    strings_can_be_null=True,
                    true_values=TRUE,
                    false_values=FALSE,
                    decimal_point=layout.decimal,
                ),
            )
    except pa.ArrowInvalid as error:
        _refuse_cell(str(error), layout, columns)
    series = dict(zip(columns, table.columns, strict=True))
    if is_spelt:
        series["time"] = _convert_times(series["time"])
    values = {quantity: convert_series(column) for quantity, column in series.items()}
    if values["time"].dtype.kind == "M":
        values["time"], _ = count_seconds(values["time"])
    return {quantity: rank_words(cells) if cells.dtype.kind == "O" else cells for quantity, cells in values.items()}


def _convert_times(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Convert times of day to seconds, continued after midnight; other spellings of dates to dates."""
    import pyarrow.compute as pc  # takes a while to import

    is_clock = CLOCK.fullmatch(column[0].as_py() or "")
    column = pc.replace_substring(pc.utf8_trim_whitespace(pc.utf8_upper(column)), ",", ".")
    if not is_clock:
        column = pc.replace_substring_regex(column, r"^(\d{4})[./](\d\d)[./]", r"\1-\2-")
        return pc.replace_substring_regex(column, r"\s*(Z|[+-]\d\d:?\d\d)$", "").cast(pa.timestamp("ns"))
    is_afternoon, has_half_days = (convert_series(pc.match_substring_regex(column, end)) for end in ("PM$", "[AP]M$"))
    parts = pc.split_pattern(pc.replace_substring_regex(column, r"^\S*\d{4}[. ]\s*|\s*[AP]M$", ""), ":")
    count = len(parts[0])
    seconds = sum(
        60.0 ** (count - 1 - k) * convert_series(pc.list_element(parts, k).cast(pa.float64())) for k in range(count)
    )
    if count == 3:
        seconds = np.where(has_half_days, seconds % (DAY / 2) + is_afternoon * DAY / 2, seconds)
        seconds = seconds + np.append(0.0, np.cumsum(np.where(np.diff(seconds) < -DAY / 2, DAY, 0.0)))
    return pa.chunked_array([seconds])


def _choose_cell_type(quantity: str, layout: Layout, column: FileColumn) -> pa.DataType:
    """Return the type of a column's cells: numbers, booleans, or words that label segments."""
    first = layout.first_cells[column.index]
    if quantity in ("enabled", "segment") and first in (*TRUE, *FALSE):
        return pa.bool_()
    return pa.string() if quantity == "segment" and first and not NUMBER.fullmatch(first) else pa.float64()


def _refuse_cell(error_text: str, layout: Layout, columns: dict[str, FileColumn]) -> NoReturn:
    """Refuse the cell or row at which pyarrow failed."""
    if match := CELL.search(error_text):
        (quantity,) = (column.quantity for column in columns.values() if column.index == int(match["column"]))
        remedy = "repair or remove that row"
        if quantity == "time":
            remedy = "write seconds, or dates as 2026-03-01 12:00:00.250"
        if quantity in OPTIONAL:
            remedy += f", or leave the column out with {format_setting('columns', {quantity: NONE})}"
        fault = f"{quote_value(match['cell'])} as {quantity}, not a number"
    elif match := WIDTH.search(error_text):
        fault = f"{match['count']} cells where the header has {match['expected']}"
        remedy = "separate cells by commas" if layout.delimiter == " " else "repair or remove that row"
    elif "Empty CSV file" in error_text:
        raise RecordingError("there is a header but no data: record it again")
    else:
        raise RecordingError(
            f"the text cannot be split into cells ({shorten_error(error_text)}): write plain comma-separated numbers"
        )
    raise RecordingError(f"data row {match['row']} (header not counted) has {fault}: {remedy}")


def read_excel(path: Path, find: ColumnFinder) -> RawTable:
    """Read the first non-empty sheet of a workbook as the text of its cells."""
    require_module("python_calamine")
    from python_calamine import CalamineWorkbook

    book = CalamineWorkbook.from_path(path)
    rows = next((rows for name in book.sheet_names if (rows := book.get_sheet_by_name(name).to_python())), [])
    text = io.StringIO()
    csv.writer(text).writerows(
        [cell.isoformat() if hasattr(cell, "isoformat") else cell for cell in row] for row in rows
    )
    content = pa.py_buffer(text.getvalue().encode())
    return read_text_table(lambda: pa.BufferReader(content), find)


def read_cells(columns: dict[str, FileColumn], cells: Mapping[str, NDArray[Any]]) -> RawTable:
    """Read arrays by quantity, some of texts, like the columns of a text file."""
    columns_of_text = {quantity: _make_cells(values) for quantity, values in cells.items()}
    file = pa.BufferOutputStream()
    pacsv.write_csv(pa.table(columns_of_text), file, pacsv.WriteOptions(delimiter=";"))  # cells may have decimal commas
    content, places = file.getvalue(), {q: replace(columns[q], index=k) for k, q in enumerate(columns_of_text)}
    table = read_text_table(lambda: pa.BufferReader(content), lambda *_, **__: places)
    return replace(table, columns={quantity: columns[quantity] for quantity in table.columns})


def _make_cells(values: NDArray[Any]) -> pa.Array:
    """Make an Arrow column of the texts or numbers of an array."""
    if values.dtype.kind not in "UO":
        return pa.array(values)
    return pa.array([None if cell is None or cell != cell else str(cell) for cell in values], pa.string())
