"""Results of a diagnosis, with the probability of each effect, and of an addition, with errors before and after it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property

from estimators.checks.alignment import Alignment
from estimators.checks.homogeneity import Disagreement
from estimators.data.fit_data import FitData
from estimators.data.treatment import Treatment
from estimators.decisions.criterion import Criterion
from estimators.decisions.decision import NOTHING_TESTED, Decision
from estimators.decisions.errors import Step, Terms, encode_estimates
from estimators.decisions.gate import FailedGates, explain_rejection
from estimators.decisions.score import Gain
from estimators.diagnosis.suggestion import Suggestion
from estimators.findings import Finding, Verdict
from estimators.prediction import Prediction, predict_recordings
from estimators.results import make_floors_json, make_model_json, make_result_json
from estimators.selection.evidence import Evidence
from estimators.signals.residual import Region
from pendulum_env._typing import JSON
from pendulum_env.lookup import find
from pendulum_env.notebook import Summarised
from pendulum_env.physics import Model
from pendulum_env.recording.channel import TorqueConstant

SCHEMA = "pendulum-ident/diagnosis@3"
ADDITION_SCHEMA = "pendulum-ident/addition@3"


@dataclass(frozen=True)
class Candidate:
    """Verdict on one effect of the library, with its scores.

    Attributes:
        effect: id of the effect.
        score: probability of the effect among its alternatives, from 0 to 1.
        verdict: decision on the effect.
        error_ratio: held-out torque error with the effect over the error without.
        reason: finding that explains the verdict.
        gain: gain of the effect, added to the other effects of the final model; None if unknown.
        variants: number of compared variants, see `Evidence.count_compared_variants`.
        decision: tests of the effect, in order; a rejected effect failed the last.
        terms: terms of the evaluated model; empty if the effect was not tried.
    """

    effect: str
    score: float
    verdict: Verdict
    error_ratio: float
    reason: Finding
    gain: Gain | None = None
    variants: int = 1
    decision: Decision = NOTHING_TESTED
    terms: Terms = field(default=(), compare=False, repr=False)

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "effect": self.effect,
            "score": self.score,
            "verdict": str(self.verdict),
            "error_ratio": self.error_ratio,
            "reason": self.reason.json(),
            "gain": self.gain.json() | {"variants": self.variants} if self.gain is not None else None,
            "gates": [gate.json() for gate in self.decision.gates],
        }


@dataclass(frozen=True)
class Detectable:
    """Absent effect that the data would have shown; without `above` and `between`, the data do not excite it.

    Attributes:
        effect: id of the effect.
        above: smallest detectable size, in `unit`; None with `between`, or if no possible size is detectable.
        unit: of `above` or `between`.
        between: angles between which the effect would have been detected; None for other effects than a stop.
    """

    effect: str
    above: float | None = None
    unit: str = "rad"
    between: tuple[float, float] | None = None

    @property
    def is_excited(self) -> bool:
        """Return whether the data would have shown some possible size of the effect."""
        return self.above is not None or self.between is not None

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return asdict(self) | {"between": None if self.between is None else list(self.between)}


@dataclass(frozen=True)
class TriedTreatment:
    """A treatment of the recordings under which effects were searched for.

    Attributes:
        treatment: finding that names the treatment.
        decision: tests of the treatment.
        assumptions: number of assumptions with the treatment, see `count_assumptions`.
        before: number without the treatment.
    """

    treatment: Finding
    decision: Decision
    assumptions: int
    before: int

    @property
    def action(self) -> str:
        """Return the action of the treatment; empty for a finding of another family."""
        return self.treatment.action if isinstance(self.treatment, Treatment) else ""

    @property
    def is_kept(self) -> bool:
        """Return whether the treatment was kept."""
        return self.decision.passed

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        assumptions = {"with": self.assumptions, "without": self.before}
        return self.treatment.json() | {
            "assumptions": assumptions,
            "kept": self.is_kept,
            "gates": [gate.json() for gate in self.decision.gates],
        }


@dataclass(frozen=True)
class HorizonRefit:
    """Refit of the final model to free-running motion over a horizon, each segment from its measured state.

    Attributes:
        seconds: horizon [s].
        before: model of the search, with errors of free runs over the horizon.
        after: refitted model, with the same errors; None if the motion errs by no more than noise.
        decision: tests of the refitted model.
        is_interrupted: whether the refit was interrupted, at the parameters reached so far.
    """

    seconds: float
    before: Step
    after: Step | None = None
    decision: Decision = NOTHING_TESTED
    is_interrupted: bool = False

    @property
    def is_kept(self) -> bool:
        """Return whether the refitted model is the final one."""
        return self.after is not None and self.decision.passed

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "seconds": self.seconds,
            "before": self.before.json(),
            "after": None if self.after is None else self.after.json(),
            "kept": self.is_kept,
            "gates": [gate.json() for gate in self.decision.gates],
            "interrupted": self.is_interrupted,
        }


@dataclass(frozen=True, repr=False)
class Diagnosis(Summarised):
    """Result of a diagnosis; `diagnosis["stribeck"]` is the verdict on an effect.

    Attributes:
        steps: the base model, then one entry for each added effect.
        candidates: verdict on each effect of the library, selected effects first.
        ambiguous: groups of ids of effects that the data cannot distinguish, the selected one first.
        unexplained: regions of the residual of the final model; empty if it is noise. Links have one region for each
            joint with a residual.
        floors: noise floor of the held-out torque at each joint [N m]; in the loop the mean position error by the
            encoder [rad].
        findings: on data and model, in the order of `CHECKS`, then on the next experiment.
        suggestion: experiment that decides most open questions; None without one.
        no_experiment: reason why no experiment decides a question or explains a residual; None without a reason.
        tables: ids of tables that explain the residual: one, or one per joint.
        alignments: time between torque and motion of each recording, fitted ones first, by which late or filtered
            torque was corrected.
        detectable: absent effects that the data would have shown; none if a residual is unexplained.
        torque_constant: constant by which a current was converted; None if torque was logged, or it is unknown.
        data: data of the diagnosis, without excluded recordings; None if it was read from a file.
        joint_residuals: residual of joints with links that is not noise [N m], see `find_joint_residuals`.
        treatments: tried treatments of the recordings, in order; those of the preparation are in `data`.
        refit: refit to free-running motion over a horizon; None without a horizon.
        evidence: fits and scores of the search; `evidence.fits.fit_model(candidate.terms)` is a candidate. Not pickled.
    """

    steps: tuple[Step, ...]
    candidates: tuple[Candidate, ...]
    ambiguous: tuple[tuple[str, ...], ...]
    unexplained: tuple[Region, ...]
    floors: Mapping[str, float]
    findings: tuple[Finding, ...]
    suggestion: Suggestion | None = None
    no_experiment: Finding | None = None
    tables: tuple[str, ...] = ()
    alignments: tuple[Alignment, ...] = ()
    detectable: tuple[Detectable, ...] = ()
    torque_constant: TorqueConstant | None = None
    data: FitData | None = field(default=None, compare=False, repr=False)
    joint_residuals: Mapping[str, float] = field(default_factory=dict)
    evidence: Evidence | None = field(default=None, compare=False, repr=False)
    treatments: tuple[TriedTreatment, ...] = ()
    refit: HorizonRefit | None = None

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "evidence"}

    def __getitem__(self, effect: str) -> Candidate:
        return find("effect", effect, {candidate.effect: candidate for candidate in self.candidates})

    @property
    def model(self) -> Model:
        """Final model."""
        return self.steps[-1].model

    @cached_property
    def recordings(self) -> tuple[Prediction, ...]:
        """Prediction of each recording by the final model, fitted ones first; without excluded recordings."""
        return predict_recordings(self.model, self.data)

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Recordings that disagree with the others; fitted ones were excluded."""
        return tuple(finding for finding in self.findings if isinstance(finding, Disagreement))

    @property
    def selected(self) -> tuple[str, ...]:
        """Ids of the selected effects, in the order of their addition."""
        return tuple(step.added for step in self.steps if step.added is not None)

    def list_unconfirmed(self, effects: Sequence[str]) -> list[str]:
        """List effects and tables in a model that the search did not select; empty without a search."""
        confirmed = {*self.tables, *(one.effect for one in self.candidates if one.verdict.is_accepted)}
        return [effect for effect in effects if self.candidates and effect not in confirmed]

    @property
    def effects(self) -> tuple[tuple[str, ...], ...]:
        """Return ids per selected effect: its id, then the ids of effects that the data cannot distinguish from it."""
        rivals = {group[0]: group for group in self.ambiguous}
        return tuple(rivals.get(id, (id,)) for id in self.selected)

    def json(self) -> JSON:
        """Return the diagnosis as a dictionary for JSON.

        `regions` lists the unexplained regions, `unexplained` sums them up. The joint of a pendulum is "". `criterion`
        is null without data.
        """
        base, known = self.steps[0].model, self.data
        criterion = None if known is None else {"significance": known.criterion.p_value, "block": known.criterion.block}
        return make_result_json(self.model, self.torque_constant, self.unexplained) | {
            "schema": SCHEMA,
            "criterion": criterion,
            "base": {
                "terms": [term.id for term in base.terms],
                "theta": encode_estimates(base),
            },
            "selected": list(self.selected),
            "steps": [step.json() for step in self.steps],
            "candidates": [candidate.json() for candidate in self.candidates],
            "ambiguous": [list(group) for group in self.ambiguous],
            "unexplained": {
                "present": bool(self.unexplained),
                "where": "; ".join(region.kind for region in self.unexplained) or None,
                "joints": dict(self.joint_residuals),
            },
            "noise_floor": make_floors_json(self.floors),
            "findings": [finding.json() for finding in self.findings],
            "treatments": [item.json() for item in self.treatments],
            "suggestion": self.suggestion.json() if self.suggestion is not None else None,
            "no_experiment": self.no_experiment.json() if self.no_experiment is not None else None,
            "tables": list(self.tables),
            "alignments": [alignment.json() for alignment in self.alignments],
            "detectable": [item.json() for item in self.detectable],
            "horizon": None if self.refit is None else self.refit.json(),
        }


