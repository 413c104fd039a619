"""A survey that the tests of the app share."""

import argparse
from datetime import timedelta
from pathlib import Path

from pendulum_env.recording import write_recording
from tests.workbench.app.plants import recorded
from workbench.commands.survey import configure
from workbench.survey import Dataset, Settings, find_cases
from workbench.survey.work import examined


def surveyed(folder: Path, weeks: int = 2) -> Dataset:
    """A joint that lacks Stribeck friction, surveyed: the first week is diagnosed and has a page; others repeat it."""
    path = folder / "data" / "arm1" / "elbow" / "2026-03-02.csv"
    path.parent.mkdir(parents=True)
    write_recording(recorded(path.stem, 1, 6.0, rate=250.0), path)
    parser = argparse.ArgumentParser()
    configure(parser)
    reading = parser.parse_args([str(folder), "-o", "-"])
    (case,) = find_cases([str(folder / "data")], reading)
    out = Dataset(folder / "out")
    out.create()
    row = examined(case, Settings({"only": ("stribeck",)}, reports="all", folder=out.folder))
    assert row["status"] == "done"
    out.append([row])
    for week in range(1, weeks):
        repeat(out, week)
    return out


def repeat(out: Dataset, week: int) -> None:
    """One more week in which the joint is as it was."""
    first = out.rows()[0]
    date = first["date"] + timedelta(weeks=week)
    out.append([{**first, "name": f"arm1/elbow/{date:%Y-%m-%d}.csv", "date": date, "report": None}])
