"""A page on a fleet: what is missing where, what drifts, which joints differ, and every case."""

import os
from collections.abc import Sequence
from html import escape
from itertools import cycle
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from estimators.fleet import LEVEL
from pendulum_env import words
from pendulum_env._typing import JSON, Array
from pendulum_env.files import write_whole
from workbench.report.figure import DRAWING, Figure, Section, axis, line, numbers
from workbench.report.page import assemble
from workbench.survey.dataset import STATUSES, VERDICTS
from workbench.survey.fleet import CHANCE, DAY, Fleet, Missing, Series
from workbench.survey.tables import tables

COLORS = ("--final", "--base", "--scheme-1", "--scheme-3", "--low", "--high")
ORDER = (*STATUSES[:2], *VERDICTS)  # of cases


def render(fleet: Fleet, folder: Path) -> str:
    """HTML of the page, its links relative to the folder that it will be in."""
    sections = [summary(fleet), missing(fleet), courses(fleet), siblings(fleet), cases(fleet, folder)]
    subject = f"survey of {len(fleet.rows)} recordings"
    return assemble([section for section in sections if section is not None], subject)


def write_fleet_report(path: str | Path, fleet: Fleet) -> None:
    """Write what a fleet shows as one HTML file, whole or not at all, with links to the pages of cases.

    Raises:
        OSError: if the file cannot be written.
    """
    write_whole(path, render(fleet, Path(path).resolve().parent))


def summary(fleet: Fleet) -> Section:
    """The fleet in a sentence and three tiles."""
    dates, drifting = [row["date"] for row in fleet.rows], [*fleet.drifting, *fleet.jumping]
    content = {
        "cases": len(fleet.rows),
        "troubled": sum(row["status"] != "done" for row in fleet.rows),
        "joints": len(fleet.joints),
        "robots": len({joint.robot for joint in fleet.joints}),
        "first": min(dates, default=None),
        "last": max(dates, default=None),
        "tiles": [
            ("Effects are missing in", _labels(_significant(fleet)), _none_missing(fleet)),
            ("Parameters drift or jump in", _labels(drifting), "none beyond errors and scatter"),
            ("Unlike their siblings", _labels(fleet.odd), "none, as far as siblings tell"),
        ],
        "seconds": sum(row["seconds"] or 0.0 for row in fleet.rows),
    }
    return Section("fleet", "Fleet", headline(fleet), content)


def headline(fleet: Fleet) -> str:
    """The fleet in one sentence: `2 of 20 joints drift, and Stribeck friction is missing in 1`."""
    total = len(fleet.joints)
    parts: list[str] = []
    for found, one, several in (
        (fleet.drifting, "drifts", "drift"),
        (fleet.jumping, "has jumped", "have jumped"),
        (fleet.odd, "differs from its siblings", "differ from their siblings"),
    ):
        if count := len(_labels(found)):
            parts.append(f"{count}{'' if parts else f' of {total} joints'} {one if count == 1 else several}")
    if effects := _significant(fleet):
        names = sorted({words.name(one.effect) for one in effects})
        parts.append(f"{words.listing(names)} {'is' if len(names) == 1 else 'are'} missing in {len(_labels(effects))}")
    if fleet.unexplained:
        parts.append(f"something that no effect explains is missing in {fleet.unexplained}")
    if not parts:
        return f"{total} joints, and nothing that stands out" if total else "No case could be diagnosed"
    return words.opening(words.listing(parts))


def _none_missing(fleet: Fleet) -> str:
    """What the page says where no effect is significant."""
    if not fleet.joints:
        return "no case could be diagnosed"
    return "those that cases name may be named by chance" if fleet.effects else "no case names one"


def _significant(fleet: Fleet) -> list[Missing]:
    return [one for one in fleet.effects if one.significant]


def _labels(found: Sequence[Missing | Series]) -> list[str]:
    """Joints of which something was found."""
    return sorted({one.joint.label for one in found})


def missing(fleet: Fleet) -> Section:
    """Which effect is missing where, and what is weak in each case but in all of a group."""
    by_name = tables(fleet)
    content = {"effects": by_name["missing"], "shared": by_name["shared"], "chance": CHANCE}
    return Section("missing", "Missing", "What is missing where", content)


def courses(fleet: Fleet) -> Section | None:
    """Parameters over time, and which of them drift; nothing where no case was diagnosed."""
    if not fleet.series:
        return None
    telling, by_name = [one.parameter for one in (*fleet.drifting, *fleet.jumping)], tables(fleet)
    content = {
        "drifting": by_name["drifting"],
        "jumping": by_name["jumping"],
        "figures": [over_time(fleet, name, k) for k, name in enumerate(_parameters(fleet, telling, DRAWING.courses))],
        "all": by_name["courses"],
        "sigmas": DRAWING.sigmas,
        "level": LEVEL,
    }
    return Section("courses", "Over time", "Parameters over time", content)


def siblings(fleet: Fleet) -> Section | None:
    """Joints beside others of their kind; nothing where no joint has a sibling."""
    kinds = [joint.kind for joint in fleet.joints]
    if len(set(kinds)) == len(kinds):
        return None
    telling = [one.parameter for one in fleet.odd]
    content = {
        "odd": tables(fleet)["odd"],
        "figures": [means(fleet, name, k) for k, name in enumerate(_parameters(fleet, telling, DRAWING.means))],
        "sigmas": DRAWING.sigmas,
    }
    return Section("siblings", "Siblings", "Joints beside their siblings", content)


