"""Parts (title, tables, sentences and lists) of results, for terminal and notebook."""

from collections.abc import Sequence

from estimators.checks.homogeneity import Disagreement
from estimators.decisions.errors import Errors, Step, get_single
from estimators.diagnosis.links import LinkPayload
from estimators.diagnosis.result import Addition, Candidate, Diagnosis, HorizonRefit
from estimators.results import Comparison
from estimators.signals.residual import SPECTRA
from pendulum_env.formatting import TextTable, format_quantity, join_words, measure
from pendulum_env.physics.estimate import shorten_name
from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.quantity import Quantity
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.units import JointUnits, to_shown_unit
from workbench.narrator import diagnosis as narration
from workbench.narrator.findings import FLOOR_SOURCES, describe, name_treatment
from workbench.narrator.parts import Content, Part
from workbench.narrator.tables import (
    tabulate_candidates,
    tabulate_errors,
    tabulate_joints,
    tabulate_parameters,
    tabulate_profile,
    tabulate_recordings,
)

NEXT = "What to do next"
REMARKS = 2  # largest number of remarks in a summary
RUNNERS_UP = 5  # largest number of rejected candidates in a table
BIASED = "Biased by a missing effect; the size of the bias is unknown."
NAT = "nat: natural logarithm of the likelihood ratio on data that the effect was not fitted to"
SCORE = f"score: probability that the effect is missing; {NAT}"
LEGEND = (
    "noise floor: torque error caused by sensor noise alone; fit: 100 % less the error relative to the deviation of "
    "the measurement from its mean; held out: not fitted"
)
CLEAR = "clear of stick and reversals"
FOLLOWED = 80.0  # smallest fit of free motion of a good model [%]
GATE_HEADERS = ("gate", "value", "limit", "result")


def narrate_summary(diagnosis: Diagnosis, n_remarks: int | None = REMARKS) -> Part:
    """Summarise a diagnosis in lines under its result, with some or all remarks.

    For several joints, only the parameters of added effects are listed.
    """
    estimates = diagnosis.model.readable
    if len(diagnosis.floors) > 1:
        added = [term.id for term in diagnosis.model.terms if term.id in diagnosis.selected]
        estimates = {name: estimate for id in added for name, estimate in diagnosis.model.get_parameters(id).items()}
    step = narration.describe_next_step(diagnosis)
    lines: list[str | TextTable] = [*narration.list_laws(diagnosis), narration.describe_errors(diagnosis)]
    lines += [narration.describe_refit(diagnosis.refit)] if diagnosis.refit is not None else []
    rows = [(shorten_name(name), one.shown.text, one.shown.unit) for name, one in estimates.items()]
    if rows and n_remarks is not None:  # else the parameters at every step follow
        lines.append(TextTable(("parameter", "estimate", "unit"), rows, left=("unit",)))
    first = {region.at: region for region in reversed(diagnosis.unexplained)}  # of each joint
    lines += [
        f"unexplained: {narration.describe_unexplained(diagnosis, region)}"
        for region in reversed(first.values())
        if narration.describe_region(region) != step
    ]
    lines += [f"{describe(other)} It is not fitted: diagnose it on its own." for other in diagnosis.disagreements]
    lines += [f"note: {remark}" for remark in narration.list_remarks(diagnosis)[:n_remarks]]
    return Part(narration.describe_result(diagnosis), [*lines, f"next: {step}"])


def narrate_diagnosis(diagnosis: Diagnosis) -> list[Part]:
    """Make the parts of a diagnosis."""
    units = diagnosis.model.units()
    if not diagnosis.model.mechanism.can_simulate:
        table = tabulate_joints(get_end_errors(diagnosis.steps), diagnosis.floors, diagnosis.model)
        errors = Part(f"{title_errors(diagnosis.steps[0].errors['holdout'])} on held-out data", [table])
    else:
        errors = Part("Errors", narrate_errors(diagnosis))
    parts = [
        errors,
        Part("Parameters", [tabulate_parameters(diagnosis.model), *([BIASED] if diagnosis.unexplained else [])]),
        narrate_candidates(diagnosis.candidates),
    ]
    if diagnosis.refit is not None:
        parts.insert(1, Part(f"Free motion over {diagnosis.refit.seconds:g} s", narrate_refit(diagnosis.refit, units)))
    parts += narrate_detectable(diagnosis)
    if treatments := tuple(narration.describe_treatment(treatment) for treatment in diagnosis.treatments):
        rows = [
            (name_treatment(tried.treatment), *gate.cells)
            for tried in diagnosis.treatments
            for gate in tried.decision.gates
        ]
        table = TextTable(("treatment", *GATE_HEADERS), rows, left=("gate", "result"))
        parts.append(Part("Treatments of the recordings that were tried", [treatments, table], brief=False))
    return [*parts, *narrate_unexplained(diagnosis)]


