"""The pages of docs/ build without a warning, load nothing from elsewhere, and hold what they promise."""

import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from estimators.schemes.six import SCHEMES
from pendulum_env.physics import effects
from pendulum_env.physics.effect_texts import find_description
from workbench.cli import COMMANDS

for module in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
    pytest.importorskip(module, reason="building the pages needs the extra docs")

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The site as it was built."""
    folder = tmp_path_factory.mktemp("site")
    # without --quiet, which would also keep warnings from counting
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="module")
def site(folder) -> dict[str, str]:
    """Every page by its place."""
    return {str(page.relative_to(folder)): page.read_text(encoding="utf-8") for page in folder.rglob("*.html")}


class Loaded(HTMLParser):
    """Addresses that a browser loads by itself."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        loads = tag in ("script", "img", "iframe") or (tag == "link" and values.get("rel") not in ("next", "prev"))
        self.addresses += [values[name] for name in ("src", "href") if loads and values.get(name)]


def text(page: str) -> str:
    return re.sub(r"<[^>]+>", "", page)


def test_pages_load_nothing_from_elsewhere(site):
    assert len(site) > 15
    for place, page in site.items():
        found = Loaded(page).addresses
        assert found, place
        assert not [address for address in found if re.match(r"(\w+:)?//", address)], place


def test_equations_are_drawn_without_scripts(site):
    assert site["theory.html"].count("<math") > 50
    for place, page in site.items():
        assert "arithmatex" not in page, place
        assert not re.search(r"\\(frac|dot|theta|operatorname)\b", text(page)), place


TEXTS = [
    text
    for id in effects()
    for text in (id, find_description(id).signature, find_description(id).informative_experiment)
]


@pytest.mark.parametrize(
    ("place", "names"),
    [
        ("reference/command-line.html", COMMANDS),
        ("reference/effects.html", effects()),
        ("which-effect.html", TEXTS),
        ("reference/schemes.html", [scheme.id for scheme in SCHEMES]),
        ("theory.html", [scheme.id for scheme in SCHEMES]),
        ("reference/estimators.html", ["identify", "compare", "diagnose", "add", "Diagnosis"]),
        ("reinforcement_learning.html", ["missing: stribeck"]),  # a notebook with its outputs
    ],
)
def test_page_names_all_there_is(site, place, names):
    assert not [name for name in names if name not in text(site[place])]


def test_the_search_works_in_pages_that_were_opened_from_a_folder(folder):
    sync_api = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("chromium is not installed")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--headless", "--no-sandbox"])
        page = browser.new_page()
        page.goto((folder / "how-to" / "online-diagnosis.html").as_uri())
        page.click("[data-md-component=search-query]")
        page.get_by_text("Type to start searching").wait_for(state="attached")  # the index is there
        page.locator("[data-md-component=search-query]").press_sequentially("Stribeck", delay=20)
        page.wait_for_selector(".md-search-result__item", state="attached")
        found = page.locator(".md-search-result__link").evaluate_all("links => links.map(link => link.href)")
        browser.close()
    assert [link for link in found if link.startswith((folder / "reference" / "effects.html").as_uri())]
