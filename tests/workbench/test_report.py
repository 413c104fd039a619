"""The page of a diagnosis."""

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.two_link import TwoLink
from estimators import Comparison, compare, identify
from estimators.checks.homogeneity import Difference, Disagreement
from estimators.data.fit_data import FitData
from estimators.data.matches import Match, choose_rivals
from estimators.data.regions import compute_profiles_at
from estimators.decisions.errors import Step
from estimators.decisions.gate import FailedGates, Gate
from estimators.diagnosis.result import Candidate, Diagnosis
from estimators.findings import Verdict
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.identifiability import Gap, Undetermined
from estimators.signals.residual import Region, compute_profiles, find_regions
from pendulum_env.formatting import capitalise, format_number, typeset
from pendulum_env.physics import Samples
from pendulum_env.physics.effect_texts import name_parameter
from robots.arms import arm_base
from tests import two_link
from tests.cases import diagnosed
from tests.workbench.app.plants import record_pendulum
from tests.workbench.pages import Page, list_figures, values, whole
from workbench.figure import insert_gaps, measure_reach, round_numbers, select_samples
from workbench.narrator.diagnosis import describe_region
from workbench.narrator.findings import describe_reason
from workbench.report import PENDULUM, render
from workbench.report.comparison import make_comparison
from workbench.report.data import ReportData
from workbench.report.evidence import make_candidates
from workbench.report.failures import make_failures, plot_profile
from workbench.report.matches import make_rivals

HOSTILE = "</script><script>alert(1)</script>&\"'{{ 7 * 7 }}"
REGION = Region("position", 0.1, 0.2, 0.05, 9.0, "rad", held_out_recordings=("<run>",))


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    return diagnosed([record_pendulum("run one", 1, 6.0)], [record_pendulum("run two", 2, 6.0)])


@pytest.fixture(scope="module")
def page(diagnosis) -> str:
    return render(diagnosis)


def test_page_loads_nothing_from_elsewhere_and_links_to_every_section(page, diagnosis):
    found = whole(page)
    sections = [attrs["id"] for tag, attrs in found.tags if tag == "section"]
    assert len(sections) == len(PENDULUM) - (diagnosis.suggestion is None)
    assert {f"#{id}" for id in sections} <= set(values(found, "href"))
    colors = [value for value in values(found, "style") if value.startswith("--color")]
    assert colors and all(re.fullmatch(r"--color: var\(--[a-z0-9-]+\)", color) for color in colors)
    assert len(found.figures) >= 10 and len(page.encode()) < 3_000_000
    assert all(len(trace["x"]) <= 6000 for figure in found.figures for trace in figure["data"])


def test_schemes_are_left_out_where_recordings_are_too_poor_for_them(diagnosis, monkeypatch):
    def refuse(*_):
        raise IdentificationError("too short")

    assert 'id="schemes"' in render(diagnosis)
    monkeypatch.setattr("workbench.report.data.identify", refuse)
    assert 'id="schemes"' not in render(diagnosis)


def test_numbers_in_the_text_are_those_of_the_diagnosis(page, diagnosis):
    text = Page(page).text
    assert diagnosis.selected == ("stribeck",)
    assert "Stribeck friction is missing" in text
    for step in diagnosis.steps:
        for errors in step.errors.values():
            assert f"{errors.torque_rms:.4g}" in text and f"{errors.position_rms:.4g}" in text
    assert format_number(diagnosis.floors[""], padded=True) in text
    for name, estimate in diagnosis.model.estimates.items():
        assert capitalise(name_parameter(name)) in text
        assert f"± {estimate.std:.{1 - int(np.floor(np.log10(estimate.std)))}f}" in text
    for candidate in diagnosis.candidates:
        assert capitalise(typeset(describe_reason(candidate))) in text


def test_parameters_that_the_base_model_got_wrong_are_told(page, diagnosis):
    wrong, right = (step.model.estimates["coulomb"].value for step in diagnosis.steps)
    told = re.search(r"coulomb = ([\d.]+) # N m, was ([\d.]+)", Page(page).text)
    assert [float(told[1]), float(told[2])] == pytest.approx([right, wrong], rel=1e-3) and wrong > 1.01 * right


