"""Effects of the library whose torque is most like a residual, drawn over it."""

from collections.abc import Sequence
from dataclasses import replace

from estimators.data.matches import Match, choose_rivals, find_matches
from estimators.data.regions import compute_profiles_at
from estimators.data.regression_data import RegressionData
from estimators.signals.residual import average_alike
from pendulum_env._typing import Array
from pendulum_env.formatting import capitalise, format_percent
from pendulum_env.physics.effect_texts import find_description, name_effect, name_effects
from workbench.figure import Figure, measure_reach
from workbench.narrator.parts import Part
from workbench.report.data import ReportData, Section
from workbench.report.evidence import describe_briefly, find_own_axis
from workbench.report.failures import DOTS, plot_profile
from workbench.report.numbers import COLORS

EXPLAINED = 2  # number of added effects above the fold


def plot_matches(
    data: RegressionData, residual: Array, matches: Sequence[Match], axes: Sequence[str], id: str, at: str = ""
) -> list[Figure]:
    """Plot a residual (R,) at a joint over some quantities as dots, with the torque of matches in its bins as curves.

    The first curves are the broadest, so that equal ones show.
    """
    samples, rows = data.data.part(at).samples, data.locate_rows(at)
    maps = [
        [profile, *(average_alike(profile, samples, match.torque[rows]) for match in matches)]
        for profile in compute_profiles_at(data, residual, at, axes)
    ]
    reach = max(measure_reach(profile.mean, profile.band) for profiles in maps for profile in profiles)
    curves = [(DOTS, "--measured"), *zip((name_effect(m.effect) for m in matches), COLORS, strict=False)]
    figures = [replace(plot_profile(curves, profiles, reach, id, at), height=230) for profiles in maps]
    for figure in figures:
        figure.data[-1 - len(matches)]["zorder"] = 1  # dots lie on the curves
        for k, line in enumerate(reversed(figure.data[-len(matches) :])):
            line["line"] |= {"width": 1.6 * (k + 1)}
    return figures


def name_match(match: Match) -> str:
    """Return the name of an effect, without its joint, and the share that it explains."""
    return (
        f"{capitalise(name_effect(match.effect.partition('@')[0]))}: {format_percent(round(max(match.share, 0.0), 3))}"
    )


def describe_match(match: Match) -> str:
    """State the number of parameters of an effect, and its sign in the residual."""
    return f"{match.size} parameter{'s' * (match.size > 1)}. {find_description(match.effect).signature}"


def make_rivals(case: ReportData) -> Section | None:
    """Make the section on each added effect beside its nearest rivals; None without an added effect.

    Each rival is fitted in the place of the effect. An effect at a joint has its rivals there. A coupling of joints has
    none.
    """
    selected, fitted, parts = case.diagnosis.selected, case.data.parts[0], list[Part]()
    steps = zip(case.diagnosis.steps, selected, strict=False)
    if not fitted.layout.predicts_torque:
        return None
    reasons = {tried.effect: describe_briefly(tried) for tried in case.diagnosis.candidates if tried.terms}
    pairs = [pair for pair in steps if not case.diagnosis.list_unconfirmed(pair[1:])]
    for k, (before, effect) in enumerate(pairs):
        data, at = fitted.with_link_states(before.model), effect.partition("@")[2]
        residual = data.residual(before.model.terms, before.model.theta)
        matches = find_matches(data, before.model, {*selected} - {effect}, at)
        if len(matches) < 2:
            continue
        figures, texts = list[Figure](), list[str]()
        for n, match in enumerate(choose_rivals(matches, effect)):
            (figure,) = plot_matches(data, residual, [match], [find_own_axis(effect)], f"rival-{k}-{n}", at)
            figures.append(replace(figure, caption=name_match(match)))
            texts.append(f"{capitalise(name_effect(match.effect))}: {describe_match(match)}")
            if match.effect != effect:
                share = format_percent(round(max(match.share, 0.0), 3))
                texts[-1] += f" In the place of {name_effect(effect)} it explains {share} of the residual."
                texts[-1] += f" {capitalise(reasons[match.effect])}." if match.effect in reasons else ""
        every = Part("Every effect in its place", [tuple(map(name_match, matches))], brief=False)
        parts.append(Part(f"Why {name_effect(effect)}", [tuple(figures), tuple(texts), every]))
    about = (
        "Dots: the residual without the effect. Curves: the effect, the rival that explains most in its place, and the "
        "law most like it. Each is fitted to the same data with all parameters, and explains a part of the mean square "
        "of the residual."
    )
    title = f"Why {name_effects([effect for _, effect in pairs])}"
    if len(parts) < 2:
        return Section("why", "Why", title, [about, *parts[0].content]) if parts else None
    further = [Part("Further effects", parts[EXPLAINED:], brief=False)] if parts[EXPLAINED:] else []
    return Section("why", "Why", title, [about, *parts[:EXPLAINED], *further])
