"""Logs of a run as a user has them: columns with their format, and files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DIGITS = {"time": ".9g", "position": ".10g", "goal": ".10g", "torque": ".7g", "velocity": ".8g"}


@dataclass(frozen=True)
class Log:
    """Log of a run as a user has it.

    Attributes:
        columns: values by header, in order; those of a joint of an arm end in `_JOINT`.
        texts: format of the values, by header or by quantity.
        options: of the command line, in addition to those of the run.
        named: option `--columns`, by quantity.
        truth: parameters that differ from those of the run, as those in another unit.
        separator: of the cells.
        comma: whether numbers have a decimal comma.
        cuts: shares of the rows at which the file is split.
    """

    columns: dict[str, Array]
    texts: dict[str, str] = field(default_factory=lambda: dict(DIGITS))
    options: tuple[str, ...] = ()
    named: Mapping[str, str] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)
    separator: str = ","
    comma: bool = False
    cuts: tuple[float, ...] = ()

    def find(self, *quantities: str) -> list[str]:
        """Return the headers of quantities, of all joints."""
        return [name for name in self.columns if name.partition("_")[0] in quantities]

    def scale(self, factor: float, *quantities: str) -> Log:
        """Return the log with other values of some quantities."""
        return self.change(**{name: self.columns[name] * factor for name in self.find(*quantities)})

    def change(self, **columns: Array) -> Log:
        """Return the log with other columns."""
        return replace(self, columns=self.columns | columns)

    def keep(self, rows: Array) -> Log:
        """Return the log with some rows, in this order."""
        return replace(self, columns={name: values[rows] for name, values in self.columns.items()})

    def rename(self, **names: str) -> Log:
        """Return the log with other headers."""
        columns = {names.get(name, name): values for name, values in self.columns.items()}
        texts = {names.get(name, name): self.get_text(name) for name in self.columns}
        return replace(self, columns=columns, texts=self.texts | texts)

    def get_text(self, name: str) -> str:
        """Return the format of the column with a header."""
        return self.texts.get(name, self.texts.get(name.partition("_")[0], ".8g"))

    def make_options(self) -> list[str]:
        """Return the options of the command line."""
        named = ",".join(f"{quantity}={text}" for quantity, text in self.named.items())
        return [*self.options, *(("--columns", named) if named else ())]

    def write(self, folder: Path, stem: str = "log") -> list[str]:
        """Write the files, and return their names."""
        rows, files = [*zip(*self.columns.values(), strict=True)], []
        texts = [self.get_text(name) for name in self.columns]
        ends = [0, *(round(share * len(rows)) for share in self.cuts), len(rows)]
        for k, (first, last) in enumerate(pairwise(ends)):
            lines = [self.separator.join(self.columns)]
            for row in rows[first:last]:
                cells = [self._write_cell(value, text) for value, text in zip(row, texts, strict=True)]
                lines.append(self.separator.join(cells))
            files.append(str(folder / f"{stem}{k}.csv"))
            Path(files[-1]).write_text("\n".join(lines) + "\n", encoding="utf-8")
        return files

    def _write_cell(self, value: float, text: str) -> str:
        cell = "" if np.isnan(value) else format(round(value) if text == "d" else value, text)
        return cell.replace(".", ",") if self.comma else cell
