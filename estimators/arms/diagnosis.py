"""Which effect is missing at which joint of an arm: the pendulum's search, on the rows of all joints."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.arms.identification import ArmStep
from estimators.arms.untold import untold
from estimators.checks.residual import Region, stand_out
from estimators.diagnosis.judge import judge
from estimators.diagnosis.result import KEPT, SETTLED, UNNAMED, Candidate
from estimators.diagnosis.setting import HELD_OUT
from estimators.progress import Progress, no_progress
from estimators.regression.equations import IdentificationError
from estimators.selection.data import PreparedData
from estimators.selection.left import Terms
from estimators.selection.models import Models
from estimators.selection.moves import explaining
from estimators.selection.search import select
from estimators.weak_form.dataset import HALF_WIDTHS, NEGLIGIBLE
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.windows import in_a_row
from pendulum_env._typing import JSON
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Coupling, Links, at_joints, friction, joint_effects, kind_at
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Estimate, Model, Term
from pendulum_env.physics.table import TABLES
from pendulum_env.words import listing

SCHEMA = "pendulum-ident/arm-diagnosis@2"
HEAVIER = 1.2  # times, by which a joint feels heavier in slow motion without its friction being the reason


@dataclass(frozen=True, eq=False)
class ArmDiagnosis:
    """What an arm's model lacks.

    Attributes:
        before, after: the model without the effects that were found and with them, and their held-out torque errors.
        selected: them, `stribeck@elbow`.
        candidates: every effect at every joint, what was selected first.
        ambiguous: groups of effects that these data cannot tell apart, a selected one first.
        unexplained: torque that is left of joints and is no noise [N m]: what neighbouring windows share, or all.
        regions: where it stands out most, of these joints where it does.
        tables: functions that no effect is and that would explain most of it, `torque_by_angle@elbow`.
        heavier: joints that feel heavier in slow motion than in all, and how many times.
    """

    before: ArmStep
    after: ArmStep
    selected: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    ambiguous: tuple[tuple[str, ...], ...]
    unexplained: Mapping[str, float]
    regions: Mapping[str, Region] = field(default_factory=dict)
    tables: tuple[str, ...] = ()
    heavier: Mapping[str, float] = field(default_factory=dict)

    @property
    def model(self) -> ArmModel:
        """The model with the effects."""
        return self.after.model

    @property
    def steps(self) -> tuple[ArmStep, ...]:
        """The base model and, where effects were found, the one with them."""
        return (self.before, self.after) if self.selected else (self.before,)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What else is seen of what is left, in sentences."""
        slow = 0.5 / HALF_WIDTHS[-1]
        return tuple(
            f"{joint} feels {times:.2g} times as heavy below {slow:.2g} Hz as in all of its motion, as behind an "
            "elastic transmission, on a base that gives, or where the encoder adds more than white noise: trust slow "
            "motion"
            for joint, times in self.heavier.items()
        )

    @property
    def headline(self) -> str:
        """What is missing, in a line."""
        where = listing(list(self.unexplained))
        if self.selected:
            more = f", and more at {where} that no known effect explains" if where else ""
            return f"Missing: {listing(self.selected)}{more}"
        if self.unexplained:
            return f"Something is missing at {where}, and no known effect explains it"
        return "No effect of the library is missing at any joint"

    @property
    def next_step(self) -> str:
        """What would settle what is open, or that nothing would."""
        if self.ambiguous:
            group = self.ambiguous[0]
            reveal = kind_at(group[-1], self.model.body).reveal
            return f"{listing(group)} look the same in these data; to tell them apart: {reveal}"
        if self.tables:
            first, *others = self.tables
            return KEPT.format(table=first) + (f" (so would {listing(others)})" if others else "")
        return UNNAMED if self.unexplained else SETTLED

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Parameters of the effects that were found, by name."""
        return {name: own for id in self.selected for name, own in self.model.of(id).items()}

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "schema": SCHEMA,
            "selected": list(self.selected),
            "ambiguous": [list(group) for group in self.ambiguous],
            "candidates": [candidate.json() for candidate in self.candidates],
            "errors": {
                name: [error.json() for error in step.errors["holdout"]]
                for name, step in (("before", self.before), ("after", self.after))
            },
            "unexplained": dict(self.unexplained),
            "regions": {joint: region.json() for joint, region in self.regions.items()},
            "tables": list(self.tables),
            "heavier": dict(self.heavier),
            "model": self.model.json(),
        }


def where_it_stands_out(models: Models, terms: Terms, joints: Sequence[str]) -> dict[str, Region]:
    """Where what terms leave stands out most of the noise, of the joints where it does."""
    assert isinstance(models.train, PreparedData)
    data, residual = models.train.data, models.regression.residual(terms)
    found = {
        at: stand_out(data.part(at).samples, residual[data.where(at)], models.left.noise_of(models.train, at), most=1)
        for at in joints
    }
    return {at: regions[0] for at, regions in found.items() if regions}


def parted(
    recordings: ArmRecording | Sequence[ArmRecording], holdout: ArmRecording | Sequence[ArmRecording] = ()
) -> tuple[list[ArmRecording], list[ArmRecording]]:
    """What is fitted and what is held out: the last 30 % of each recording, where no others are."""
    recordings, holdout = (
        [those] if isinstance(those, ArmRecording) else list(those) for those in (recordings, holdout)
    )
    if holdout:
        return recordings, list(holdout)
    pairs = [recording.split(1 - HELD_OUT) for recording in recordings]
    return [first for first, _ in pairs], [last for _, last in pairs]


def gather_arm(
    recordings: Sequence[ArmRecording], terms: Sequence[type[Term] | Term], shortest: float = 0.0
) -> PreparedData:
    """Prepared data of an arm's recordings, with the columns of terms that joints share; no simulation follows them.

    Args:
        recordings: of the arm.
        terms: that may be fitted to it, the links first.
        shortest: half a window at least [s].

    Raises:
        IdentificationError: if a joint hardly moves clear of stick.
    """
    links = terms[0]
    assert isinstance(links, Links)
    kinds = dict.fromkeys(term if isinstance(term, type) else type(term) for term in terms)
    shared = [kind for kind in kinds if issubclass(kind, Coupling)]
    return PreparedData(prepare_arm(recordings, links, shared, shortest), ())


def models_of_arm(
    train: Sequence[ArmRecording],
    held: Sequence[ArmRecording],
    base: tuple[Term, ...],
    library: Mapping[str, type[Term]],
    progress: Progress,
    tables: Sequence[type[Term]] = (),
) -> Models:
    """What recordings of an arm say of models; the first term of the base model is the links.

    Raises:
        IdentificationError: if a joint hardly moves clear of stick.
    """
    kinds: tuple[type[Term] | Term, ...] = (*base, *library.values())
    fitted, checked = gather_arm(train, kinds), gather_arm(held, kinds)
    return Models(fitted, checked, progress, library, base=base, tables=tables)


def heavier_when_slow(models: Models, train: Sequence[ArmRecording], joints: Collection[str]) -> dict[str, float]:
    """Of some joints those that feel surely heavier in the longest windows, and how many times."""
    try:
        slow = gather_arm(train, models.base, HALF_WIDTHS[-1]).inertias(models.base)
    except IdentificationError:  # they are too few
        return {}
    times = {at: slow[at] / max(models.left.inertia[at], 1e-300) for at in joints}
    return {at: ratio for at, ratio in times.items() if ratio > HEAVIER}


def of_arm(model: Model) -> ArmModel:
    """A model of links and of terms at joints as that of an arm."""
    return ArmModel(model.terms, model.estimates, correlation=model.correlation)


def diagnose_arm(
    recordings: ArmRecording | Sequence[ArmRecording],
    body: Body,
    holdout: ArmRecording | Sequence[ArmRecording] = (),
    progress: Progress = no_progress,
    *,
    terms: Sequence[Term] | None = None,
    library: Mapping[str, type[Term]] | None = None,
) -> ArmDiagnosis:
    """Find the effects at joints that a model of an arm lacks.

    Args:
        recordings: to fit.
        body: its links.
        holdout: to predict; without any, the last 30 % of each recording.
        progress: told what is being done.
        terms: of the model at joints, beside the links; viscous and Coulomb friction at each by default.
        library: effects that may be named, by id; at the joint where it is placed or at all;
            by default all that can sit at a joint.

    Raises:
        IdentificationError: if a joint hardly moves.
    """
    train, held = parted(recordings, holdout)
    base = (Links(body), *(friction(body) if terms is None else terms))
    placed = at_joints((joint_effects() if library is None else library).values(), body)
    placed = [kind for kind in placed if kind.id not in {term.id for term in base}]
    tables = at_joints(TABLES.values(), body)
    models = models_of_arm(train, held, base, {kind.id: kind for kind in placed}, progress, tables)
    found = select(models)
    candidates, groups = judge(found, found.terms)
    left, _ = models.left.structures(found.terms)
    assert isinstance(models.train, PreparedData)
    data = models.train.data
    negligible = {at: max(NEGLIGIBLE * float(np.std(data.part(at).torque())), data.least()) for at in data.joints}
    unexplained = {
        joint: own.shared if own.sure > models.criterion.sure else own.all
        for joint, own in left.items()
        if not models.criterion.is_noise(own, max(models.left.noise_of(models.train, joint), negligible[joint]))
    }
    last = found.steps[-1].model
    lacking, model = of_arm(found.steps[0].model), of_arm(last.biased() if unexplained else last)
    seen = (in_a_row([w.samples for w in data.part(at).windows]) for at in data.joints)
    parts = ((x.position, x.velocity, x.torque) for x in seen)
    model = model.withholding(untold(model, *map(np.column_stack, zip(*parts, strict=True))))
    return ArmDiagnosis(
        before=ArmStep.of(None, lacking, holdout=held),
        after=ArmStep.of(None, model, holdout=held),
        selected=tuple(term.id for term in found.terms[len(base) :]),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=unexplained,
        heavier=heavier_when_slow(models, train, unexplained) if unexplained else {},
        regions=where_it_stands_out(models, found.terms, list(unexplained)),
        tables=tuple(
            filter(
                None,
                (explaining(models, found.terms, [table for table in tables if table.at == at]) for at in unexplained),
            )
        ),
    )