def test_the_report_tells_the_recordings_the_values_to_use_and_why_it_is_no_rival(page, diagnosis):
    found = Page(page)
    recording = diagnosis.data.recordings[0]
    assert f"{recording.duration:.3g}" in found.text and f"{recording.rate:.4g}" in found.text
    ids = [id for id in values(found, "id") if id.startswith(("rival-", "trace-"))]
    rivals = [f"rival-0-{k}-velocity" for k in range(3)]
    assert ids == [*rivals, "trace-0-0", "trace-1-0"]
    case = ReportData(diagnosis)
    section = make_rivals(case)
    left = []
    for figure in list_figures(section.content):
        dots, curve = (np.array(trace["y"]) for trace in figure.data[-2:])
        x = [np.array(trace["x"]) for trace in figure.data[-2:]]
        assert np.array_equal(*x)  # the curve is averaged in the bins of the dots
        left.append(np.std(dots - np.interp(x[0], x[1], curve)))
    assert left[0] < 0.5 * min(left[1:])  # the curve of the effect alone lies in the dots


def test_an_effect_that_was_not_tried_is_not_told_as_rejected(diagnosis):
    untried = Candidate("backlash", 0.0, Verdict.REJECTED, 1.0, FailedGates((Gate("excitation", 0.0, 1.0, False),)))
    rows = make_candidates(ReportData(replace(diagnosis, candidates=(*diagnosis.candidates[:2], untried)))).content
    assert [row.verdict for row in rows if hasattr(row, "verdict")] == ["selected", "rejected", "not tried"]


def test_hostile_names_stay_text(diagnosis):
    parts = diagnosis.data.recordings, diagnosis.data.holdout
    data = FitData(*(tuple(replace(own, name=HOSTILE) for own in part) for part in parts))
    page = render(replace(diagnosis, data=data))
    assert "<script>alert" not in page
    found = Page(page)
    assert HOSTILE in found.text
    assert len([tag for tag, _ in found.tags if tag == "script"]) == 5 + len(found.figures) - 1


def test_open_questions_are_told(diagnosis):
    def told(found) -> str:
        return Page(render(found)).text

    plain = told(replace(diagnosis, steps=diagnosis.steps[:1]))
    assert "Nothing is missing" in plain and "times smaller" not in plain
    silent = Candidate("hard_stop", 0.0, Verdict.NOT_EXCITED, 1.0, FailedGates((Gate("excitation", 0.0, 1.0, False),)))
    uncertain = replace(
        diagnosis,
        ambiguous=(("stribeck", "presliding"),),
        unexplained=(REGION,),
        findings=(Undetermined(Gap.ONE_DIRECTION),),
        candidates=(*diagnosis.candidates, silent),
    )
    text = told(uncertain)
    assert "Stribeck friction or presliding is missing, and more that no known effect explains" in text
    assert "In the held-out data (<run>): for q from 0.1 to 0.2 rad the joint needs 0.05 N·m more torque" in text
    assert "Record both directions." in text
    assert capitalise(typeset(describe_reason(silent))) in text
    heavier = Disagreement(2, "friday", ("monday",), (Difference("inertia", "kg m^2", 0.099, 0.09, 0.001),))
    disagreeing = told(replace(diagnosis, findings=(heavier,)))
    assert "Recording 2 (friday) disagrees with 'monday': inertia 10 % higher" in disagreeing
    stuck = replace(diagnosis, steps=diagnosis.steps[:1], unexplained=(REGION,))
    assert "Something is missing, and no known effect explains it" in told(stuck)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.00739, "0.00739"), (-0.5, "−0.5"), (2.5e-7, "2.5 × 10⁻⁷"), (float("nan"), "–"), (0.0, "0"), (1234.5, "1230")],
)
def test_numbers_are_printed_without_exponents(value, text):
    assert format_number(value) == text


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("0.2 -> 0.1 N m", "0.2 → 0.1 N·m"),
        ("I q'' + b q' [N m s/rad^2]", "I q̈ + b q̇ [N·m·s/rad²]"),
        ("fs exp(-|q'/vs|^n) kg m^2", "fs exp(-|q̇/vs|ⁿ) kg·m²"),
        ("For tau from -0.86 to -.4", "For τ from −0.86 to −.4"),
        ("Correct it with --align, run `diagnose`, -57 +- 2", "Correct it with option align, run diagnose, −57 ± 2"),
        ("with --columns 'q=-2 N m' instead", "with --columns 'q=-2 N m' instead"),
        ("run-1.csv, 1e-05, half-open", "run-1.csv, 1e-05, half-open"),
    ],
)
def test_texts_of_the_command_line_are_set_for_a_page(text, shown):
    assert typeset(text) == shown == typeset(shown)