@dataclass(frozen=True, repr=False)
class Addition(Summarised):
    """Result of adding an effect to a model.

    Attributes:
        before: refitted model without the effect, and its errors.
        after: refitted model with the effect, and its errors.
        floors: noise floor of the held-out torque at each joint [N m]; in the loop, of the position [rad].
        decision: tests of the effect.
        findings: on data and model.
        criterion: thresholds of the decisions.
    """

    before: Step
    after: Step
    floors: Mapping[str, float]
    decision: Decision = NOTHING_TESTED
    findings: tuple[Finding, ...] = ()
    criterion: Criterion = Criterion()

    @property
    def objection(self) -> FailedGates | None:
        """Finding against the effect: the failed tests; None without any."""
        return explain_rejection(self.decision.gates)

    @property
    def noise_ratio(self) -> float:
        """Held-out error over the noise floor, the largest of all joints."""
        return self.after.compute_noise_ratio(self.floors)

    @property
    def is_misfit(self) -> bool:
        """Return whether the held-out error is more than noise."""
        return self.noise_ratio > self.criterion.misfit_ratio

    @property
    def model(self) -> Model:
        """Model with the effect."""
        return self.after.model

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return make_model_json(self.model) | {
            "schema": ADDITION_SCHEMA,
            "effect": self.after.added,
            "steps": [step.json() for step in (self.before, self.after)],
            "gates": [gate.json() for gate in self.decision.gates],
            "noise_floor": make_floors_json(self.floors),
            "findings": [finding.json() for finding in self.findings],
        }
