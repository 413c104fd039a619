"""The whole story in a real browser, over a real server."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.physics import Model
from pendulum_env.recording import Source, write_recording
from tests import slow
from tests.patience import PATIENCE
from tests.workbench.app.plants import record_pendulum, select_button, select_field

WIDTHS = (390, 860, 1024, 1440, 1920)  # [px], from a telephone to a large screen
MS = 1000 * PATIENCE  # as Playwright counts
ASCII = re.compile(r"->|`|(?<!\w)--[a-z]+|\bq'|\^[\dn]|\b(?:N|kg) m\b|\btau\b")  # signs of the command line
WORDS = """[...document.body.querySelectorAll(":not(pre):not(code):not(script):not(style)")].flatMap(
  (one) => [...one.childNodes].filter((node) => node.nodeType === 3).map((node) => node.textContent)).join("\\n")"""
STAGES = {
    "data": ".data .js-line",
    "model": ".model .plot",
    "compare": ".compare .js-line",
    "diagnose": select_button("diagnose"),
    "add": select_field("any"),
    "export": "#commands",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with `swing.csv`, a pendulum with hidden Stribeck friction, and `broken.csv`."""
    folder = tmp_path_factory.mktemp("runs")
    write_recording(record_pendulum("swing", 1, 10.0, rate=250.0), folder / "swing.csv")
    (folder / "broken.csv").write_text("time,position,torque\n0,0,0\n0.001,nan,0\n")
    return folder


@pytest.fixture(scope="module")
def loose(folder: Path) -> Path:
    """Recording of a pendulum with backlash, whose search takes seconds: long enough to see it run."""
    write_recording(record_pendulum("loose", 1, 20.0, "backlash", 1000.0), folder / "loose.csv")
    return folder / "loose.csv"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with served(end=signal.SIGINT) as (address, _):
        yield address


