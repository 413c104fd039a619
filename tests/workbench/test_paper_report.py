"""The page about the paper's experiment: self-contained, complete, its numbers and curves those of the experiment."""

import numpy as np
import pytest

from estimators.paper import TABLE_2, WAYS, Experiment
from tests.cases import of_the_paper
from tests.workbench.pages import Page, values, whole
from workbench.report.paper import SECTIONS, render


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return of_the_paper()


@pytest.fixture(scope="module")
def page(experiment: Experiment) -> str:
    return render(experiment)


@pytest.fixture(scope="module")
def figures(page: str) -> dict[str, dict]:
    """Figures by their id."""
    found = Page(page)
    ids = [attrs["id"] for tag, attrs in found.tags if tag == "div" and "plot" in (attrs.get("class") or "").split()]
    return dict(zip(ids, found.figures, strict=True))


def curve(figure: dict, name: str) -> np.ndarray:
    return next(np.array([t["x"], t["y"]], dtype=float) for t in figure["data"] if t["name"] == name)


def test_page_is_whole_and_loads_nothing_from_elsewhere(page: str, figures: dict[str, dict]) -> None:
    found = whole(page)
    assert len(page.encode()) < 4_000_000
    sections = [attrs["id"] for tag, attrs in found.tags if tag == "section"]
    assert sections == list(SECTIONS) and {f"#{id}" for id in sections} <= set(values(found, "href"))
    expected = {f"figure-{k}" for k in range(2, 8)}
    assert set(figures) == expected | {"figure-8a", "figure-8b", "figure-9-printed", "figure-9-ours"}
    assert all(f"Figure {k}" in found.text for k in range(2, 10))


def test_table_holds_the_papers_values_and_ours(page: str, experiment: Experiment) -> None:
    text = Page(page).text
    for scheme, row in TABLE_2.items():
        for shown in (value for value in row if value is not None):
            assert f"{shown:.4f}" in text
        for way in ("ours", "printed"):
            assert all(f"{value:.4f}" in text for value in experiment.score(way, scheme).theta[1:])
    for way in WAYS:
        assert way.text[1:] in text


@pytest.mark.parametrize(("number", "scheme"), [(2, "dynamic"), (7, "filtered_hamiltonian")])
def test_convergence_is_drawn_with_truth_and_band(number, scheme, figures, experiment) -> None:
    figure = figures[f"figure-{number}"]
    course = experiment.found[0]["ours"][scheme].convergence
    for k, place in enumerate(("", "2", "3", "4")):
        panel = {"data": [trace for trace in figure["data"] if trace["yaxis"] == f"y{place}"]}
        assert curve(panel, "truth")[1] == pytest.approx([experiment.truth[k]] * 2)
        np.testing.assert_allclose(curve(panel, "ours")[1], course.theta[:, k], rtol=1e-3, atol=1e-4)
        assert curve(panel, "ours, 95 % band")[1].size == 2 * len(course.time)
        low, high = figure["layout"][f"yaxis{place}"]["range"]
        assert low < experiment.truth[k] < high


def test_a_missed_aim_is_said(monkeypatch: pytest.MonkeyPatch, experiment: Experiment) -> None:
    monkeypatch.setattr("workbench.report.paper.TARGET", 1e-9)
    text = Page(render(experiment)).text
    assert "Not every scheme finds the paper's pendulum" in text and "which misses the aim" in text


def test_following_is_drawn_as_measured_and_as_simulated(figures, experiment) -> None:
    position = figures["figure-8a"]
    measured, simulated, error = (curve(position, n) for n in ("measured", "simulated", "simulated − measured"))
    np.testing.assert_allclose(simulated[1] - measured[1], error[1], atol=2e-4)
    assert np.abs(error[1]).max() < 0.02 < np.ptp(measured[1])
    torque = figures["figure-8b"]
    applied, jagged = curve(torque, "applied"), curve(torque, "calculated by backward differences")
    assert np.std(jagged[1] - applied[1]) > 0.2  # the paper's peaks


def test_norms_are_drawn_beside_that_of_the_truth(figures, experiment) -> None:
    for way in ("printed", "ours"):
        norms = experiment.norms(way)
        models, truth = figures[f"figure-9-{way}"]["data"]
        assert models["x"] == pytest.approx(list(norms.models.values()), rel=1e-4)
        assert truth["x"] == pytest.approx([norms.truth] * 2, rel=1e-4)
