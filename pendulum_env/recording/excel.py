"""Sheets of Excel, read as the text of their cells."""

import csv
import io
from pathlib import Path

import pyarrow as pa

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
