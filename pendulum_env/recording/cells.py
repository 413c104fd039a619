"""Read Excel sheets and arrays of texts as the text of their cells."""

import csv
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pacsv
from numpy.typing import NDArray

from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.table import ColumnFinder, RawTable, require_module
from pendulum_env.recording.text import read_text_table


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