@contextmanager
def served(*options: str, end: int = signal.SIGTERM) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Address of a server of its own, started as a user starts it and ended by a signal, and its process."""
    command = [sys.executable, "-m", "workbench.cli", "app", "--port", "0", "--no-browser", *options]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
    ) as server:
        assert server.stdout is not None
        said = (re.search(r"http://127\.0\.0\.1:\d+/", line) for line in server.stdout)
        try:
            yield next(found[0] for found in said if found), server
        finally:
            server.send_signal(end)
            assert server.wait(PATIENCE) == 0


class Tab:
    """A browser of its own with one tab, which keeps what went wrong and where it called."""

    def __init__(self, browser, address: str, **options) -> None:
        self.address, self.complaints, self.calls = address, [], []
        self.context = browser.new_context(viewport={"width": 1280, "height": 900}, **options)
        self.page = self.context.new_page()
        self.page.set_default_timeout(MS)
        self.page.on("console", lambda m: self.complaints.append(m.text) if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.calls.append(request.url))
        self.page.goto(address)
        self.page.wait_for_selector("#upload")

    def load(self, file: Path, until: str = "") -> None:
        """Choose a file, and wait until it is listed, or until the page says something else."""
        self.choose_files("upload", str(file))
        self.page.wait_for_selector(until or f"td:has-text('{file.stem}')")
        self.page.wait_for_selector("h1:not(:text-is('Fitting the model'))")

    def choose_files(self, place: str, files) -> None:
        with self.page.expect_file_chooser() as chooser:
            self.page.click(f"#{place}")
        chooser.value.set_files(files)

    def go(self, stage: str) -> None:
        self.page.evaluate("scrollTo(0, 500)")
        self.page.click(f"#to-{stage}[href]")  # once the model is fitted
        self.page.wait_for_selector(STAGES[stage])
        assert self.page.evaluate("scrollY") == 0  # a stage begins at its top

    def choose(self, effect: str) -> None:
        """Pick an effect of the library by its name."""
        self.page.click(select_field("any"))
        self.page.fill(".dash-dropdown-search", effect)
        self.page.click(f".dash-dropdown-option:has-text('{effect}')")
        self.page.wait_for_selector(f"{select_field('any')}:has-text('{effect}')")

    def unreadable(self) -> list[str]:
        """Texts that are cut off by the window or by what holds them, or that lie on each other."""
        return self.page.evaluate(
            """() => {
              const texts = [], found = [], width = document.documentElement.clientWidth;
              const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
              while (walk.nextNode()) {
                const node = walk.currentNode, holder = node.parentElement, text = node.textContent.trim();
                if (!text || holder.closest("svg, script, style, .skip, [aria-hidden=true]") || !holder.checkVisibility(
                    {opacityProperty: true, visibilityProperty: true})) continue;
                const range = document.createRange();
                range.selectNodeContents(node);
                const lines = [...range.getClientRects()].filter((box) => box.width > 1 && box.height > 1);
                let scrolled = false;
                for (let one = holder; one !== document.body; one = one.parentElement) {
                  const {overflowX, position} = getComputedStyle(one), box = one.getBoundingClientRect();
                  scrolled ||= overflowX === "auto" || overflowX === "scroll" || position === "sticky";
                  if (overflowX === "hidden" && !scrolled && lines.some((line) => line.right > box.right + 1.5))
                    found.push(`cut: ${text}`);
                }
                if (scrolled) continue;
                if (lines.some((line) => line.left < -1 || line.right > width + 1)) found.push(`out: ${text}`);
                texts.push([text, lines]);
              }
              const share = (a, b) => Math.min(a.right - b.left, b.right - a.left) > 2 &&
                Math.min(a.bottom - b.top, b.bottom - a.top) > 0.3 * Math.min(a.height, b.height);
              texts.forEach(([a, ones], k) => texts.slice(k + 1).forEach(([b, others]) => {
                if (ones.some((one) => others.some((other) => share(one, other)))) found.push(`${a} on ${b}`);
              }));
              if (texts.length < 5) throw new Error("there is hardly any text");
              return found;
            }"""
        )

    def save(self, label: str) -> Path:
        with self.page.expect_download() as download:
            self.page.get_by_role("button", name=label, exact=True).click()
        return download.value.path()

    def title(self) -> str:
        return self.page.inner_text("h1")

    def close(self) -> None:
        self.context.close()
        assert self.complaints == []
        assert [url for url in self.calls if not url.startswith((self.address, "data:", "blob:"))] == []


@pytest.fixture
def tab(browser, address: str) -> Iterator[Tab]:
    tab = Tab(browser, address)
    yield tab
    tab.close()


def test_the_story_from_loading_to_undo(tab, folder):
    page = tab.page
    tab.load(folder / "broken.csv", "#notice:has-text('broken.csv')")
    assert tab.title() == "What does your model lack?"
    shutil.copy(folder / "swing.csv", folder / "broken.csv")  # it is mended, and dropped once more
    tab.load(folder / "broken.csv")
    assert page.inner_text("#notice") == ""
    page.get_by_role("button", name="Remove broken").click()
    page.wait_for_selector("td:has-text('broken')", state="detached")
    tab.load(folder / "swing.csv")
    assert tab.title() == "Something is missing in this model"
    tab.go("data")
    tab.go("model")
    assert page.locator(".model .plot").count() == 4
    assert all(scheme in page.inner_text("#stage") for scheme in ("Dynamic", "Energy", "Filtered Hamiltonian"))

    tab.go("compare")
    assert "the joint needs" in page.inner_text("#stage")

    tab.go("diagnose")
    page.click(select_button("diagnose"))
    page.wait_for_selector(".ranking")
    assert tab.title() == "Stribeck friction is missing"
    page.click(".evidence summary")
    page.wait_for_selector(".evidence[open] .js-line")
    assert "Lowers the held-out errors" in page.inner_text(".evidence[open]")
    assert page.locator(".ranking .evidence:visible").count() == 5

    before = number_after(r"error \(last 30 %\): torque", page.inner_text("#story"))
    page.get_by_role("button", name="Add Stribeck friction").click()
    page.wait_for_selector("p:has-text('All that the diagnosis calls for is in the model')")
    tab.go("add")
    after = number_after("→", page.inner_text("#story"))
    assert after < 0.3 * before
    page.wait_for_selector(".add .js-line")
    falls = page.evaluate(
        """[...document.querySelectorAll(".add .js-plotly-plot")].flatMap(
          (plot) => plot.data.filter((trace) => trace.marker).map((trace) => [...trace.y]))"""
    )
    assert len(falls) == 4 and all(after < before for before, after in falls)  # torque and motion, fitted and held out

    tab.go("export")
    assert "pendulum-ident add model.json stribeck swing.csv" in page.inner_text("#commands")
    report = tab.save("report.html").read_text(encoding="utf-8")
    assert "Stribeck friction is missing" in report
    assert Model.from_json(json.loads(tab.save("model.json").read_text())).effects == ("stribeck",)

    page.get_by_role("button", name="Undo: add Stribeck friction").click()
    page.wait_for_function("() => document.querySelector('h1').textContent === 'Stribeck friction is missing'")
    assert number_after(r"error \(last 30 %\): torque", page.inner_text("#story")) == before


READOUT = (
    "position, measured",
    "torque, measured",
    "position, base",
    "torque, base",
    "residual, base",
    "free run, base",
)
TOLD = """(words) => words.every((word) =>
  document.querySelector(".course .hoverlayer").textContent.includes(word))"""
SHADED = """([axis, low, high]) => {
  const { layout: { xaxis: { range }, shapes, meta: { axes } } } = document.querySelector(".course");
  const inside = axes.time.map((now) => shapes.some(({ x0, x1 }) => x0 <= now && now <= x1));
  const right = axes[axis].map((value) => low <= value && value <= high);
  return range[1] - range[0] < 3.1 && shapes.length > 0 && inside.every((is, k) => is === right[k]);
}"""


def test_plots_over_time_share_range_and_cursor_and_show_the_samples_of_a_sentence_or_stretch(tab, folder):
    page = tab.page
    page.emulate_media(reduced_motion="reduce")  # nothing moves while it is measured
    tab.load(folder / "swing.csv")
    tab.go("compare")
    places = [json.loads(one.get_attribute("data-where")) for one in page.locator("[data-where]").all()]
    place = next(one for one in places if one["axis"] == "velocity")
    page.locator("[data-where]").nth(places.index(place)).click()
    page.wait_for_function(SHADED, arg=["velocity", place["low"], place["high"]])
    rows = page.locator(".course .nsewdrag")
    assert rows.count() == 4 and page.locator(".course .rangeslider-container").count() == 1
    cursors = []
    for row in (0, 3):
        box = rows.nth(row).bounding_box()
        page.mouse.move(box["x"] + (0.4 + 0.1 * row) * box["width"], box["y"] + box["height"] / 2, steps=3)
        page.wait_for_function(TOLD, arg=READOUT)
        line = page.locator(".course .spikeline").first.bounding_box()
        assert line["y"] <= rows.nth(0).bounding_box()["y"] + 1 and line["height"] > 4 * box["height"]
        cursors.append(line["x"])
    assert cursors[0] < cursors[1]
    now, measured, base = page.evaluate(
        """[parseFloat(document.querySelector(".replay output").textContent), ...[...document.querySelectorAll(
          ".replay .rod")].map((rod) => -parseFloat(rod.getAttribute("transform").slice(7)) * Math.PI / 180)]"""
    )
    swing = Source(folder / "swing.csv").read()
    near = swing.position[np.abs(swing.time - now) < 0.02]
    assert near.min() - 0.01 < measured < near.max() + 0.01  # the pendulums stand as at the cursor
    assert abs(base - measured) < 0.2
    page.locator(".replay button").click()
    page.wait_for_function(
        "now => parseFloat(document.querySelector('.replay output').textContent) > now + 0.3", arg=now
    )
    page.locator(".replay button").click()
    stripe = page.evaluate(
        """() => {
          const plot = document.querySelector("#profile-velocity"), [box] = plot.querySelectorAll(".nsewdrag");
          const wide = plot.layout.shapes.reduce((a, b) => (b.x1 - b.x0 > a.x1 - a.x0 ? b : a));
          plot.scrollIntoView();
          const { left, top } = box.getBoundingClientRect(), axis = plot._fullLayout.xaxis;
          return [left + axis.l2p((wide.x0 + wide.x1) / 2), top + 30, wide.x0, wide.x1];
        }"""
    )
    page.mouse.move(*stripe[:2])
    page.mouse.click(*stripe[:2])
    page.wait_for_function(SHADED, arg=["velocity", *stripe[2:]])
    is_drawn = """(theme) => document.documentElement.dataset.theme === theme &&
      document.querySelector(".course").layout.template.layout.font.color ===
      getComputedStyle(document.documentElement).getPropertyValue("--text")"""
    page.emulate_media(color_scheme="dark")  # colours follow the system
    page.wait_for_function(is_drawn, arg="dark")
    page.click(".theme")  # or the switch
    page.wait_for_function(is_drawn, arg="light")
    page.reload()  # and keep its choice
    page.wait_for_function("document.documentElement.dataset.theme === 'light'")


def test_a_stage_that_needs_data_opens_once_there_are_some_and_a_narrow_window_shows_where_one_is(tab, folder):
    page = tab.page
    page.set_viewport_size({"width": 420, "height": 900})
    page.wait_for_selector("#to-compare[aria-disabled=true][aria-describedby=reason]")
    assert page.inner_text("#reason") == "Load a recording first"
    page.dispatch_event("#to-compare", "click")
    tab.load(folder / "swing.csv")
    tab.go("compare")
    tab.go("export")
    place, holder = (page.locator(which).bounding_box() for which in ("#to-export", "#nav"))
    assert place["x"] >= holder["x"] and place["x"] + place["width"] <= holder["x"] + holder["width"] + 1


def test_a_recording_is_held_out_at_every_width_and_no_table_of_errors_is_cut_off(tab, folder):
    page = tab.page
    for name, seed in (("pair.train", 1), ("pair.holdout", 2)):
        write_recording(record_pendulum(name, seed, 6.0, rate=250.0), folder / f"{name}.csv")
    tab.choose_files("upload", [str(folder / f"pair.{part}.csv") for part in ("train", "holdout")])
    page.wait_for_selector("#to-add[href]")
    pressed = "button[aria-pressed=true]"
    assert page.locator(f".recordings {pressed}").all_inner_texts() == ["check", "fit"]  # by name, in their order
    for width in (1440, 860, 390):
        page.set_viewport_size({"width": width, "height": 900})
        for switch in page.locator(".recordings .views").all():
            place, holder = switch.bounding_box(), page.locator(".recordings .scroll").bounding_box()
            assert place["width"] > 40 and place["x"] + place["width"] <= holder["x"] + holder["width"] + 1
    page.get_by_role("button", name="fit pair.holdout").click()
    page.wait_for_selector(f".recordings tr:has-text('pair.holdout') {pressed}:text-is('fit')")
    page.get_by_role("button", name="check pair.holdout").click()
    page.wait_for_selector(f".recordings tr:has-text('pair.holdout') {pressed}:text-is('check')")
    page.wait_for_selector("#to-add[href]")
    sideways = "Math.max(...[...document.querySelectorAll('.scroll')].map((one) => one.scrollWidth - one.clientWidth))"
    assert page.evaluate(sideways) <= 0  # also the button that removes a recording is in sight
    page.set_viewport_size({"width": 1440, "height": 900})
    page.click("#to-add")
    tab.choose("Stribeck friction")
    page.click(select_button("add-any"))
    page.wait_for_selector(".add .js-line")
    for width in (1440, 860, 390):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate(sideways) <= 0
    page.set_viewport_size({"width": 1440, "height": 900})
    for stage in STAGES:
        tab.go(stage)
        assert ASCII.findall(page.evaluate(WORDS)) == [], stage


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_an_interrupt_ends_the_app_though_a_job_runs_and_a_page_is_open(browser, loose):
    with served(str(loose)) as (address, server):
        tab, held = Tab(browser, address), []
        tab.go("diagnose")
        tab.page.click(select_button("diagnose"))
        tab.page.wait_for_selector("#job progress")
        asks = re.compile("_dash-update-component")

        def polls(request) -> bool:
            return bool(re.search(r'"changedPropIds":\["[\w-]+\.n_intervals"\]', request.post_data or ""))

        tab.page.route(asks, lambda route: held.append(route) if polls(route.request) else route.continue_())
        with tab.page.expect_request(polls):
            pass
        tab.page.wait_for_timeout(500)
        tab.page.wait_for_selector("#waiting", state="hidden")  # what the page asks by itself, it asks unseen
        for route in held:
            route.continue_()
        tab.page.unroute(asks)
        server.send_signal(signal.SIGINT)
        assert server.wait(PATIENCE) == 0
        tab.page.wait_for_selector("#notice:has-text('does not answer any more')")
        tab.context.close()


def test_a_fit_that_ends_while_its_stage_is_drawn_is_shown(tab, folder):
    page, drawings, polls, holds = tab.page, [], [], [True]
    write_recording(record_pendulum("long", 1, 100.0, rate=1000.0), folder / "long.csv")

    def hold(route) -> None:
        """Hold the drawing of a state that is being fitted, and polls that come after the fit."""
        asked, answer = route.request.post_data or "", route.fetch()
        fits = "stage.children" in asked and "Fitting the model" in answer.text()
        told = bool(drawings) and ".n_intervals" in asked and '"version"' in answer.text()
        if holds and (fits or told):
            (drawings if fits else polls).append((route, answer))
        else:
            route.fulfill(response=answer)

    page.route(re.compile("_dash-update-component"), hold)
    tab.choose_files("upload", str(folder / "long.csv"))  # it is fitted for more than the 0.4 s that the answer waits
    for _ in range(int(MS / 100)):
        if not (drawings and polls):
            page.wait_for_timeout(100)
    assert drawings and polls
    with page.expect_response(lambda answer: ".n_clicks" in (answer.request.post_data or "")):  # of its new buttons
        for route, answer in drawings:
            route.fulfill(response=answer)
    page.wait_for_selector("h1:has-text('Fitting the model')")
    holds.clear()
    for route, answer in polls:
        route.fulfill(response=answer)
    page.wait_for_selector("h1:not(:text-is('Fitting the model'))")
    page.unroute_all(behavior="wait")


def number_after(words: str, text: str) -> float:
    return float(re.search(rf"{words} ([\d.]+)", text.replace("\N{NO-BREAK SPACE}", " "))[1])


@pytest.mark.parametrize("width", slow.but_first([1400, 420]))
def test_a_person_says_what_columns_mean_and_corrects_late_torque(tab, folder, width):
    swing = record_pendulum("swing", 1, 10.0)  # logged by a servo with a gear of 6, its current 8 ms late
    rows = zip(1e3 * swing.time[4:], np.degrees(-6 * swing.position[4:]), swing.torque[:-4] / 0.091, strict=True)
    text = "".join(f"{t:.9g},{q:.9g},{i:.9g},on\n" for t, q, i in rows)
    (folder / "servo.csv").write_text(f"when,motor_angle [deg],iq,mode\n{text}")
    page, of = tab.page, '[id=\'{{"field":"{}","of":{}}}\']'.format

    def pick(what: str, column: int, label: str) -> None:
        page.click(of(what, column))
        with page.expect_response(lambda answer: "stage.children" in (answer.request.post_data or "")):  # drawn anew
            page.click(f".dash-dropdown-option:has(:text-is('{label}'))")
        page.wait_for_selector(f"{of(what, column)}:has-text('{label}')")

    page.set_viewport_size({"width": width, "height": 900})
    tab.load(folder / "servo.csv", ".card .why")
    assert page.inner_text(".card .why").startswith("servo.csv: no column for time, torque among")
    assert [page.inner_text(of("unit", k)) for k in range(3)] == ["–", "deg (named)", "not clear yet"]
    assert page.get_attribute(of("conversion", 2), "placeholder") == "*0.091, *? or *-1"
    pick("role", 0, "time")
    assert page.inner_text(of("unit", 0)) == "s (assumed)"
    pick("unit", 0, "ms")
    page.fill(of("conversion", 1), "*-1/6")
    page.click(select_button("card-load"))
    page.wait_for_selector(".why:has-text(\"torque cannot be column 'iq' without a gain\")")
    page.fill(of("conversion", 2), "0.091")
    cut = "() => [...document.querySelectorAll('.scroll')].filter((one) => one.scrollWidth > one.clientWidth).length"
    assert page.evaluate(cut) == 0
    page.click(select_button("card-load"))
    page.wait_for_selector(select_button("align"))
    assert page.locator(".card").count() == 0 and "ms late" in page.inner_text("#stage")
    before = tab.title(), page.inner_text(".so-far .lead")
    page.click(select_button("align"))
    page.wait_for_selector("p:has-text('It is corrected in all that follows')")
    assert (tab.title(), page.inner_text(".so-far .lead")) != before
    assert page.evaluate(cut) == 0 or width < 600  # the table of recordings goes on sideways there, and shows it
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    study = tab.save("Save study.toml").read_text()
    assert 'position = "motor_angle [deg]*-1/6"' in study and 'torque = "iq*0.091"' in study
    page.click("#to-diagnose")
    page.wait_for_selector("p:has-text('It is corrected in all that follows')")


@pytest.mark.slow
def test_tabs_are_apart_and_a_reload_changes_nothing_not_even_what_runs(tab, browser, loose):
    page, other = tab.page, Tab(browser, tab.address)
    tab.load(loose)
    tab.go("add")
    tab.choose("Quadratic drag")
    tab.go("diagnose")
    page.click(select_button("diagnose"))
    page.wait_for_selector("#job progress")
    page.wait_for_selector("#job:has-text('effect'):has-text('s left') li")  # the ranking fills in
    page.reload()
    page.wait_for_selector("#job li")
    button = page.query_selector(select_button("cancel"))
    page.wait_for_timeout(1000)  # of several polls, which do not replace it under the pointer
    assert button.is_visible()
    button.click()  # the same stage, too
    page.wait_for_selector("#job:empty", state="attached")
    page.wait_for_selector(select_button("diagnose") + ":enabled")
    page.wait_for_timeout(1000)  # nothing comes of it later either
    assert tab.title() == "Something is missing in this model" and page.locator(".ranking").count() == 0
    tab.go("add")
    assert page.inner_text(select_field("any")) == "Quadratic drag"  # it was chosen before
    page.click(select_button("add-any"))
    page.wait_for_selector(f"{select_button('back')}:has-text('add')")
    other.page.reload()
    other.page.wait_for_selector("#upload")
    assert other.title() == "What does your model lack?"
    other.close()


@pytest.mark.slow
def test_a_keyboard_is_enough(tab):
    """The demo, a stage, the effects to compare with and a diagnosis, without a mouse."""
    page = tab.page

    def reach(selector: str) -> None:
        """Tab to something, from wherever the focus is, and press it."""
        for _ in range(80):
            if page.evaluate("selector => document.activeElement.matches(selector)", selector):
                page.keyboard.press("Enter")
                return
            page.keyboard.press("Tab")
        raise AssertionError(f"{selector} cannot be reached with the tab key")

    reach(select_button("demo"))
    page.wait_for_selector("td:has-text('demo-holdout')")
    page.wait_for_selector("#to-compare[href]")  # the model is fitted
    reach("#to-compare")
    page.wait_for_selector(STAGES["compare"])
    page.wait_for_selector(".matches")
    reach("[data-where]")
    reach(select_button("add"))
    page.wait_for_selector("h1:has-text('times smaller')")
    reach(select_button("back"))
    page.wait_for_selector("h1:has-text('Something is missing')")
    reach("#to-diagnose")
    page.wait_for_selector(select_button("diagnose"))
    reach(select_button("diagnose"))
    page.wait_for_selector(".ranking")
    reach(".ranking .action.primary")
    page.wait_for_selector("p:has-text('All that the diagnosis calls for is in the model')")
    reach(select_button("back"))
    page.wait_for_selector(".ranking .action.primary")


@pytest.mark.slow
def test_no_stage_is_wider_than_the_window_or_has_text_that_is_cut_or_overlaps(browser, address, folder):
    tab = Tab(browser, address, color_scheme="dark")
    tab.load(folder / "swing.csv")
    for stage in STAGES:
        tab.go(stage)
        for width in WIDTHS:
            tab.page.set_viewport_size({"width": width, "height": 900})
            tab.page.wait_for_timeout(300)  # for fonts and plots to settle
            fits = "width => document.documentElement.scrollWidth <= width"
            tab.page.wait_for_function(fits, arg=width, timeout=30_000)  # a plot may take longer on a busy machine
            assert tab.unreadable() == [], (stage, width)
    assert tab.page.evaluate("document.documentElement.dataset.theme") == "dark"
    tab.page.add_style_tag(content="#stage * {overflow: hidden; white-space: nowrap; max-width: 60px}")
    assert tab.unreadable() != []  # it would have shown
    tab.close()
