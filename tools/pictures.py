"""Make the pictures of the report and the app for the pages: python -m tools.pictures.

Needs Chromium and the extra dev; without Chromium, no picture changes.
"""

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from estimators import diagnose
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.plant import make_plant
from pendulum_env.recording import write_recording
from tests.test_machines import DATA
from tests.workbench.app.plants import record_pendulum, select_button
from tools.gallery import gallery, machines
from tools.prose import ROOT
from workbench.report import write_report

HIDDEN = ["spring:stiffness=0.25,preload=0.1", "stribeck:stribeck=0.5,stribeck_velocity=0.8"]
GALLERY = "docs/gallery"
MACHINES = "docs/machines"
SIZE = {"width": 1180, "height": 1470}  # of a picture of the report [px]
WINDOW = {"width": 1240, "height": 900}  # of the app [px]
COLOURS = 256


def report(path: Path) -> None:
    """Write the report of a diagnosis that finds two effects."""
    plant = make_plant(effects=HIDDEN)
    recordings = [
        record(plant, excitation("paper", seed), 30, name=name, rng=seed)
        for seed, name in [(1, "monday"), (2, "tuesday")]
    ]
    training, holdout = recordings[:1], recordings[1:]
    write_report(diagnose(training, holdout), path)


def save_screenshot(tab: Page, name: str, **options: bool) -> None:
    """Save a screenshot of the tab as docs/NAME.png."""
    tab.wait_for_timeout(500)  # for fonts and plots
    shown = Image.open(io.BytesIO(tab.screenshot(**options)))
    shown.convert("RGB").quantize(COLOURS).save(ROOT / "docs" / f"{name}.png", optimize=True)
    print(f"wrote docs/{name}.png")


def tour(tab: Page, folder: Path) -> None:
    """Save pictures of the app's stages with a recording that hides Stribeck friction."""
    write_recording(record_pendulum("swing", 1, 10.0), folder / "swing.csv")
    command = [sys.executable, "-m", "workbench.cli", "app", "--port", "0", "--no-browser", str(folder / "swing.csv")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        tab.goto(next(line.split(" is at ")[1].split()[0] for line in server.stdout if " is at " in line))
        tab.click("#to-compare[href]")  # enabled when the model is fitted
        tab.wait_for_selector(".matches")
        for plot in tab.locator(".compare .plot:visible").all():  # drawn when they come near
            plot.scroll_into_view_if_needed()
            plot.locator(".nsewdrag").first.wait_for(state="attached")
        tab.evaluate("scrollTo(0, 0)")
        save_screenshot(tab, "app-compare", full_page=True)
        tab.click("#to-diagnose")
        tab.click(select_button("diagnose"))
        tab.click(".ranking .action.primary")
        tab.wait_for_selector("p:has-text('All that the diagnosis calls for is in the model')")
        tab.click("#to-add")
        tab.wait_for_selector(".add .js-line")
        save_screenshot(tab, "app-add", full_page=True)
        server.terminate()


if __name__ == "__main__":
    gallery(ROOT / GALLERY)
    print(f"wrote {GALLERY}")
    if DATA.is_dir():
        machines(ROOT / MACHINES, DATA)
        print(f"wrote {MACHINES}")
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("pictures of the report and of the app were left as they are: chromium is not installed")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--headless", "--no-sandbox"])
        tab = browser.new_page(viewport=SIZE)
        report(Path(folder) / "report.html")
        tab.goto((Path(folder) / "report.html").as_uri())
        tab.wait_for_selector(".main-svg")
        save_screenshot(tab, "report")
        tour(browser.new_page(viewport=WINDOW), Path(folder))
        browser.close()
