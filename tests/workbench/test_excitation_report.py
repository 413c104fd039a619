"""`evaluate`: its page, its figures, and the same work on a Dask cluster."""

import json

import numpy as np
import pytest

from agents import load
from agents.evaluation import Outcome, evaluation_json
from tests.workbench.pages import Page, whole
from workbench.cli import main
from workbench.commands.evaluate import show
from workbench.report.excitation import render
from workbench.terminal import Terminal

OPTIONS = ["--plants", "3", "--seed", "2"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with `page.html` and `figures.json` of an evaluation of `policy.npz`."""
    path = tmp_path_factory.mktemp("evaluation")
    load("peak").save(path / "policy.npz")
    outputs = ["--report", str(path / "page.html"), "--json", str(path / "figures.json")]
    assert main(["evaluate", str(path / "policy.npz"), *OPTIONS, *outputs]) == 0
    return path


def test_the_page_is_complete_and_loads_nothing(folder):
    text, told = (folder / "page.html").read_text(), json.loads((folder / "figures.json").read_text())
    page = whole(text)
    assert len(page.figures) == 4
    assert list(told["policies"]) == ["two-tone", str(folder / "policy.npz")]
    assert told["policies"]["two-tone"]["gain"]["information"]["ratio"] == pytest.approx(1.0)
    for name, figures in told["policies"].items():
        assert f"{name} " in page.text
        for moment, (_, middle, _) in figures["error"].items():
            assert f"{100 * middle:.3f}" in page.text, moment
        assert f"{figures['gain']['information']['ratio']:.2f}" in page.text


def test_curves_end_where_the_table_says(folder):
    page, told = Page((folder / "page.html").read_text()), json.loads((folder / "figures.json").read_text())
    curves = {trace["name"]: trace for trace in page.figures[1]["data"]}
    assert list(curves) == list(told["policies"])
    for name, figures in told["policies"].items():
        assert curves[name]["x"][-1] == pytest.approx(10.0)
        assert curves[name]["y"][-1] == pytest.approx(100 * figures["error"]["10 s"][1], rel=1e-3)


@pytest.mark.slow
def test_a_cluster_gives_the_same_figures(folder):
    distributed = pytest.importorskip("distributed")
    quiet = {"dashboard_address": ":0", "processes": False, "protocol": "tcp://"}  # any port that is free
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, **quiet) as cluster:
        path = folder / "there.json"
        policy = str(folder / "policy.npz")
        assert main(["evaluate", policy, *OPTIONS, "--dask", cluster.scheduler_address, "--json", str(path)]) == 0
    here, there = (json.loads((folder / name).read_text()) for name in ("figures.json", "there.json"))
    for name, figures in here["policies"].items():
        assert {**figures, "seconds_per_action": 0} == {**there["policies"][name], "seconds_per_action": 0}


def test_a_cluster_that_is_not_there_is_one_line(monkeypatch, refused):
    distributed = pytest.importorskip("distributed")

    def refuse(address: str, timeout: float) -> None:
        raise OSError(f"timed out after {timeout:g} s")

    monkeypatch.setattr(distributed, "Client", refuse)
    there = "tcp://127.0.0.1:1"
    assert f"there is no Dask cluster at {there}" in refused("evaluate", "prbs", "--plants", "2", "--dask", there)


def test_several_trainings_are_told_with_their_median_and_worst(capsys):
    def outcome(log_det: float, error: float) -> Outcome:
        course, none = np.full((500, 4), error), np.zeros((500, 4))
        return Outcome(course, course, none + log_det, np.full((3, 4), 1e-4), none, none, np.ones(4), 1e-3)

    outcomes = {"two-tone": outcome(0, 2e-3), "a": outcome(4, 1e-3), "b": outcome(3, 4e-3), "c": outcome(2, 2e-2)}
    figures = evaluation_json(
        outcomes, "two-tone", ["a", "b", "c"], plants=4, constraint="peak", scheme="energy", effects=(), spread=0.3
    )
    gain = figures["trainings"]["gain"]
    assert gain["information"] == pytest.approx({"median": np.exp(3 / 4), "worst": np.exp(2 / 4)})
    assert gain["error 2 s"] == pytest.approx({"median": 0.5, "worst": 0.1})
    assert gain["time to 1 %"]["worst"] == 0.0  # never reached
    show(figures, Terminal())
    assert "worst of the trainings" in capsys.readouterr().out
    assert "Worst of 3 trainings" in render(figures, outcomes)
