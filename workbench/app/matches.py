"""Effects of the library whose torque is most like the residual, drawn over it."""

from dataclasses import dataclass

from dash import html
from dash.development.base_component import Component

from estimators.data.regions import compute_profiles_at
from estimators.data.variants import rank_variants
from estimators.signals.residual import AXES, find_regions
from pendulum_env._typing import Array
from pendulum_env.formatting import capitalise, format_percent
from pendulum_env.physics.effect_texts import find_description, name_effect
from pendulum_env.physics.joints import list_effects
from workbench.app.parts import make_button, make_panel, show_content
from workbench.figure import Figure, make_axis, make_line, measure_reach
from workbench.report.data import ReportData
from workbench.report.failures import make_profile_axis
from workbench.report.numbers import COLORS


@dataclass(frozen=True)
class Match:
    """Effect fitted to the data beside the terms of the last model.

    Attributes:
        effect: id of the effect.
        share: share of the mean square of the residual that it explains.
        torque: the residual without it minus that with it (R,) [N m].
    """

    effect: str
    share: float
    torque: Array


def find_matches(case: ReportData) -> list[Match]:
    """Fit each further effect of the library to the residual of the last model; return the best for each colour."""
    data, model = case.parts[0][-1], case.diagnosis.model
    before, matches = case.compute_residuals(0)[-1], list[Match]()
    for id, kind in list_effects(model.mechanism).items():
        if id not in model.effects and (ranked := rank_variants(data, model.terms, kind)):
            after = data.residual(ranked[0].terms)
            matches.append(Match(id, 1 - float(after @ after) / float(before @ before), before - after))
    return sorted(matches, key=lambda match: -match.share)[: len(COLORS)]


def show_matches(case: ReportData, is_busy: bool) -> Component:
    """Render the residual of the last model over four quantities, with the torque of the best matches."""
    data, residual = case.parts[0][-1], case.compute_residuals(0)[-1]
    profiles_of_residual = compute_profiles_at(data, residual)
    if not find_regions(profiles_of_residual):
        return make_panel("What it looks like", html.P("The residual is within the noise: it looks like no effect."))
    matches = find_matches(case)
    maps = [[profile for profile in profiles_of_residual if not profile.is_spectrum]]
    maps += [compute_profiles_at(data, match.torque, axes=(*AXES,)) for match in matches]
    reach = max(measure_reach(profile.mean, profile.band) for profiles in maps for profile in profiles)
    figures = []
    for profiles in zip(*maps, strict=True):
        title, factor, unit = make_profile_axis(profiles[0])
        curves = zip(profiles, ("residual", *(name_effect(m.effect) for m in matches)), strict=True)
        lines = [
            make_line(factor * p.middle, p.mean, name, color, unit)
            for (p, name), color in zip(curves, ("--measured", *COLORS), strict=False)
        ]
        lines[0] |= {"mode": "markers", "marker": {"color": "--measured", "size": 5}}
        axes = {"xaxis": title, "yaxis": make_axis(f"residual [{unit}]", range=[-reach, reach])}
        layout = {**axes, "showlegend": False, "margin": {"t": 10}, "hovermode": "x"}
        figures.append(
            Figure(f"match-{profiles[0].axis}", f"Residual and effects over {profiles[0].axis}", lines, layout, 210)
        )
    about = (
        "Dots: the residual of the last model. Curves: the three effects that explain most of it, each fitted to the "
        "same data beside the terms of the model. Only the diagnosis checks them on other data."
    )
    rows = [
        html.Li(
            [
                html.I(className="stroke", style={"--color": f"var({color})"}),
                html.Strong(capitalise(name_effect(match.effect))),
                html.Span(f"explains {format_percent(round(match.share, 3))} of the mean square"),
                make_button("Try it", "add", match.effect, disabled=is_busy),
                html.Small(find_description(match.effect).signature),
            ]
        )
        for match, color in zip(matches, COLORS, strict=False)
    ]
    plots = show_content([about, tuple(figures)], "matches")
    return make_panel("What it looks like", *plots, html.Ul(rows, className="matches"))
