"""Evidence for and against each effect: verdict, reason, residual before and after, held-out error, and gates."""

from collections.abc import Sequence

from estimators.data.regions import compute_profiles_at
from estimators.decisions.gate import FailedGates
from estimators.diagnosis.result import Candidate
from estimators.findings import Verdict
from pendulum_env.formatting import TextTable, format_percent
from pendulum_env.physics import has_link, list_loads
from pendulum_env.physics.effect_texts import find_description, name_effect, name_effects
from workbench.figure import Figure, measure_reach
from workbench.narrator.findings import describe_reason
from workbench.narrator.parts import Content, Evidence, Legend, Part
from workbench.narrator.results import GATE_HEADERS, NAT, narrate_detectable
from workbench.report.data import ReportData, Section
from workbench.report.failures import plot_profile

FIRST = 5  # number of effects above the fold
# By a symptom's word
OWN_AXES = {"angle": "position", "speed": "velocity", "standstill": "velocity", "torque": "torque"}
CURVES = (("without it", "--base"), ("with it", "--final"))


def make_candidates(case: ReportData) -> Section | None:
    """Make the section with a row of evidence for every effect, accepted effects first; None without any."""
    if not case.diagnosis.candidates:
        return None
    candidates = sorted(case.diagnosis.candidates, key=lambda candidate: not candidate.verdict.is_accepted)
    rows: list[Evidence | Part] = [make_evidence(case, k, candidate) for k, candidate in enumerate(candidates)]
    others = [Part(f"Other effects, {len(rows) - FIRST} of {len(rows)}", rows[FIRST:], brief=False)]
    bar = "The bar is the part of the held-out torque error that the effect removes beside the selected effects."
    about = "A row opens to the evidence.", bar, f"p: probability of such a gain by chance; {NAT}."
    content: Content = [*about, *rows[:FIRST], *others[: len(rows[FIRST:])], *narrate_detectable(case.diagnosis)]
    return Section("candidates", "Candidates", "What was considered", content)


def make_evidence(case: ReportData, number: int, candidate: Candidate) -> Evidence:
    """Make the row of evidence on one effect."""
    gates = [gate.cells for gate in candidate.decision.gates]
    brief, reason = describe_briefly(candidate), describe_reason(candidate)
    content: Content = [
        *([reason] if reason != brief else []),
        *plot_candidate(case, number, candidate),
        *([TextTable(GATE_HEADERS, gates, left=("gate", "result"))] if gates else []),
    ]
    fall = min(1.0, max(0.0, 1.0 - candidate.error_ratio)) if candidate.terms else 0.0
    verdict = candidate.verdict if candidate.terms or candidate.verdict is not Verdict.REJECTED else "not tried"
    return Evidence(name_effect(candidate.effect), fall, verdict, brief, content)


def plot_candidate(case: ReportData, number: int, candidate: Candidate) -> Sequence[Legend | Figure]:
    """Plot the residual without and with an effect over the effect's own quantity.

    Beside a link, whose states need simulation, the first and the final model are plotted for a selected effect. Empty
    for other effects there, for an effect that was not tried, and for motion in a loop.
    """
    data, terms, is_selected = case.data.parts[0], candidate.terms, candidate.verdict is Verdict.SELECTED
    if not terms or (has_link(terms) and not is_selected) or not data.layout.predicts_torque:
        return []
    joints = next(term.at for term in terms if term.id == candidate.effect)
    at = next(iter(list_loads(joints)))  # of a coupling, its first joint
    if has_link(terms):
        before, *_, after = case.compute_residuals(0)
    else:
        before, after = map(data.residual, (tuple(term for term in terms if term.id != candidate.effect), terms))
    axes = [find_own_axis(candidate.effect)]
    profiles = [profile for series in (before, after) for profile in compute_profiles_at(data, series, at, axes)]
    reach = max((measure_reach(profile.mean, profile.band) for profile in profiles), default=0.0)
    legend = Legend(tuple(("stroke", color, name) for name, color in CURVES))
    return [legend, plot_profile(CURVES, profiles, reach, f"evidence-{number}", at)] if profiles else []


def find_own_axis(effect: str) -> str:
    """Return the quantity over which an effect shows."""
    symptom = find_description(effect).symptom or ""
    return next((axis for word, axis in OWN_AXES.items() if word in symptom), "time")


def describe_briefly(candidate: Candidate) -> str:
    """State in a plain clause why an effect is in the model or not."""
    fall, reason = 1.0 - candidate.error_ratio, candidate.reason
    if candidate.verdict is Verdict.SELECTED and fall > 0:
        return f"lowers the held-out torque error by {format_percent(fall)}"
    if isinstance(reason, FailedGates) and reason.has_gate("p_value"):
        chance = next(gate.value for gate in reason.gates if gate.name == "p_value")
        beside = f" beside {name_effects(reason.selected)}," if reason.selected else ""
        return f"does not lower the error{beside} on data that it was not fitted to, p = {chance:.2g}"
    return describe_reason(candidate)