def test_curves_are_thinned_but_for_their_peaks_and_break_where_time_has_a_gap():
    series = np.zeros(100_000)
    series[[123, 77_777]] = 5.0, -5.0
    kept = select_samples(series, 1000)
    assert len(kept) <= 1000 and {123, 77_777} <= set(kept)
    time = np.r_[np.arange(5.0), np.arange(10.0, 15.0)]
    x, (y,) = insert_gaps(time, np.arange(10), time)
    assert np.flatnonzero(np.isnan(x)).tolist() == np.flatnonzero(np.isnan(y)).tolist() == [5]
    assert round_numbers(np.array([1.23456789, np.nan, -1e-9, 0.0])) == [1.2346, None, -1e-9, 0.0]


def test_a_diagnosis_that_was_read_from_a_file_has_no_report(diagnosis):
    with pytest.raises(ValueError, match="the diagnosis has no data"):
        render(replace(diagnosis, data=None))


def test_the_residual_of_a_joint_that_turns_is_drawn_over_one_turn():
    curves, time = [("base model", "--base")], np.arange(4000) * 0.005
    x = Samples(time, 1.5 * time, np.sin(time), np.cos(time))
    cogs = 0.1 * np.cos(7 * x.position)
    (around,) = compute_profiles(x, cogs, 0.01, ["position"])
    drawn = plot_profile(curves, [around], 0.2)
    angle = np.array(drawn.data[-1]["x"])
    assert "wrapped" in drawn.layout["xaxis"]["title"]["text"] and np.abs(angle).max() <= np.pi
    assert np.corrcoef(drawn.data[-1]["y"], np.cos(7 * angle))[0, 1] > 0.98  # not smeared over all turns
    assert all(-np.pi <= stripe["x0"] < stripe["x1"] <= np.pi for stripe in drawn.layout["shapes"])


def test_the_larger_a_mean_the_darker_its_stretch():
    time = np.arange(4000) * 0.005
    x = Samples(time, np.sin(time), np.cos(time), np.zeros(4000))
    bumps = 0.1 * ((time > 4) & (time < 6)) + 0.4 * ((time > 12) & (time < 14))
    plots = [plot_profile([("base", "")], compute_profiles(x, size * bumps, 0.01, ["time"]), 0.5) for size in (1, 0.5)]
    (early, late), (_, small) = (
        [max(s["opacity"] for s in drawn.layout["shapes"] if s["x0"] < at < s["x1"]) for at in (5, 13)]
        for drawn in plots
    )
    assert 0 < early < small < late <= 1  # plots that share a scale share the shades


