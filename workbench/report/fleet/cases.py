"""Every case, with a link to its own page."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pendulum_env._typing import JSON
from workbench.report.section import Section
from workbench.survey.fleet import Fleet

ORDER = ("failed", "refused", "missing", "unexplained", "nothing")
MARKS = {"missing": "selected", "unexplained": "ambiguous"}  # classes of the page's style


def cases(fleet: Fleet, folder: Path) -> Section:
    """A row for each case, those first that could not be diagnosed."""
    rows = sorted((_row(row, fleet.folder, folder) for row in fleet.rows), key=lambda row: (row["order"], row["name"]))
    pages = sum(row["link"] is not None for row in rows)
    return Section("cases", "Cases", "Every case", {"rows": rows, "pages": pages, "folder": str(fleet.folder)})


def _row(row: JSON, survey: Path, folder: Path) -> dict[str, Any]:
    verdict = row["verdict"] if row["status"] == "done" else row["status"]
    link = None
    if row["report"] is not None and (survey / row["report"]).exists():
        link = quote(Path(os.path.relpath((survey / row["report"]).resolve(), folder)).as_posix())
    return {
        "name": row["name"],
        "link": link,
        "joint": " / ".join(filter(None, (row["robot"], row["joint"]))) or "–",
        "date": row["date"],
        "dated_by": row["dated_by"],
        "verdict": verdict,
        "mark": MARKS.get(verdict, ""),
        "order": ORDER.index(verdict),
        "said": row["headline"] if row["status"] == "done" else row["reason"],
        "score": row["score"],
        "torque": row["torque_rms"],
        "floor": row["noise_floor"],
        "seconds": row["seconds"],
    }
