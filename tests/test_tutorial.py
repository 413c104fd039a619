"""The tutorial notebook runs, and still says what is stored in it."""

import re
from html import unescape

import pytest

from tools.prose import first_untold

pytest.importorskip("nbclient", reason="running the notebook needs nbclient")
pytest.importorskip("ipykernel", reason="running the notebook needs ipykernel")

from tools.execute import TUTORIAL, execute


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
def test_tutorial_runs_and_its_stored_output_is_what_comes_out():
    import nbformat

    stored = [cell for cell in nbformat.read(TUTORIAL, 4).cells if cell.cell_type == "code"]
    fresh = [cell for cell in execute().cells if cell.cell_type == "code"]
    assert len(fresh) > 5
    for old, new in zip(stored, fresh, strict=True):
        line = first_untold(words(old), words(new))
        assert line is None, f"examples/tutorial.ipynb shows what no longer comes out, run tools/execute.py: {line}"
    told = "".join(map(words, fresh))
    assert "Stribeck friction is missing" in told
    assert "Stribeck friction and cubic damping are missing" in told