def read_plot(figure) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Points x and y, band and shade (whether a stripe covers the point) of each curve of a plot of failures."""
    bands = [trace for trace in figure.data if trace.get("fill")]
    curves, read = [trace for trace in figure.data if not trace.get("fill")], []
    colors = [{stripe["fillcolor"] for stripe in figure.layout["shapes"]} & {"--region"}, {"--open"}]
    for trace, color in zip(curves, colors, strict=False):
        x, y = np.array(trace["x"]), np.array(trace["y"])
        band = next(np.array(one["y"][: len(x)]) for one in bands if len(one["x"]) == 2 * len(x))
        stripes = [stripe for stripe in figure.layout["shapes"] if stripe["fillcolor"] in color]
        read.append((x, y, band, np.array([any(one["x0"] <= at <= one["x1"] for one in stripes) for at in x])))
    return read


def check_failures(diagnosis: Diagnosis, joint: str = "") -> int:
    """Check that shade, points and sentences of a page agree; returns the number of sentences above the fold."""
    case = ReportData(diagnosis)
    section = make_failures(case)
    content = (
        section.content if not joint else next(p.content for p in section.content if getattr(p, "title", "") == joint)
    )
    figures = {figure.id.rpartition("-")[2]: figure for figure in list_figures(content)}
    for figure in figures.values():
        for _, y, band, is_shaded in read_plot(figure):
            clear = np.abs(np.abs(y) - band) > 1e-4 * band  # numbers of a plot are rounded
            assert np.array_equal(is_shaded[clear], (np.abs(y) > band)[clear]), figure.id
    for k, residual in enumerate(case.compute_residuals(0)):
        profiles = compute_profiles_at(case.data.parts[0], residual, joint)
        for region in find_regions([profile for profile in profiles if profile.axis in figures]):
            if not region.is_constant:
                x, y, _, _ = read_plot(figures[region.axis])[k]
                covered = y[(region.low < x) & (x < region.high)]
                told = covered.max() if region.peak is not None else covered.mean()
                assert region.residual == pytest.approx(told, rel=0.01)
                assert describe_region(region) in str(content)
    return len(next(item for item in content if isinstance(item, tuple) and item and isinstance(item[0], str)))


def test_sentences_shade_and_points_of_where_it_fails_agree(diagnosis):
    assert check_failures(diagnosis) == 3


def searched(found: Comparison) -> Diagnosis:
    """A comparison as a diagnosis without a search."""
    step = Step(None, found.model, dict.fromkeys(("train", "holdout"), found.joint.errors))
    return Diagnosis((step,), (), (), found.regions, found.joint.floors, (), data=found.data)


def test_the_shade_at_a_joint_of_an_arm_is_where_the_curve_leaves_its_band():
    arm = two_link.record_arm(TwoLink(drag=(0.0, 0.03)), seconds=8.0, rate=500.0)
    found = compare(identify(arm, arm_base(two_link.body())).primary.model, arm)
    assert check_failures(searched(found), "elbow") > 0


@pytest.mark.parametrize(("effect", "several"), [("torque_ripple", True), ("stribeck", False)])
def test_a_residual_that_no_quantity_explains_alone_is_told_as_such(effect, several):
    run = record_pendulum("run", 1, effect=effect)
    found = compare(identify(run).model, run)
    assert ("No single quantity" in str(make_failures(ReportData(searched(found))).content)) == several


def test_a_model_without_failure_fills_no_panel_with_its_band():
    time = np.arange(2000) * 0.01
    x = Samples(time, np.sin(time), np.cos(time), np.sin(2 * time))
    profiles = compute_profiles(x, 0.01 * np.random.default_rng(0).normal(size=2000), 0.01)
    assert find_regions(profiles) == []
    reach = max(measure_reach(profile.mean, profile.band) for profile in profiles if not profile.is_spectrum)
    for profile in profiles:
        drawn = plot_profile([("model", "--base")], [profile], reach)
        assert max(drawn.data[0]["y"]) < 0.5 * drawn.layout["yaxis"]["range"][1]


def test_the_band_of_noise_fills_no_plot_of_measured_against_modelled_torque(diagnosis):
    for figure in list_figures(make_comparison(ReportData(diagnosis)).content):
        band = next(trace for trace in figure.data if trace.get("fill"))
        assert max(band["y"]) < 0.5 * figure.layout["yaxis3"]["range"][1]


def test_the_page_shows_how_to_do_it_again_if_that_is_known(page, diagnosis):
    command = "pendulum-ident diagnose 'run one.csv' --only stribeck --fix gravity=2"
    assert command in Page(render(diagnosis, command)).text
    assert "Do it again" not in Page(page).text


def test_a_sentence_shows_fitted_samples_which_have_its_sign(diagnosis):
    case = ReportData(diagnosis)
    fitted, held_out = (figure.layout["meta"] for figure in list_figures(make_comparison(case).content))
    assert fitted["recording"][0] == "run one" and held_out["axes"]["time"] == []
    regions = find_regions(compute_profiles_at(case.data.parts[0], case.compute_residuals(0)[0]))
    residual = np.array(fitted["residuals"][0])
    told = [region for region in regions if region.axis in fitted["axes"] and not region.is_constant]
    assert len(told) > 3
    for region in told:
        values = np.array(fitted["axes"][region.axis])
        assert np.sign(residual[(region.low <= values) & (values <= region.high)].mean()) == np.sign(region.residual)


def test_rivals_are_the_one_that_explains_most_and_the_law_most_like_the_effect():
    shares = {"torque_ripple": 0.99, "periodic_disturbance": 0.07, "joint_flexibility": 0.05, "cogging": 0.02}
    matches = [Match(id, share, np.zeros(1), 3) for id, share in shares.items()]
    chosen = [match.effect for match in choose_rivals(matches, "torque_ripple")]
    assert chosen == ["torque_ripple", "periodic_disturbance", "cogging"]
    at_joint = [Match(f"{id}@elbow", share, np.zeros(1), 3) for id, share in shares.items()]
    assert [m.effect for m in choose_rivals(at_joint, "torque_ripple@elbow")] == [f"{id}@elbow" for id in chosen]


def test_no_rival_with_a_curve_is_called_not_tried(diagnosis):
    reason = FailedGates((Gate("earlier_effects", 1.0, 0.0, False),))
    left_out = tuple(replace(one, terms=(), reason=reason) for one in diagnosis.candidates)
    assert "not tried" in describe_reason(left_out[0])
    assert "ot tried" not in str(make_rivals(ReportData(replace(diagnosis, candidates=left_out))).content)
