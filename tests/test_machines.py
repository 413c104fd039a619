"""What the page on real machines prints, where their recordings are; on most computers they are not."""

import gzip
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tools.prose import ROOT, blocks, find_missing_line, isolated_folder, outputs

PAGE = ROOT / "docs" / "machines.md"
DATA = ROOT.parent / "shared" / "data"
TAKES = "it takes the recordings"
PLACES = {"emps": "", "odrive": "", "xl330_loop": "xl330", "tx40": "", "dfki": "", "dfki_double": ""}

pytestmark = [pytest.mark.slow, pytest.mark.pages]


def place(folder: Path) -> None:
    """The recordings under the names that the page gives them."""
    page = PAGE.read_text(encoding="utf-8")
    for origin, name in PLACES.items():
        (folder / name).mkdir(exist_ok=True)
        for file in (DATA / origin).iterdir():
            if file.suffix == ".gz" and file.name not in page:
                with gzip.open(file) as packed, open(folder / name / file.stem, "wb") as plain:
                    shutil.copyfileobj(packed, plain)
            else:
                shutil.copy(file, folder / name)


@pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not on this machine")
def test_what_the_page_shows_of_real_machines_is_what_is_printed(tmp_path: Path) -> None:
    place(tmp_path)
    found = [replace(one, why=None) if one.why == TAKES else one for one in blocks(PAGE.read_text(encoding="utf-8"))]
    with isolated_folder(tmp_path):
        for output in outputs(PAGE, found):
            line = find_missing_line(output.shown, output.printed)
            assert line is None, f"{output.where}: shows what is not printed: {line}\n\n{output.printed}"
