"""Table of a survey with a row for each joint of each recording, and the trends of parameters."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import scipy

from estimators.trends import Trend, fit_trend
from pendulum_env._typing import JSON
from pendulum_env.files import replace_file
from pendulum_env.formatting import TextTable, format_estimate, format_number
from pendulum_env.recording.clock import find_date
from workbench.cli import find_version
from workbench.survey.recordings import TABLES, SurveyedRecording, is_future

WEEK = 7 * 86400.0  # [s]
LEVEL = 0.01  # false discovery rate of reported changes
TEXT, NUMBER, DATE = pa.string(), pa.float64(), pa.timestamp("s", "UTC")
SURVEY = {  # fixed columns; columns of parameters follow
    **dict(recording=TEXT, machine=TEXT, joint=TEXT, date=DATE, dated_by=TEXT),
    **dict(effects=TEXT, small_effects=TEXT, unexplained=pa.bool_(), biased=pa.bool_()),
    **dict(error_before=NUMBER, error_after=NUMBER, noise_floor=NUMBER, error_unit=TEXT),
    **dict(position_rms_before=NUMBER, position_rms_after=NUMBER, error=TEXT, hash=TEXT, version=TEXT),
}
# Column suffixes of a parameter; the last three belong to its series
PARAMETER = {"": "value", "_std": "std", "_drift_per_week": "drift", "_jump": "jump", "_p_value": "p_value"}


def label_rows(recording: SurveyedRecording, result: JSON, content: str | None) -> list[JSON]:
    """Add name, machine, date, content hash and version to the rows of a result; a failed recording has one row.

    A clock that is in the future is ignored.
    """
    start = result.get("start")
    date = None if start is None else find_date(start)
    if date is not None and is_future(date):
        date = None
    label = {
        "recording": recording.name,
        "machine": recording.machine,
        "date": date or recording.date,
        "dated_by": "clock" if date else recording.dated_by,
        "hash": content,
        "version": find_version(),
    }
    failed: JSON = {"joint": "", "error": result.get("error"), "parameters": {}}
    return [label | row for row in result.get("rows", [failed])]


@dataclass(frozen=True, eq=False)
class Series:
    """Parameter of a joint over time, in models with the same effects."""

    machine: str
    joint: str
    parameter: str
    unit: str
    effects: str  # added effects, sorted and comma-separated
    rows: tuple[JSON, ...]  # rows of the recordings, by date
    trend: Trend  # time in weeks
    change: str = ""  # "drift" or "jump" if significant, else empty

    @property
    def estimates(self) -> list[JSON]:
        """Return the estimates in the order of `rows`."""
        return [row["parameters"][self.parameter] for row in self.rows]

    @property
    def jump_date(self) -> datetime | None:
        """Return the date of the first recording after a jump; None without one."""
        jump = self.trend.jump if self.change == "jump" else None
        return None if jump is None else self.rows[jump.first]["date"]

    def mark_changes(self) -> None:
        """Write p-value and change into the estimates: a drift into all, a jump into the first after it."""
        for k, estimate in enumerate(self.estimates):
            if np.isfinite(self.trend.p_value):
                estimate["p_value"] = self.trend.p_value
            if self.change == "drift":
                estimate["drift"] = self.trend.drift
            elif self.change and self.trend.jump is not None and self.trend.jump.first == k:
                estimate["jump"] = self.trend.jump.size


def find_series(rows: Iterable[JSON]) -> list[Series]:
    """Collect the parameters of every joint over time, and find those that change.

    A parameter depends on the other effects in the model, so each set of effects has a separate series. Biased
    estimates and those without a standard error, such as known values, are left out. Changes are significant at a
    false discovery rate of 1 % for independent tests (Benjamini and Hochberg).
    """
    points: dict[tuple[str, str, str, str, str], list[JSON]] = {}
    for row in sorted((row for row in rows if not row.get("biased")), key=lambda row: row["date"]):
        for name, parameter in row["parameters"].items():
            if parameter["value"] is not None and parameter["std"]:
                key = (row["machine"], row["joint"], name, parameter["unit"], ", ".join(row["selected"]))
                points.setdefault(key, []).append(row)
    series = []
    for key, own_rows in sorted(points.items(), key=lambda point: point[0]):
        weeks = np.array([row["date"].timestamp() / WEEK for row in own_rows])
        value, std = np.array([[row["parameters"][key[2]][part] for row in own_rows] for part in ("value", "std")])
        series.append(Series(*key, tuple(own_rows), fit_trend(weeks, value, std)))
    p_values = np.array([estimate_series.trend.p_value for estimate_series in series])
    tested_series = np.flatnonzero(np.isfinite(p_values))
    for k, adjusted in zip(tested_series, scipy.stats.false_discovery_control(p_values[tested_series]), strict=True):
        if adjusted <= LEVEL:
            series[k] = replace(series[k], change="drift" if series[k].trend.jump is None else "jump")
    return series


def write_table(folder: Path, rows: Sequence[JSON]) -> None:
    """Write the table as Parquet and CSV, each file atomically; raises OSError if it cannot be written."""
    names = dict.fromkeys(name for row in rows for name in row["parameters"])
    columns = SURVEY | {f"{name}{ending}": NUMBER for name in names for ending in PARAMETER}
    flat = [row.copy() for row in rows]
    for row in flat:
        for name, parameter in row["parameters"].items():
            row |= {f"{name}{end}": parameter.get(key) for end, key in PARAMETER.items()}
    table = pa.Table.from_pylist(flat, schema=pa.schema(columns))
    for name, write in zip(TABLES, (pq.write_table, pyarrow.csv.write_csv), strict=True):
        with replace_file(folder / name) as file:
            write(table, file)


def tabulate_recordings(rows: Sequence[JSON]) -> TextTable:
    """Make the printed table of recordings: failed ones first, then those with an effect or a residual."""
    joint = ["joint"] * any(row["joint"] for row in rows)

    def order(row: JSON) -> tuple[bool, bool, str]:
        return "error" not in row, not (row.get("effects") or row.get("unexplained")), row["recording"]

    cells = []
    for row in sorted(rows, key=order):
        error = "" if row.get("error_after") is None else f"{row['error_after']:.3g} {row['error_unit']}"
        named = [row[name] for name in ("recording", *joint)]
        cells.append((*named, f"{row['date']:%Y-%m-%d}", error, _format_result(row)))
    headers = ("recording", *joint, "date", "error held out", "result")
    return TextTable(headers, cells, left=(*joint, "date", "result"))


def _format_result(row: JSON) -> str:
    if "error" in row:
        return str(row["error"])
    small = f"small effect: {row['small_effects']}" if row.get("small_effects") else ""
    residual = "unexplained residual" * row["unexplained"]
    return ", ".join(filter(None, (row["effects"], small, residual))) or "nothing missing"


def tabulate_changes(series: Sequence[Series]) -> TextTable:
    """Make the printed table of changing parameters."""
    rows = []
    for changed in (item for item in series if item.change):
        jump, low, high = changed.trend.jump, *changed.trend.interval
        size = f"{changed.trend.drift:+.3g} ({low:+.3g} to {high:+.3g}) a week"
        if changed.change == "jump" and jump is not None:
            sign = "+" if jump.size > 0 else ""
            size = f"{sign}{format_estimate(jump.size, jump.std)} on {changed.jump_date:%Y-%m-%d}"
        mean = format_number(float(np.mean([estimate["value"] for estimate in changed.estimates])))
        effects = f"(with {changed.effects})" if changed.effects else ""
        label = " ".join(filter(None, (changed.machine, changed.joint, changed.parameter, effects)))
        rows.append((label, changed.change, size, changed.unit, mean, f"{changed.trend.p_value:.1g}"))
    return TextTable(("parameter", "change", "size", "unit", "mean", "p-value"), rows, left=("change", "size", "unit"))
