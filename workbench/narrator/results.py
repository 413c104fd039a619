"""Results as parts, each a title with tables, sentences and lists; the command line prints and notebooks show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from estimators.checks.homogeneity import Disagreement
from estimators.diagnosis.result import Addition, Candidate, Detectable, Diagnosis, HorizonRefit, Verdict
from estimators.results import Comparison
from estimators.selection.criterion import Criterion
from estimators.selection.errors import Errors, Step
from estimators.signals.residual import SYMBOLS, Profile
from estimators.simulation.free_running import HORIZON
from pendulum_env.formatting import TextTable, draw_bar, format_quantity, join_words
from pendulum_env.physics import Model
from pendulum_env.physics.estimate import shorten_name
from pendulum_env.quantity import Quantity
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.units import TURNING, JointUnits, to_shown_unit
from workbench.narrator.addition import describe_addition, describe_table
from workbench.narrator.comparison import describe_loop, describe_unstable
from workbench.narrator.diagnosis import (
    describe_detectable,
    describe_disagreement,
    describe_refit,
    describe_region,
    describe_treatment,
    describe_unexplained,
)
from workbench.narrator.findings import describe, measure
from workbench.narrator.parts import Content, Part
from workbench.narrator.reasons import ERRORS, FLOOR_SOURCES, describe_reason

NEXT = "What to do next"
RUNNERS_UP = 5  # rejected candidates that are shown
BIASED = "Biased by a missing effect; the size of the bias is unknown."
SCORE = (
    "score: probability that the effect is missing; nat: natural logarithm of the likelihood ratio on data that the "
    "effect was not fitted to"
)
LEGEND = (
    "noise floor: torque error caused by sensor noise alone; fit: 100 % less the error relative to the deviation of "
    "the measurement from its mean; held out: not fitted"
)
CLEAR = "clear of stick and reversals"
FOLLOWED = 80.0  # [%] of the motion in free runs, below which torque alone does not make a good model


def narrate_diagnosis(found: Diagnosis) -> list[Part]:
    """Narrate a diagnosis, with the candidates that matter."""
    units = found.model.units()
    if not found.body.can_simulate:
        table = tabulate_joints(get_end_errors(found.steps), found.floors, found.model)
        errors = Part(f"Torque errors on held-out data, {CLEAR}", [table])
    else:
        errors = Part("Errors", narrate_errors(found))
    parts = [
        errors,
        Part("Parameters", [tabulate_parameters(found.model), *([BIASED] if found.unexplained else [])]),
        narrate_candidates(found.candidates),
    ]
    if found.refit is not None:
        parts.insert(1, Part(f"Free motion over {found.refit.seconds:g} s", narrate_refit(found.refit, units)))
    if found.detectable:
        parts.append(
            Part("Smallest effects that would have shown", [tabulate_detectable(found.detectable)], brief=False)
        )
    if treatments := tuple(describe_treatment(one) for one in found.treatments):
        parts.append(Part("Treatments of the recordings that were tried", [treatments], brief=False))
    if left := tuple(describe_unexplained(found, region) for region in found.unexplained):
        parts.append(Part("Left unexplained", [left]))
    return parts


def narrate_errors(found: Diagnosis) -> Content:
    """Narrate the errors of a pendulum or a servo after every step."""
    noise = describe_noise(found.steps[0], found.noise_floor)
    return [tabulate_errors(found.steps, found.model.units()), describe_fit(found.steps), noise, LEGEND]


def narrate_refit(refit: HorizonRefit, units: JointUnits) -> Content:
    """Narrate the errors before and after a refit to free motion."""
    factor, angle = to_shown_unit(1.0, units.unit("rad"))
    errors = f"torque [{units.unit(NEWTON_METRE)}]", f"position [{angle}]"
    headers = ("model", *(f"{what}, {part}" for part in ("fitted", "held out") for what in errors))
    steps = {"before the refit": refit.before} | ({"after it": refit.after} if refit.after is not None else {})
    rows = []
    for name, step in steps.items():
        sizes = [size for own in step.errors.values() for size in (own.torque_rms, factor * own.position_rms)]
        rows.append((name, *(format_quantity(size, 4) for size in sizes)))
    return [TextTable(headers, rows), describe_refit(refit)]


def get_end_errors(steps: Sequence[Step], part: str = "holdout") -> tuple[Errors, Errors]:
    """Return the errors of the first and the last model."""
    return steps[0].errors[part], steps[-1].errors[part]


def narrate_candidates(candidates: Sequence[Candidate], most: int | None = RUNNERS_UP) -> Part:
    """Narrate the candidates that matter, with the meaning of their score, and the gates that they met.

    `most` is the largest number of those that were left out.
    """
    ranking, more = tabulate_candidates(candidates, most)
    shown = {row[0] for row in ranking.rows}
    gates = [(one.effect, *gate.cells) for one in candidates if one.effect in shown for gate in one.gates]
    table = TextTable(("effect", "gate", "value", "limit", "result"), gates, left=("gate", "result"))
    more_text = [f"and {more}: --json and --report list all"] if more else []
    return Part("Candidates", [ranking, *more_text, SCORE, *([table] if gates else [])], brief=False)


def narrate_disagreements(found: Sequence[Disagreement]) -> list[Part]:
    """Narrate the recordings that show another plant than the others, if there are any."""
    return [Part("Recordings that disagree", [tuple(describe_disagreement(one) for one in found)])] if found else []


def narrate_addition(found: Addition) -> list[Part]:
    """Narrate the errors before and after, what follows from them, and the parameters."""
    sentences = [
        describe_addition(found),
        *filter(None, [describe_table(found.after) if found.objection is None else None]),
    ]
    if found.left > Criterion.misfit:
        sentences.append(
            f"The residual is {found.left:.1f} times the noise floor: another effect is missing. Run `diagnose`."
        )
    if found.doubt is not None:
        sentences.append(f"warning: {describe(found.doubt)}")
    title, steps, parameters = "the model refitted without and with the effect", (found.before, found.after), []
    parameters = [Part("Parameters", [tabulate_parameters(found.model)])]
    body = found.model.body
    if body.can_simulate:
        return [Part(f"Errors, {title}", [tabulate_errors(steps, found.model.units()), *sentences]), *parameters]
    fitted, unseen = (
        tabulate_joints(get_end_errors(steps, part), found.floors, found.model) for part in ("train", "holdout")
    )
    return [
        Part(f"Torque errors on fitted data, {title}", [fitted]),
        Part(f"Torque errors on held-out data, {title}", [unseen, *sentences]),
        *parameters,
    ]


def narrate_comparison(found: Comparison, is_drawn: bool = False) -> list[Part]:
    """Narrate the errors of a model, and where it fails: a profile as a table, unless it is drawn."""
    body, several = found.model.body, len(found.distances)
    regions = [(own.at, describe_region(own)) for own in found.regions]
    texts = [f"{at}: {text}" if at else text for at, text in regions]
    where: list[TextTable | str | tuple[str, ...]] = [tuple(texts)]
    axes = [region.axis for region in found.regions if region.axis != "frequency"]
    profile = next((item for axis in axes for item in found.profiles if item.axis == axis), None)
    if profile is not None and not is_drawn:
        where.append(tabulate_profile(profile))
    if len(found.regions) > 1:
        where.append("Regions of different quantities may show the same moments.")
    if found.regions:
        where.append("Run `diagnose` to find the missing effect.")
    elif not found.is_torque_logged:
        where.append("No torque was logged: the error in the loop counts.")
    elif not found.joint.errors.position_fit < FOLLOWED:  # an arm is not simulated
        where.append("The residual is within the noise: the model explains these recordings.")
    else:
        error = measure(Quantity(found.joint.errors.position_rms, unit=found.model.units().unit("rad")))
        where.append(
            f"The torque residual is within the noise, but free runs err by {error}: an effect acts near reversals or "
            "at rest. Run `diagnose`."
        )
    in_words = [text for text in (describe_loop(found), describe_unstable(found)) if text]
    title = f"Errors of the model with {join_words([term.id for term in found.model.terms])}"
    table = tabulate_recordings(found)
    if not body.can_simulate:
        title = f"Torque errors, {CLEAR}"
        table = tabulate_joints((found.joint.errors,), found.joint.floors, found.model, ("torque error",))
    return [
        Part(title, [table, *in_words, LEGEND]),
        *narrate_disagreements(found.disagreements),
        Part(f"Where, all {several} recordings together" if several > 1 else "Where", where),
    ]


def tabulate_joints(
    columns: Sequence[Errors], floors: Mapping[str, float], model: Model, headers: Sequence[str] = ("before", "after")
) -> TextTable:
    """Tabulate joints: torque errors of models, noise floor, and the residual as a share of the torque."""
    rows = [
        (
            at,
            *(f"{errors.joints[at]:.4g}" for errors in columns),
            f"{floors[at]:.4g}",
            model.units(at).unit(NEWTON_METRE),
            "" if share is None else f"{100 * share:.2g} %",
        )
        for at, share in columns[-1].shares.items()
    ]
    return TextTable(("joint", *headers, "noise floor", "unit", "share of torque"), rows, left=("unit",))


def tabulate_errors(steps: Sequence[Step], units: JointUnits = TURNING) -> TextTable:
    """Tabulate the errors step by step, with a bar that shrinks; ratios are held-out errors over the base's."""
    base = steps[0].errors["holdout"]
    headers, rows = ["model"], [["as it was" if step.added is None else f"+ {step.added}"] for step in steps]
    for kind, unit in base.kinds.items():
        what, (factor, unit) = ERRORS[kind], to_shown_unit(1.0, units.unit(unit))
        headers += [f"{what}, fitted [{unit}]", f"{what}, held out [{unit}]", "ratio"]
        for row, step in zip(rows, steps, strict=True):
            train, holdout = (getattr(step.errors[part], kind) for part in ("train", "holdout"))
            ratio = format_quantity(holdout / max(getattr(base, kind), 1e-300), 3)
            row += [format_quantity(factor * train, 4), format_quantity(factor * holdout, 4), ratio]
    return TextTable([*headers, ""], [[*row, draw_bar(float(row[3]))] for row in rows], left=("",))