def narrate_detectable(diagnosis: Diagnosis) -> list[Part]:
    """Make the part with the detectable sizes of effects; empty if unknown."""
    sizes = [(detectable.effect, narration.describe_detectable(detectable)) for detectable in diagnosis.detectable]
    table = TextTable(("effect", "detectable"), sizes, left=("detectable",))
    return [Part("Smallest effects that would have shown", [table], brief=False)] if sizes else []


def narrate_unexplained(diagnosis: Diagnosis) -> list[Part]:
    """Make the part on the unexplained residual; empty without one."""
    texts = tuple(narration.describe_unexplained(diagnosis, region) for region in diagnosis.unexplained)
    return [Part("Left unexplained", [texts])] if texts else []


def narrate_next_step(diagnosis: Diagnosis) -> list[Part]:
    """Make the part with the next step and all remarks; without a search, with the advice."""
    if diagnosis.candidates:
        step, remarks = narration.describe_next_step(diagnosis), narration.list_remarks(diagnosis)
        texts = tuple(remarks) if remarks and step == narration.NO_EXPERIMENT else (step, *remarks)
    else:
        texts = tuple(narration.list_advice(diagnosis))
    return [Part(NEXT, [texts])] if texts else []


def narrate_errors(diagnosis: Diagnosis) -> Content:
    """Return table, fit and noise floor of the errors of a pendulum or servo after every step."""
    noise = describe_noise(diagnosis.steps[0], get_single(diagnosis.floors))
    return [tabulate_errors(diagnosis.steps, diagnosis.model.units()), describe_fit(diagnosis.steps), noise, LEGEND]


def narrate_refit(refit: HorizonRefit, units: JointUnits) -> Content:
    """Return table and text on the errors before and after a refit to free motion."""
    factor, angle = to_shown_unit(1.0, units.unit("rad"))
    errors = f"torque [{units.unit(NEWTON_METRE)}]", f"position [{angle}]"
    headers = ("model", *(f"{what}, {part}" for part in ("fitted", "held out") for what in errors))
    steps = {"before the refit": refit.before} | ({"after it": refit.after} if refit.after is not None else {})
    rows = []
    for name, step in steps.items():
        sizes = [size for error in step.errors.values() for size in (error.torque_rms, factor * error.position_rms)]
        rows.append((name, *(format_quantity(size, 4) for size in sizes)))
    return [TextTable(headers, rows), narration.describe_refit(refit)]


def title_errors(errors: Errors) -> str:
    """Return the title of a table of the errors of joints."""
    return "Errors of the motion in the loop" if errors.is_of_motion else f"Torque errors, {CLEAR},"


def get_end_errors(steps: Sequence[Step], part: str = "holdout") -> tuple[Errors, Errors]:
    """Return the errors of the first and the last model in a part of the data."""
    return steps[0].errors[part], steps[-1].errors[part]


def narrate_candidates(candidates: Sequence[Candidate]) -> Part:
    """Make the part with the ranking, the meaning of the score, and the gates of the candidates."""
    ranking, remark = tabulate_candidates(candidates, RUNNERS_UP)
    effects = {row[0] for row in ranking.rows}
    gates = [(c.effect, *gate.cells) for c in candidates if c.effect in effects for gate in c.decision.gates]
    table = TextTable(("effect", *GATE_HEADERS), gates, left=("gate", "result"))
    more_text = [f"and {remark}: --json and --report list all"] if remark else []
    return Part("Candidates", [ranking, *more_text, SCORE, *([table] if gates else [])], brief=False)


def narrate_disagreements(disagreements: Sequence[Disagreement]) -> list[Part]:
    """Make the part on recordings of a different plant; empty without any."""
    texts = tuple(map(describe, disagreements))
    return [Part("Recordings that disagree", [texts])] if texts else []


def narrate_findings(comparison: Comparison) -> list[Part]:
    """Make the part on other findings of a comparison; empty without any."""
    texts = tuple(describe(finding) for finding in comparison.findings if finding not in comparison.disagreements)
    return [Part("Findings", [texts])] if texts else []


def narrate_addition(addition: Addition) -> list[Part]:
    """Make the parts of an addition: errors before and after, conclusion, and parameters."""
    sentences = [narration.describe_addition(addition)]
    if addition.objection is None and (table := narration.describe_table(addition.after)) is not None:
        sentences.append(table)
    if addition.is_misfit:
        sentences.append(
            f"The residual is {addition.noise_ratio:.1f} times the noise floor: another effect is missing. "
            "Run `diagnose`."
        )
    sentences += [f"warning: {describe(finding)}" for finding in addition.findings]
    title, steps = "the model refitted without and with the effect", (addition.before, addition.after)
    parameters = Part("Parameters", [tabulate_parameters(addition.model)])
    if addition.model.mechanism.can_simulate:
        return [Part(f"Errors, {title}", [tabulate_errors(steps, addition.model.units()), *sentences]), parameters]
    name = title_errors(addition.after.errors["holdout"])
    fitted, held_out = (
        tabulate_joints(get_end_errors(steps, part), addition.floors, addition.model) for part in ("train", "holdout")
    )
    return [
        Part(f"{name} on fitted data, {title}", [fitted]),
        Part(f"{name} on held-out data, {title}", [held_out, *sentences]),
        parameters,
    ]


