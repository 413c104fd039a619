"""Run the notebooks of examples/ and store their outputs: python tools/execute.py [NOTEBOOK ...].

Needs nbclient and ipykernel of the extra dev.
"""

import os
import sys
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

EXAMPLES = Path(__file__).parents[1] / "examples"
LONGEST = 300  # time limit of a cell [s]


def execute(path: Path) -> Any:
    """Return the notebook with new outputs; raises nbclient's CellExecutionError if a cell fails."""
    notebook = nbformat.read(path, nbformat.NO_CONVERT)
    here = str(Path(__file__).parents[1])  # use the code of this checkout
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))}
    NotebookClient(notebook, timeout=LONGEST, kernel_name="python3").execute(env=env)
    for cell in notebook.cells:
        cell.metadata = {}  # without execution times
        for output in cell.get("outputs", []):
            if "text/html" in output.get("data", {}):
                output.data.pop("text/plain", None)  # duplicate of the HTML
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return notebook


if __name__ == "__main__":
    notebooks = [Path(name) for name in sys.argv[1:]] or sorted(EXAMPLES.glob("*.ipynb"))
    for notebook in notebooks:
        nbformat.write(execute(notebook), notebook)
        print(f"wrote {notebook}")