def tabulate_parameters(*models: Model, headers: Sequence[str] = ("estimate",)) -> TextTable:
    """Tabulate the parameters of the last model with standard errors, beside those of the models before."""
    named = [{**model.readable, **model.derived} for model in models]
    rows = [
        (shorten_name(name), *(own[name].shown.text if name in own else "" for own in named), last.shown.unit)
        for name, last in named[-1].items()
    ]
    return TextTable(("parameter", *headers, "unit"), rows, left=("unit",))


def describe_fit(steps: Sequence[Step]) -> str:
    """Describe the explained shares of held-out torque and motion of the first and the last model."""
    if steps[0].errors["holdout"].is_in_loop:
        return "in the loop: mean distance between the recorded motion and a simulation from the goal alone"
    first, last = (step.errors["holdout"] for step in (steps[0], steps[-1]))
    course = " -> " if len(steps) > 1 else ""
    torque, position = (
        f"{format_quantity(old, 4, '%')}{course}{format_quantity(new, 4, '%') if course else ''}"
        for old, new in ((first.torque_fit, last.torque_fit), (first.position_fit, last.position_fit))
    )
    return f"fit of held-out data: torque {torque}, position {position}"


def tabulate_candidates(candidates: Sequence[Candidate], most: int | None) -> tuple[TextTable, str]:
    """Tabulate the candidates that matter, and say in words which ones are not shown; empty if none.

    Those that matter are all but the less likely of those left out.
    """
    settled = [c for c in candidates if c.verdict in (Verdict.SELECTED, Verdict.AMBIGUOUS)]
    rest = [c for c in candidates if c not in settled]
    shown, hidden = rest[:most], [] if most is None else rest[most:]
    rows = [
        (c.effect, str(c.verdict).replace("_", " "), f"{c.score:.2f}", describe_reason(c)) for c in (*settled, *shown)
    ]
    blind = [c.effect for c in hidden if c.verdict is Verdict.NOT_EXCITED]
    worse = len(hidden) - len(blind)
    parts = [f"{worse} more that are no better"] if worse else []
    parts += [f"{len(blind)} that could not be judged ({join_words(blind)})"] if blind else []
    return TextTable(("effect", "verdict", "score", "reason"), rows, left=("verdict", "reason")), " and ".join(parts)


