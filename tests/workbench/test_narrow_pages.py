"""Every report at the width of a telephone: no plot, legend or label is cut, and what goes on sideways shows it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.two_link import TwoLink
from estimators import compare
from pendulum_env.physics import BASE, Model
from pendulum_env.recording import Recording, write_recording
from robots.servos import ServoDrive
from tests import slow, two_link
from tests.cases import diagnosed
from tests.patience import wait_until
from tests.workbench.app.plants import record_pendulum
from workbench.cli import main
from workbench.figure import Figure, make_axis, make_line
from workbench.report import render, render_comparison, write_report
from workbench.report.data import ReportData
from workbench.report.numbers import make_errors, plot_errors
from workbench.report.page import render_page

TELEPHONE = {"width": 420, "height": 900}  # [px]
CUT = """() => [...document.querySelectorAll(".plot")].flatMap((plot) => {
  const whole = plot.querySelector(".main-svg").getBoundingClientRect();
  const beyond = (box) => box.width && (box.left < whole.left - 1 || box.right > whole.right + 1 ||
    box.top < whole.top - 1 || box.bottom > whole.bottom + 1);
  const parts = [...plot.querySelectorAll("svg text:not(.modebar *):not(.legendtext), .legend .bg")];
  const found = parts.filter((part) => beyond(part.getBoundingClientRect())).map((part) => `cut: ${part.textContent}`);
  const legend = plot.querySelector(".legend .bg")?.getBoundingClientRect();
  const field = plot.querySelector(".nsewdrag").getBoundingClientRect();
  if (legend && legend.bottom > field.top + 2) found.push("the legend lies on the plot");
  const names = [...plot.querySelectorAll(".legendtext")].map((name) => name.getBoundingClientRect());
  if (names.some((name) => name.bottom > legend.bottom + 2)) found.push("the legend is cut");
  if (field.height < 60) found.push(`${field.height} px are left to the plot`);
  return found.map((what) => `${plot.id}: ${what}`);
})"""

AT_GOAL = """([times, goals, near]) => {
  const now = parseFloat(document.querySelector(".replay output").textContent);
  const goal = goals[times.findIndex((time) => time >= now - 0.006)];
  return Math.abs(now - near) < 0.3 && [...document.querySelectorAll(".replay .goal")].every((mark) =>
    Math.abs(-parseFloat(mark.getAttribute("transform").slice(7)) * Math.PI / 180 - goal) < 0.06);
}"""


def found():
    return diagnosed([record_pendulum("run one", 1, 6.0)], [record_pendulum("run two", 2, 6.0)])


def of_a_pendulum(folder: Path) -> str:
    return render(found())


def of_many_curves(folder: Path) -> str:
    """A legend of ten names, and a ladder of four models with long names."""
    diagnosis = found()
    base, step = diagnosis.steps[:2]
    several = tuple(replace(step, added=id) for id in ("coulomb_asymmetry", "position_dependent_friction", "stribeck"))
    case = ReportData(replace(diagnosis, steps=(base, *several)))
    time = np.linspace(0.0, 10.0, 50)
    curves = [make_line(time, np.sin(k + time), f"a curve with a name, {k}", "--base", "rad") for k in range(10)]
    many = Figure("many", "Many", curves, {"xaxis": make_axis("time [s]"), "yaxis": make_axis("angle [rad]")})
    figures = many, plot_errors(case, "torque_rms", "torque error [N m]", 0.01)
    section = make_errors(ReportData(diagnosis))
    return render_page([replace(section, content=[figures, *section.content[1:]])], "curves")


def of_a_comparison(folder: Path) -> str:
    data = found().data
    return render_comparison(compare(found().steps[0].model, data.holdout))


def of_an_arm(folder: Path) -> str:
    robot, run = folder / "arm.urdf", folder / "run.csv"
    robot.write_text(TwoLink().urdf())
    write_recording(two_link.record_arm(TwoLink(), seconds=6.0, rate=500.0, offset=(0.0, 0.3)), run)
    command = ["diagnose", run, "--robot", robot, "--only", "torque_offset", "--report", folder / "page.html"]
    assert main([*map(str, command)]) == 0
    return (folder / "page.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(browser):
    return browser.new_page(viewport=TELEPHONE)


@pytest.mark.parametrize("write", slow.but_first([of_many_curves, of_a_pendulum, of_a_comparison, of_an_arm]))
def test_nothing_is_cut(page, tmp_path, write):
    (tmp_path / "shown.html").write_text(write(tmp_path), encoding="utf-8")
    page.goto((tmp_path / "shown.html").as_uri())
    page.evaluate("() => document.querySelectorAll('details').forEach((one) => one.remove())")  # drawn once opened
    for place in page.query_selector_all(".plot"):
        place.scroll_into_view_if_needed()
        place.wait_for_selector(".nsewdrag", state="attached")
    wait_until(lambda: not page.evaluate(CUT), lambda: "\n".join(page.evaluate(CUT)))  # heights settle
    assert page.evaluate("document.documentElement.scrollWidth") <= TELEPHONE["width"]


def test_a_printed_report_is_on_the_screen_as_it_was_before(browser, tmp_path):
    (tmp_path / "shown.html").write_text(of_a_pendulum(tmp_path), encoding="utf-8")
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.goto((tmp_path / "shown.html").as_uri())
    for place in page.query_selector_all(".plot"):
        place.evaluate("plot => { if (plot.checkVisibility()) plot.scrollIntoView(); }")
        if place.is_visible():
            place.wait_for_selector(".nsewdrag", state="attached")
    look = """() => [[...document.querySelectorAll(".plot")].filter((plot) => plot.checkVisibility()).map(
      (plot) => Math.round(plot.querySelector(".main-svg").getBoundingClientRect().width)),
      [...document.querySelectorAll("details")].map((one) => one.open), document.documentElement.dataset.theme]"""
    before = page.evaluate(look)
    assert min(before[0]) > 340 and before[1] and not any(before[1])  # in print, two in a row have 330, three 220
    assert (
        page.evaluate(
            "Math.min(...[...document.querySelectorAll('.plot:not(.strip *)')].map((one) => one.offsetWidth || 1e3))"
        )
        > 400
    )
    page.pdf(path=tmp_path / "printed.pdf")
    wait_until(lambda: page.evaluate(look) == before, lambda: str((before, page.evaluate(look))))
    page.close()


def test_a_servo_moves_with_the_cursor_beside_a_mark_at_its_goal(browser, tmp_path):
    time = np.arange(400) / 100
    goal, position = np.sin(3 * time), 0.9 * np.sin(3 * time - 0.2)
    drive = ServoDrive(output="torque", kp=2.5, limit=6.0, rate=1000.0)
    servo = Recording(time, position, 2.5 * (goal - position), reference=goal, drive=drive, name="servo")
    write_report(compare(Model.build(BASE, [0.012, 0.9, 0.05, 0.08]), servo), tmp_path / "shown.html")
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.goto((tmp_path / "shown.html").as_uri())
    plot = page.locator("#loop-0 .nsewdrag")
    plot.scroll_into_view_if_needed()
    for share in (0.3, 0.6):
        plot.hover(position={"x": share * plot.bounding_box()["width"], "y": 60})
        wait_until(
            lambda share=share: page.evaluate(AT_GOAL, [time.tolist(), goal.tolist(), 4 * share]),
            lambda: page.inner_text(".replay"),
        )
    page.close()


A4 = {"width": 688, "height": 1017}  # [px] inside the margins


def test_a_printed_report_has_whole_captions_no_instructions_and_two_pages_before_the_details(browser, tmp_path):
    (tmp_path / "shown.html").write_text(of_a_pendulum(tmp_path), encoding="utf-8")
    page = browser.new_page(viewport=A4)
    page.goto((tmp_path / "shown.html").as_uri())
    page.wait_for_selector("#why .main-svg", state="attached")
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    captions = page.locator("#why figcaption")
    assert captions.count() == 3 and all(text.endswith("%") for text in captions.all_inner_texts())
    assert page.evaluate(
        "[...document.querySelectorAll('figcaption')].every((one) => one.scrollWidth <= one.clientWidth)"
    )
    wait_until(lambda: page.evaluate("document.querySelector('#failures').offsetTop") < 2 * A4["height"])
    told = page.inner_text("main")
    assert "Residual" in told.title() and "Choose a sentence" not in told and "opens to" not in told
    page.close()
