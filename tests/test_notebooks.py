"""The notebooks of examples/ run, and still say what is stored in them."""

import re
from html import unescape

import pytest

from tools.prose import find_missing_line

pytest.importorskip("nbclient", reason="running the notebooks needs nbclient")
pytest.importorskip("ipykernel", reason="running the notebooks needs ipykernel")

from tools.execute import EXAMPLES, execute

VARIES = "# Results differ between processors."  # first line of a cell whose output is not compared


def words(cell) -> str:
    """What a reader sees of a cell's outputs, but for the curves."""
    told = []
    for output in cell.outputs:
        assert output.output_type != "error"
        html = output.get("data", {}).get("text/html", "")
        told.append(output.get("text", "") or re.sub(r"<svg.*?</svg>|</(div|tr|li)>", "\n", html, flags=re.S))
    return unescape(re.sub("<[^>]+>", " ", "\n".join(told)))


@pytest.mark.slow
@pytest.mark.pages
@pytest.mark.parametrize("name", ["reinforcement_learning", "tutorial", "paper"])
def test_a_notebook_runs_and_its_stored_output_is_what_comes_out(name):
    import nbformat

    if name == "reinforcement_learning":
        pytest.importorskip("stable_baselines3", reason="training needs the extra rl")
    path = EXAMPLES / f"{name}.ipynb"
    stored = [cell for cell in nbformat.read(path, 4).cells if cell.cell_type == "code"]
    fresh = [cell for cell in execute(path).cells if cell.cell_type == "code"]
    assert len(fresh) > 5
    for old, new in zip(stored, fresh, strict=True):
        line = None if new.source.startswith(VARIES) else find_missing_line(words(old), words(new))
        assert line is None, f"{path.name} shows what no longer comes out, run tools/execute.py: {line}"
