"""Make the pictures of the pages that no page prints: python -m tests.pictures.

Needs chromium beside the extra dev; without it, pictures stay as they are.
"""

import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from estimators import diagnose
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.plant import make_plant
from tests.gallery import gallery
from tests.prose import ROOT
from workbench.report import write_report

HIDDEN = ["spring:stiffness=0.25,preload=0.1", "stribeck:stribeck=0.5,stribeck_velocity=0.8"]
GALLERY = "workbench/app/assets/gallery"
SIZE = {"width": 1180, "height": 1470}  # [px] of the top of a report
COLOURS = 256


def report(path: Path) -> None:
    """The report of a diagnosis that finds two effects."""
    plant = make_plant(effects=HIDDEN)
    recordings = [
        record(plant, excitation("paper", seed), 30, name=name, rng=seed)
        for seed, name in [(1, "monday"), (2, "tuesday")]
    ]
    training, holdout = recordings[:1], recordings[1:]
    write_report(path, training, holdout, diagnose(training, holdout))


def picture(page: Path, chromium: str) -> Image.Image:
    """The top of a page as a browser shows it."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--headless", "--no-sandbox"])
        tab = browser.new_page(viewport=SIZE)
        tab.goto(page.as_uri())
        tab.wait_for_selector(".main-svg")
        tab.wait_for_timeout(500)  # for fonts and plots to settle
        shown = Image.open(io.BytesIO(tab.screenshot()))
        browser.close()
    return shown.convert("RGB").quantize(COLOURS)


if __name__ == "__main__":
    gallery(ROOT / GALLERY)
    print(f"wrote {GALLERY}")
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("docs/report.png was left as it is: chromium is not installed")
    with tempfile.TemporaryDirectory() as folder:
        report(Path(folder) / "report.html")
        picture(Path(folder) / "report.html", chromium).save(ROOT / "docs" / "report.png", optimize=True)
    print("wrote docs/report.png")
