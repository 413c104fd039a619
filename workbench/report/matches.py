"""Effects of the library whose torque is most like a residual, drawn over it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from estimators.data.regions import compute_profiles_at
from estimators.data.regression_data import RegressionData
from estimators.data.variants import rank_variants
from pendulum_env._typing import JSON, Array
from pendulum_env.formatting import capitalise, format_percent, join_words
from pendulum_env.physics import Model
from pendulum_env.physics.effect_texts import find_description, name_effect
from pendulum_env.physics.joints import list_effects
from workbench.figure import Figure, make_axis, make_line, make_title, measure_reach
from workbench.narrator.parts import Part
from workbench.report.data import ReportData, Section
from workbench.report.evidence import describe_briefly, find_own_axis
from workbench.report.failures import make_profile_axis
from workbench.report.numbers import COLORS

EXPLAINED = 2  # largest number of added effects that are compared with their rivals
RIVALS = 2  # number of rivals of each


@dataclass(frozen=True)
class Match:
    """Effect fitted to the data beside the terms of a model.

    Attributes:
        effect: id of the effect.
        share: share of the mean square of the residual that it explains.
        torque: the residual without it minus that with it (R,) [N m].
    """

    effect: str
    share: float
    torque: Array

    @property
    def title(self) -> str:
        """Return the name of the effect, and the share."""
        return f"{capitalise(name_effect(self.effect))}: {format_percent(round(self.share, 3))}"


def find_matches(data: RegressionData, model: Model, without: Sequence[str] = ()) -> list[Match]:
    """Fit each further effect of the library to the residual of a model, the best first; leave some out."""
    before, matches = data.residual(model.terms, model.theta), list[Match]()
    for id, kind in list_effects(model.mechanism).items():
        if id not in (*model.effects, *without) and (ranked := rank_variants(data, model.terms, kind)):
            after = data.residual(ranked[0].terms)
            matches.append(Match(id, 1 - float(after @ after) / float(before @ before), before - after))
    return sorted(matches, key=lambda match: -match.share)


def plot_matches(
    data: RegressionData, residual: Array, matches: Sequence[Match], axes: Sequence[str], id: str, title: str = ""
) -> list[Figure]:
    """Plot a residual (R,) over some quantities as dots, with the torque of matches as curves."""
    maps = [compute_profiles_at(data, series, axes=axes) for series in (residual, *(m.torque for m in matches))]
    reach = max(measure_reach(profile.mean, profile.band) for profiles in maps for profile in profiles)
    figures = []
    for profiles in zip(*maps, strict=True):
        axis, factor, unit = make_profile_axis(profiles[0])
        curves = zip(profiles, ("residual", *(name_effect(m.effect) for m in matches)), strict=True)
        lines = [
            make_line(factor * p.middle, p.mean, name, color, unit)
            for (p, name), color in zip(curves, ("--measured", *COLORS), strict=False)
        ]
        lines[0] |= {"mode": "markers", "marker": {"color": "--measured", "size": 5}}
        layout: JSON = {"xaxis": axis, "yaxis": make_axis(f"residual [{unit}]", range=[-reach, reach])}
        layout |= {"showlegend": False, "margin": {"t": 30 if title else 10}, "hovermode": "x"}
        layout |= make_title(title) if title else {}
        name = f"Residual and effects over {profiles[0].axis}"
        figures.append(Figure(f"{id}-{profiles[0].axis}", name, lines, layout, 240 if title else 210))
    return figures


def make_rivals(case: ReportData) -> Section | None:
    """Make the section on each added effect beside its nearest rivals; None without an added effect."""
    steps, selected = case.diagnosis.steps, case.diagnosis.selected
    parts, fitted = list[Part](), case.data.parts[0]
    if not fitted.layout.predicts_torque or not case.diagnosis.model.mechanism.can_simulate:
        return None
    for k, (before, after) in enumerate(pairwise(steps[: EXPLAINED + 1])):
        data, effect = fitted.with_link_states(before.model), after.added or ""
        residual, others = data.residual(before.model.terms, before.model.theta), {*selected} - {effect}
        matches = find_matches(data, before.model, [*others])
        own = [match for match in matches if match.effect == effect]
        compared = [*own, *[match for match in matches if match.effect != effect][:RIVALS]]
        figures = [
            figure
            for n, match in enumerate(compared)
            for figure in plot_matches(data, residual, [match], [find_own_axis(effect)], f"rival-{k}-{n}", match.title)
        ]
        parts.append(Part(f"Why {name_effect(effect)}", [tuple(figures), *_list_reasons(case, compared, effect)]))
    about = (
        "Dots: the residual without the effect. Curves: the effect and its two nearest rivals, each fitted to the same "
        "data. Each explains the given part of the mean square of the residual."
    )
    title = f"Why {join_words([name_effect(effect) for effect in selected])}"
    return Section("why", "Why", title, [about, *(parts if len(parts) > 1 else parts[0].content)]) if parts else None


def _list_reasons(case: ReportData, compared: Sequence[Match], effect: str) -> list[tuple[str, ...]]:
    """List how each effect looks, and of a rival why it was not selected."""
    candidates = {candidate.effect: candidate for candidate in case.diagnosis.candidates}
    texts = []
    for match in compared:
        text = f"{capitalise(name_effect(match.effect))}: {find_description(match.effect).signature}"
        if match.effect != effect and match.effect in candidates:
            text += f" Beside {name_effect(effect)}: {describe_briefly(candidates[match.effect])}."
        texts.append(text)
    return [tuple(texts)] if texts else []
