"""Decide undeclared conventions of a servo's log: how its controller acts, and how goals change between rows.

Fits of the base model decide, in three steps:

| conventions | fits, the preferred ones first |
|---|---|
| `windup`, `integral`, `derivative` | each combination, with both courses of the goals: a wrong course hides them |
| `goal` | of these, those under the decided controller, then the same with a dead time or a lag |
| `reads` | the exact position, then counts of the encoder; errors are compared in counts |

The first fit is taken that is tied with the likeliest one, see `choose_fit`. On average, a held goal is late by half a
sample. A dead time and a lag imitate this delay; feedback turns it into viscous friction. A diagnosis decides the
course of the goals again with the effects that it finds, see `reread_goals`.

All commands for servos with a drive use these recordings, and so the same torque and motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from estimators.data.preparation import Prepared, Recordings
from estimators.data.treatment import DataChange
from estimators.decisions.criterion import Criterion
from estimators.findings import Finding, Quantity
from estimators.weak_form.rows import Terms
from estimators.weak_form.windows import Part
from pendulum_env.physics import BASE, Term, effects, list_ids
from pendulum_env.physics.terms import is_pure_delay
from pendulum_env.recording import Recording
from robots.servos.drive import CONTROLLER, list_open_conventions
from robots.servos.in_loop.convention_fits import Settings, choose_fit, complete_drives, fit_conventions, group_by_loop
from robots.servos.in_loop.counts import find_encoder_step
from robots.servos.in_loop.servos import are_driven, choose_parts, make_base
from robots.servos.torque import depends_on_past, list_drives


@dataclass(frozen=True)
class ControllerConvention(Finding):
    """Convention by which a controller is simulated.

    Attributes:
        settings: settings of its drive: how it acts, or the position that it `reads`.
        gain: gain over the likeliest other convention [nat].
        recordings: names of the recordings of these drives.
    """

    settings: Mapping[str, str]
    gain: Quantity
    recordings: tuple[str, ...] = ()

    @property
    def is_of_position(self) -> bool:
        """Return whether the convention is the position that the controller reads."""
        return "reads" in self.settings


@dataclass(frozen=True)
class UnseenCounts(Finding):
    """Counts of an encoder that a drive declares, and the log does not show."""

    recordings: tuple[str, ...] = ()


@dataclass(frozen=True)
class GoalConvention(DataChange, Finding):
    """Course of the goals between rows of a log.

    Attributes:
        is_held: whether goals are held from row to row; else they run on between rows.
        gain: gain over the other course [nat]; None if the selected effects decided.
        lateness: size of an effect that the other course needs, by its id; empty without one.
        recordings: names of the recordings.
    """

    is_held: bool
    gain: Quantity | None = None
    lateness: Mapping[str, Quantity] = field(default_factory=dict)
    recordings: tuple[str, ...] = ()

    @property
    def n_assumptions(self) -> int:
        """Return 1 for goals that run on, since held goals are the default."""
        return int(not self.is_held)

    @property
    def has_new_inputs(self) -> bool:
        """Return True: simulations have other goals."""
        return True

    @property
    def topic(self) -> str | None:
        """Return the topic of all decisions on goals."""
        return self.family


Decision = ControllerConvention | GoalConvention | UnseenCounts
Decided = tuple[Settings, list[Decision]]


def decide_conventions(
    recordings: Sequence[Recording],
    holdout: Sequence[Recording] = (),
    base: Sequence[Term] = BASE,
    criterion: Criterion = Criterion(),
) -> Prepared:
    """Decide the undeclared conventions of all drives by fits of the base model to the fitted recordings.

    Recordings without a drive stay as they are. The kinds of drives, by controlled quantity and shaft of the encoder,
    are decided separately. A convention that one drive declares, or that is decided, holds for all drives of its kind.
    A kind without fitted recordings is decided by its held-out ones.

    Raises:
        IdentificationError: if the recordings have too little motion.
        RecordingError: if the drives of one kind cannot be simulated together.
    """
    every, count = [*recordings, *holdout], len(recordings)
    findings: list[Finding] = []
    for numbers in group_by_loop(every):
        deciding = [k for k in numbers if k < count] or numbers
        if not are_driven([every[k] for k in deciding]):
            continue
        group, own_findings = _decide_together([every[k] for k in numbers], len(deciding), base, criterion)
        for k, recording in zip(numbers, group, strict=True):
            every[k] = recording
        names = () if deciding == list(range(count)) else tuple(every[k].name for k in deciding)
        findings += [replace(finding, recordings=names) for finding in own_findings]
    return Prepared(tuple(every[:count]), tuple(every[count:]), tuple(findings))


def decide_open_torque(
    recordings: Recordings, holdout: Recordings, base: Sequence[Term], criterion: Criterion
) -> Prepared:
    """Decide conventions if the torque of a recording is that requested by its drive, and depends on them."""
    drives = list_drives(r for r in (*recordings, *holdout) if not r.has_logged_torque)
    if any(depends_on_past(drive) or "derivative" in drive.open_conventions for drive in drives):
        return decide_conventions(recordings, holdout, base, criterion)
    return Prepared(recordings, holdout)


def list_decisions(findings: Sequence[Finding]) -> list[Finding]:
    """List the last decisions among findings: laws of controllers, the position that they read, and course of goals."""
    laws = [item for item in findings if isinstance(item, ControllerConvention | UnseenCounts)]
    positions = [law for law in laws if isinstance(law, ControllerConvention) and law.is_of_position]
    goals = [item for item in findings if isinstance(item, GoalConvention)]
    return [*(law for law in laws if law not in positions), *positions[-1:], *goals[-1:]]


def _decide_together(
    recordings: Sequence[Recording], count: int, base: Sequence[Term], criterion: Criterion
) -> tuple[Recordings, list[Decision]]:
    """Decide the conventions of drives of one kind by their first `count` recordings; return findings as well."""
    base, part = make_base(recordings[:count], base), choose_parts(recordings[count:])[0]
    result = complete_drives(recordings, {})
    findings: list[Decision] = []
    for settle in (_decide_controller, _decide_counts):
        settings, own_findings = settle(result[:count], base, part, criterion)
        result, findings = complete_drives(result, settings), findings + own_findings
    return result, findings


def _decide_controller(recordings: Recordings, base: Terms, part: Part, criterion: Criterion) -> Decided:
    """Decide how the controllers act, and whether goals are held from row to row or run on between rows.

    Findings have the gain over the likeliest fit under other settings [nat]. That on the goals has the effects of this
    fit with their sizes [s].
    """
    drives = list_drives(recordings)
    controllers, goals = list_open_conventions(drives, CONTROLLER), list_open_conventions(drives, ("goal",))
    if len(controllers) == len(goals) == 1:
        return {}, []
    choices = [controller | goal for controller in controllers for goal in goals]
    fits = fit_conventions(recordings, choices, base, part, criterion)
    settings: Settings = {}
    findings: list[Decision] = []
    if len(controllers) > 1:
        ranked = sorted(fits, key=lambda fit: (controllers.index(fit.select(CONTROLLER)), -fit.likelihood))
        choice = choose_fit(ranked, CONTROLLER, criterion.p_value, criterion)
        settings = choice.fit.select(CONTROLLER)
        findings = [ControllerConvention(settings, choice.gain)]
        fits = [fit for fit in fits if fit.select(CONTROLLER) == settings]
    if len(goals) > 1:
        late = [kind() for id, kind in effects().items() if is_pure_delay(kind) and id not in list_ids(base)]
        fits += [fit.with_effect(effect) for fit in fits for effect in late]
        by_size = sorted(fits, key=lambda fit: (len(fit.terms), -fit.likelihood))
        choice = choose_fit(by_size, ("goal",), criterion.p_value, criterion)
        added = choice.alternative.terms[len(base) :]
        lateness = {term.id: Quantity(float(term.lead + term.delay), unit="s") for term in added}
        settings = choice.fit.settings
        findings.append(GoalConvention(settings["goal"] == "held", choice.gain, lateness))
    return settings, findings


def _decide_counts(recordings: Recordings, base: Terms, part: Part, criterion: Criterion) -> Decided:
    """Decide whether position controllers read counts of the encoder, if the log shows them.

    Declared counts are a finding if the log shows no step of the encoder: then exact positions are simulated.
    """
    drives = list_drives(recordings)
    choices, readings = list_open_conventions(drives, ("reads",)), {drive.reads for drive in drives}
    if find_encoder_step(recordings) is None:
        return {}, [UnseenCounts()] if "counts" in readings else []
    if len(choices) == 1:
        return {}, []
    fits = fit_conventions(recordings, choices, base, part, criterion, has_counts=True)
    choice = choose_fit(fits, ("reads",), criterion.loop.counts_p_value, criterion)
    return choice.fit.settings, [ControllerConvention(choice.fit.settings, choice.gain)]
