"""Effects of the library whose torque is most like a residual, drawn over it."""

from collections.abc import Sequence
from dataclasses import replace

from estimators.data.matches import Match, find_matches
from estimators.data.regions import compute_profiles_at
from estimators.data.regression_data import RegressionData
from pendulum_env._typing import Array
from pendulum_env.formatting import capitalise, format_percent, join_words
from pendulum_env.physics.effect_texts import find_description, name_effect
from workbench.figure import Figure, make_title, measure_reach
from workbench.narrator.parts import Part
from workbench.report.data import ReportData, Section
from workbench.report.evidence import describe_briefly, find_own_axis
from workbench.report.failures import DOTS, plot_profile
from workbench.report.numbers import COLORS

EXPLAINED = 2  # largest number of added effects that are compared with their rivals
RIVALS = 2  # number of rivals of each


def plot_matches(
    data: RegressionData, residual: Array, matches: Sequence[Match], axes: Sequence[str], id: str
) -> list[Figure]:
    """Plot a residual (R,) over some quantities as dots, with the torque of matches as curves."""
    maps = [compute_profiles_at(data, series, axes=axes) for series in (residual, *(m.torque for m in matches))]
    reach = max(measure_reach(profile.mean, profile.band) for profiles in maps for profile in profiles)
    curves = [(DOTS, "--measured"), *zip((name_effect(m.effect) for m in matches), COLORS, strict=False)]
    figures = (plot_profile(curves, profiles, reach, id) for profiles in zip(*maps, strict=True))
    return [replace(figure, height=230) for figure in figures]


def name_match(match: Match) -> str:
    """Return the name of an effect with the share that it explains."""
    return f"{capitalise(name_effect(match.effect))}: {format_percent(round(match.share, 3))}"


def make_rivals(case: ReportData) -> Section | None:
    """Make the section on each added effect beside its nearest rivals; None without an added effect."""
    selected, fitted, parts = case.diagnosis.selected, case.data.parts[0], list[Part]()
    if not fitted.layout.predicts_torque or not case.diagnosis.model.mechanism.can_simulate:
        return None
    reasons = {candidate.effect: describe_briefly(candidate) for candidate in case.diagnosis.candidates}
    for k, (before, effect) in enumerate(zip(case.diagnosis.steps, selected[:EXPLAINED], strict=False)):
        data = fitted.with_link_states(before.model)
        residual = data.residual(before.model.terms, before.model.theta)
        matches = find_matches(data, before.model, {*selected} - {effect})
        compared = sorted(matches, key=lambda match: match.effect != effect)[: RIVALS + 1]  # the effect comes first
        figures, texts = list[Figure](), list[str]()
        for n, match in enumerate(compared):
            figures += plot_matches(data, residual, [match], [find_own_axis(effect)], f"rival-{k}-{n}")
            figures[-1].layout.update(margin={"t": 30}, **make_title(name_match(match)))
            texts.append(f"{capitalise(name_effect(match.effect))}: {find_description(match.effect).signature}")
            if match.effect != effect and match.effect in reasons:
                texts[-1] += f" Beside {name_effect(effect)}: {reasons[match.effect]}."
        parts.append(Part(f"Why {name_effect(effect)}", [tuple(figures), tuple(texts)]))
    about = (
        "Dots: the residual without the effect. Curves: the effect and its two nearest rivals, each fitted to the same "
        "data. Each explains the given part of the mean square of the residual."
    )
    title = f"Why {join_words([name_effect(effect) for effect in selected])}"
    return Section("why", "Why", title, [about, *(parts if len(parts) > 1 else parts[0].content)]) if parts else None