def narrate_comparison(comparison: Comparison, is_drawn: bool = False) -> list[Part]:
    """Make the parts of a comparison: errors and regions, with a profile as a table unless `is_drawn`."""
    body, is_arm = comparison.model.mechanism, len(comparison.recording_errors)
    regions = [(region.at, narration.describe_region(region)) for region in comparison.regions]
    texts = [f"{at}: {text}" if at else text for at, text in regions]
    content: list[TextTable | str | tuple[str, ...]] = [tuple(texts)]
    axes = [region.axis for region in comparison.regions if region.axis not in SPECTRA]
    profile = next((item for axis in axes for item in comparison.profiles if item.axis == axis), None)
    if profile is not None and not is_drawn:
        content.append(tabulate_profile(profile))
    if len(comparison.regions) > 1:
        content.append("Regions of different quantities may show the same moments.")
    if comparison.regions:
        content.append("Run `diagnose` to find the missing effect.")
    elif (comparison.joint.errors.joints and comparison.joint.errors.is_of_motion) or not comparison.is_torque_logged:
        content.append("No torque was logged: the error in the loop counts.")
    elif not comparison.joint.errors.position_fit < FOLLOWED:  # NaN for an arm
        content.append("The residual is within the noise: the model explains these recordings.")
    else:
        error = measure(Quantity(comparison.joint.errors.position_rms, unit=comparison.model.units().unit("rad")))
        content.append(
            f"The torque residual is within the noise, but free runs err by {error}: an effect acts near reversals or "
            "at rest. Run `diagnose`."
        )
    in_words = [text for text in (narration.describe_loop(comparison), narration.describe_unstable(comparison)) if text]
    title = f"Errors of the model with {join_words([term.id for term in comparison.model.terms])}"
    table = tabulate_recordings(comparison)
    if not body.can_simulate:
        title, every = title_errors(comparison.joint.errors).rstrip(","), comparison.joint
        table = tabulate_joints((every.errors,), every.floors, comparison.model, ("error",))
    return [
        Part(title, [table, *in_words, LEGEND]),
        *narrate_disagreements(comparison.disagreements),
        *narrate_findings(comparison),
        Part(f"Where, all {is_arm} recordings together" if is_arm > 1 else "Where", content),
    ]


def describe_fit(steps: Sequence[Step]) -> str:
    """State the fit [%] of held-out torque and motion of the first and the last model."""
    if steps[0].errors["holdout"].is_of_motion:
        return "in the loop: mean distance between the recorded motion and a simulation from the goal alone"
    first, last = (step.errors["holdout"] for step in (steps[0], steps[-1]))
    course = " -> " if len(steps) > 1 else ""
    torque, position = (
        f"{format_quantity(before, 4, '%')}{course}{format_quantity(after, 4, '%') if course else ''}"
        for before, after in ((first.torque_fit, last.torque_fit), (first.position_fit, last.position_fit))
    )
    return f"fit of held-out data: torque {torque}, position {position}"


def describe_noise(step: Step, floor: float) -> str:
    """State the noise floor of a step's errors and its source."""
    kind, unit = next(iter(step.errors["holdout"].kinds.items()))
    noise = measure(Quantity(floor, unit=step.model.units().unit(unit)))
    return f"noise floor, by {FLOOR_SOURCES[kind]}: {noise}"


def narrate_payload(payload: LinkPayload, body: Mechanism) -> list[Part]:
    """Make the parts on the payload of an arm: estimates, and joint errors without and with it."""
    rows = [(name, estimate.text, estimate.unit) for name, estimate in payload.estimates.items()]
    rows += [(f"centre {axis}", one.text, one.unit) for axis, one in payload.center.items()]
    content: list[TextTable | str] = [TextTable(("parameter", "estimate", "unit"), rows, left=("unit",))]
    if payload.hidden:
        content.append(f"{join_words(payload.hidden)}: no motion of the joints shows them")
    if payload.exists is False:
        content.append(
            "No body has the moments of the best fit, and those of the nearest body are shown. Something else changed "
            "as well, or the motion determines too little."
        )
    sizes, units = payload.torque_rms.items(), {at: body.units(at).unit(NEWTON_METRE) for at in payload.torque_rms}
    errors = [(at, f"{before:.4g}", f"{after:.4g}", units[at]) for at, (before, after) in sizes]
    explained = TextTable(("joint", "without payload", "with it", "unit"), errors, left=("unit",))
    return [
        Part(f"Payload at the link behind {payload.joint}, in that joint's frame", content),
        Part("Torque errors, friction refitted", [explained]),
    ]
