"""A survey beside the workbench: its own page, as `survey --report` writes it, and those of its cases."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import flask

from workbench.report.fleet import render
from workbench.survey import Dataset, Fleet

PAGE, HOME = "/fleet/", "/"
APART = "sandbox allow-scripts allow-downloads"  # a case's page is a file, perhaps not ours: it may not ask for a thing


def serve(server: flask.Flask, survey: Path) -> str:
    """Answer for a survey's page, which tells what its dataset holds by then, and for those of its cases.

    Args:
        server: of the app, which is for this computer alone.
        survey: the folder, as the server's user named it.

    Returns the page's address.
    """
    dataset = Dataset(survey.resolve())

    @server.get(PAGE)
    def fleet() -> str:
        return _page(dataset, tuple(dataset.parts))

    @server.get(f"{PAGE}reports/<name>")  # one folder and no other: a name holds no slash
    def case(name: str) -> flask.Response:
        response = flask.send_from_directory(dataset.folder / "reports", name, mimetype="text/html")
        response.headers.add("Content-Security-Policy", APART)
        return response

    return PAGE


@lru_cache(maxsize=1)
def _page(dataset: Dataset, parts: tuple[Path, ...]) -> str:
    """The page, made anew when there are other files in the dataset: none is ever written twice."""
    return render(Fleet.of(dataset), dataset.folder, home=HOME)
