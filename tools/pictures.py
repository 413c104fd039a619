"""Make the pictures of the report, the app and the environment for the pages: python -m tools.pictures.

Needs Chromium and the extra dev; without Chromium, no picture changes.
"""

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from estimators import diagnose
from estimators.wrappers import EstimateParameters
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
FILM, SHOWN = (930, 675), 2200  # size [px], and time of a picture [ms], of the film
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


def environment() -> None:
    """Save a picture of the environment with stops as docs/environment.png."""
    stops = {"hard_stop": {"stiffness": 80.0, "lower": -1.2, "upper": 1.5}}
    env = EstimateParameters(gym.make("pendulum_env/DirectDrivePendulum-v0", render_mode="rgb_array", effects=stops))
    env.reset(seed=1)
    for k in range(3000):
        env.step(np.array([4 * np.sin(0.006 * k)], dtype=np.float32))
        if k % 20 == 0:  # the trail has the pictures before
            picture = env.render()
    env.close()
    Image.fromarray(picture).quantize(COLOURS).save(ROOT / "docs" / "environment.png", optimize=True)
    print("wrote docs/environment.png")


def tour(tab: Page, folder: Path) -> None:
    """Save pictures of the app with a recording that hides Stribeck friction, and a film from Compare to Add."""
    frames = list[Image.Image]()

    def film() -> None:
        tab.wait_for_timeout(700)  # for fonts and plots
        frames.append(Image.open(io.BytesIO(tab.screenshot())).convert("RGB").resize(FILM, Image.Resampling.LANCZOS))

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
        film()
        tab.locator("[data-where]").first.click()
        film()
        tab.evaluate("document.querySelector('.matches').parentElement.scrollIntoView()")
        film()
        tab.click("#to-diagnose")
        tab.click(select_button("diagnose"))
        tab.wait_for_selector("#job li")
        film()
        tab.wait_for_selector(".ranking .action.primary")
        film()
        tab.locator(".evidence summary").first.click()
        tab.evaluate("document.querySelector('.ranking').scrollIntoView()")
        film()
        tab.click(".ranking .action.primary")
        tab.wait_for_selector("p:has-text('All that the diagnosis calls for is in the model')")
        tab.click("#to-add")
        tab.wait_for_selector(".add .js-line")
        save_screenshot(tab, "app-add", full_page=True)
        film()
        server.terminate()
    first, *others = frames
    path = ROOT / "docs" / "story.webp"
    first.save(path, save_all=True, append_images=others, duration=SHOWN, loop=0, quality=72, method=6)
    print(f"wrote {path.relative_to(ROOT)}")


if __name__ == "__main__":
    gallery(ROOT / GALLERY)
    print(f"wrote {GALLERY}")
    environment()
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