def tabulate_detectable(found: Sequence[Detectable]) -> TextTable:
    """Tabulate the smallest detectable sizes of effects."""
    return TextTable(
        ("effect", "detectable"),
        [(one.effect, describe_detectable(one)) for one in found],
        left=("detectable",),
    )


def describe_noise(step: Step, floor: float) -> str:
    """Describe the noise floor of the errors of a step, and its source, in a sentence."""
    kind, unit = next(iter(step.errors["holdout"].kinds.items()))
    noise = measure(Quantity(floor, unit=step.model.units().unit(unit)))
    return f"noise floor, by {FLOOR_SOURCES[kind]}: {noise}"


def tabulate_recordings(found: Comparison) -> TextTable:
    """Tabulate the errors of a model on every recording, and on all together if there are several."""
    distances = [*found.distances, found.joint] if len(found.distances) > 1 else found.distances
    units = found.model.units()
    unit, (factor, angle) = units.unit(NEWTON_METRE), to_shown_unit(1.0, units.unit("rad"))
    free = f"free-running position{'' if found.horizon in (None, HORIZON) else f' over {found.horizon:g} s'} [{angle}]"
    errors = (f"torque [{unit}]", "fit [%]", f"noise floor [{unit}]", free, "fit [%]")
    return TextTable(
        (
            "recording",
            *errors,
            *((f"in the loop, mean [{angle}]", f"RMS [{angle}]") if found.joint.errors.is_in_loop else ()),
        ),
        [
            (
                item.name,
                f"{item.errors.torque_rms:.4g}",
                f"{item.errors.torque_fit:.4g}",
                f"{item.noise_floor:.4g}",
                format_quantity(factor * item.errors.position_rms, 4),
                format_quantity(item.errors.position_fit, 4),
                *(
                    f"{factor * error:.4g}"
                    for error in (item.errors.in_loop, item.errors.in_loop_rms)
                    if np.isfinite(error)
                ),
            )
            for item in distances
        ],
    )


def tabulate_profile(profile: Profile) -> TextTable:
    """Tabulate the mean residual over one quantity, with bars to either side of zero."""
    largest = float(np.abs(profile.mean).max()) or 1.0
    edges, along = to_shown_unit(profile.edges, profile.unit)
    rows = [
        (f"{low:.3g} to {high:.3g}", f"{mean:.3g}", _draw_signed_bar(mean / largest))
        for (low, high), mean in zip(pairwise(edges), profile.mean.tolist(), strict=True)
    ]
    unit = profile.units.unit(NEWTON_METRE)
    return TextTable((f"{SYMBOLS[profile.axis]} [{along}]", f"mean residual [{unit}]", ""), rows, left=("",))


def _draw_signed_bar(share: float, width: int = 12) -> str:
    """Draw the bar from the middle to the left or to the right."""
    left, right = ("", draw_bar(share, width)) if share > 0 else (draw_bar(-share, width), "")
    return f"{left:>{width}}│{right:<{width}}"