def cases(fleet: Fleet, folder: Path) -> Section:
    """A row for each case, those first that could not be diagnosed, with a link to its own page."""
    rows = [_case(row, fleet.folder, folder) for row in fleet.rows]
    rows.sort(key=lambda row: (row["order"], row["name"]))
    pages = sum(row["link"] is not None for row in rows)
    return Section("cases", "Cases", "Every case", {"rows": rows, "pages": pages, "folder": str(fleet.folder)})


def _case(row: JSON, survey: Path, folder: Path) -> dict[str, Any]:
    done = row["status"] == "done"
    verdict = row["verdict"] if done else row["status"]
    page = None if row["report"] is None else (survey / row["report"]).resolve()
    return row | {
        "link": quote(Path(os.path.relpath(page, folder)).as_posix()) if page is not None and page.exists() else None,
        "label": " / ".join(filter(None, (row["robot"], row["joint"]))) or "–",
        "verdict": verdict,
        "mark": {"missing": "selected", "unexplained": "ambiguous"}.get(verdict, ""),  # classes of the page's style
        "order": ORDER.index(verdict),
        "told": row["headline"] if done else row["reason"],
    }


def _parameters(fleet: Fleet, telling: Sequence[str], most: int) -> list[str]:
    """Parameters to plot: those of which something is told, then those that most joints have."""
    names = [one.parameter for one in fleet.series]
    frequent = sorted(dict.fromkeys(names), key=names.count, reverse=True)
    return list(dict.fromkeys([*telling, *frequent]))[: max(most, len(set(telling)))]


def over_time(fleet: Fleet, parameter: str, number: int) -> Figure:
    """One parameter of all joints: those that drift in colours, with their lines."""
    having = [one for one in fleet.series if one.parameter == parameter]
    plain, telling = ([one for one in having if one.changes is changes] for changes in (False, True))
    shown = plain[: max(0, DRAWING.joints - len(telling))]
    data = [_course(one, "--train", mode="lines+markers", opacity=0.45, showlegend=False) for one in shown]
    for one, color in zip(telling, cycle(COLORS)):  # drawn last
        data.append(_course(one, color, showlegend=True))
        if one.since is None:
            data.append(_line(one, color))
    layout = {"xaxis": axis("", type="date"), "yaxis": _values(having[0]), "hovermode": "closest"}
    label = f"{parameter} of every joint over time, with intervals"
    return Figure(f"course-{number}", label, data, layout, 320)


def _course(series: Series, color: str, **more: object) -> JSON:
    name = escape(series.joint.label)
    hover = f"{name}<br>%{{x|%Y-%m-%d}}: %{{y:.4g}} {escape(series.unit)}<extra></extra>"
    more |= {"x": _dates(series.date), "name": name, "legendgroup": name, "hovertemplate": hover}
    return _points(series.value, series.error, color, **more)


def _line(series: Series, color: str) -> JSON:
    ends = np.array([series.date.min(), series.date.max()])
    centre = np.average(series.date, weights=1 / series.error**2)
    y = series.course.level + series.course.change * (ends - centre) / DAY
    name = escape(series.joint.label)
    more = {"x": _dates(ends), "legendgroup": name, "showlegend": False, "hoverinfo": "skip"}
    return line(ends, y, name, color, "") | more


def means(fleet: Fleet, parameter: str, number: int) -> Figure:
    """Means of one parameter, a column for each kind."""
    having = [one for one in fleet.series if one.parameter == parameter]
    data = []
    for differs, name, color in ((False, "like its siblings", "--train"), (True, "differs", "--base")):
        if own := [one for one in having if (one.odd is not None) is differs]:
            level, error = np.array([(one.course.level, one.course.level_error) for one in own]).T
            kinds, labels = [escape(one.joint.kind or "–") for one in own], [escape(one.joint.label) for one in own]
            hover = "%{text}: %{y:.4g}<extra></extra>"
            data.append(_points(level, error, color, x=kinds, name=name, text=labels, hovertemplate=hover))
    layout = {"xaxis": {"type": "category"}, "yaxis": _values(having[0])}
    return Figure(f"siblings-{number}", f"Mean {parameter} of every joint, by kind", data, layout, 280)


def _points(value: Array, error: Array, color: str, **more: object) -> JSON:
    """Values and standard errors (N,) as points with bars."""
    return {
        "type": "scatter",
        "mode": "markers",
        "y": numbers(value),
        "error_y": {
            "type": "data",
            "array": numbers(DRAWING.sigmas * error),
            "color": color,
            "thickness": 1.2,
            "width": 0,
        },
        "marker": {"color": color, "size": 6},
        "line": {"color": color, "width": 0.8},
        **more,
    }


def _values(series: Series) -> JSON:
    return axis(f"{series.parameter} [{words.unit(series.unit) or 1}]")


def _dates(stamps: Array) -> list[float]:
    return (1000 * stamps).tolist()  # [ms since 1970], as plotly.js takes them
