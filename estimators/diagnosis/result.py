"""Results of a diagnosis, with the probability of each effect, and of an addition, with errors before and after it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property

from estimators.checks.alignment import Alignment
from estimators.checks.homogeneity import Disagreement
from estimators.data.fit_data import FitData
from estimators.diagnosis.suggestion import Suggestion
from estimators.findings import Finding, Verdict
from estimators.prediction import Prediction, predict_recordings
from estimators.results import make_floors_json, make_result_json
from estimators.selection.errors import Gate, Step, Terms, get_single
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.score import Gain
from estimators.signals.residual import Region
from pendulum_env._typing import JSON
from pendulum_env.notebook import render_html, summarise
from pendulum_env.physics import Mechanism, Model
from pendulum_env.recording.channel import NEWTON_METRE, TorqueConstant

SCHEMA = "pendulum-ident/diagnosis@2"


@dataclass(frozen=True)
class Candidate:
    """Verdict on one effect of the library, with its scores.

    Attributes:
        effect: its id.
        score: probability, between 0 and 1, that it is what the data call for at its place among the alternatives.
        verdict: what became of it.
        error_ratio: torque error on held-out data with the effect, over the error without it.
        reason: a finding that says why.
        gain: what it predicts better than its absence beside the other effects of the final model, where that is known.
        variants: number of compared variants, as in `ModelEvaluator.n_variants`; the best of many gains by chance.
        gates: tests that the effect met, in order; a rejected effect failed the last.
        terms: of the model that was evaluated; empty if the effect was not tried.
    """

    effect: str
    score: float
    verdict: Verdict
    error_ratio: float
    reason: Finding
    gain: Gain | None = None
    variants: int = 1
    gates: tuple[Gate, ...] = ()
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
            "gates": [gate.json() for gate in self.gates],
        }


@dataclass(frozen=True)
class Detectable:
    """An effect that would have shown: above a size in its unit, or wherever it is between two angles [rad].

    Without either, the motion does not excite the effect: no possible size would have shown.
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
        treatment: what was done.
        error_ratio: held-out error of the model that was found, over that of the model without the treatment.
        assumptions: effects, corrected torque and treatments of windows, with the treatment.
        before: the same without it.
        is_kept: whether the result stands on it.
    """

    treatment: Finding
    error_ratio: float
    assumptions: int
    before: int
    is_kept: bool

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        assumptions = {"with": self.assumptions, "without": self.before}
        return self.treatment.json() | {
            "error_ratio": self.error_ratio if self.error_ratio < float("inf") else None,
            "assumptions": assumptions,
            "kept": self.is_kept,
        }


@dataclass(frozen=True)
class HorizonRefit:
    """Refit of the final model to free-running motion over a horizon, each segment from its measured state.

    Attributes:
        seconds: the horizon [s].
        before: the model that the search found, with errors of free runs over the horizon.
        after: the refitted model, with the same errors; None if the motion errs by no more than noise.
        is_kept: whether the refitted model is the final one: it lowers the held-out error, and a body can have it.
        is_interrupted: whether the refit was interrupted; it then ended at a shorter horizon.
    """

    seconds: float
    before: Step
    after: Step | None = None
    is_kept: bool = False
    is_interrupted: bool = False

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "seconds": self.seconds,
            "before": self.before.json(),
            "after": None if self.after is None else self.after.json(),
            "kept": self.is_kept,
            "interrupted": self.is_interrupted,
        }


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Result of a diagnosis.

    Attributes:
        steps: the base model, then one entry for each effect added.
        candidates: every effect of the library, selected ones first.
        ambiguous: groups of effects that these data cannot tell apart.
        unexplained: regions whose residual no candidate explains, empty when the noise floor is reached; of an arm one
            of each joint that leaves more than noise, everywhere where it stands out nowhere.
        floors: torque error that measurement noise alone gives at each joint [N m]; in the loop the mean distance
            that the encoder alone gives [rad].
        findings: on data and model, first those that count most.
        suggestion: the experiment that would settle most of what is open, None if nothing is, or none would.
        forbidden: why no experiment settles what is open or left, above all the limits of the rig; None if nothing is.
        tables: what would keep a function that explains what is left, and that no effect is: one, or one of each joint.
        inseparable: groups that no torque would tell apart, whatever it was.
        disagreements: recordings that show another plant than the others; fitted ones among them are set apart.
        alignments: time between torque and motion in each recording, fitted ones first; torque that was logged late or
            filtered was corrected by it.
        detectable: what would have shown, where nothing is missing.
        torque_unit: `N m`, or that of a current in whose stead parameters and errors are per unit of it.
        torque_constant: by which a current was turned into torque, if one was; standard errors include its own.
        data: that it was made of, without recordings that disagree; None of a diagnosis that was read from a file.
        left: of an arm, torque that is left of joints and is no noise [N m]: what neighbouring windows share, or all.
        treatments: of the recordings that were tried, in order; what was done to them before is in the data.
        refit: to free-running motion over a horizon; None if none was asked for.
        evaluator: fits and scores of the search; `evaluator.model(candidate.terms)` is a candidate. Not pickled.
    """

    steps: tuple[Step, ...]
    candidates: tuple[Candidate, ...]
    ambiguous: tuple[tuple[str, ...], ...]
    unexplained: tuple[Region, ...]
    floors: Mapping[str, float]
    findings: tuple[Finding, ...]
    suggestion: Suggestion | None = None
    forbidden: Finding | None = None
    tables: tuple[str, ...] = ()
    inseparable: tuple[tuple[str, ...], ...] = ()
    disagreements: tuple[Disagreement, ...] = ()
    alignments: tuple[Alignment, ...] = ()
    detectable: tuple[Detectable, ...] = ()
    torque_unit: str = NEWTON_METRE
    torque_constant: TorqueConstant | None = None
    data: FitData | None = field(default=None, compare=False, repr=False)
    left: Mapping[str, float] = field(default_factory=dict)
    evaluator: ModelEvaluator | None = field(default=None, compare=False, repr=False)
    treatments: tuple[TriedTreatment, ...] = ()
    refit: HorizonRefit | None = None

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "evaluator"}

    @property
    def model(self) -> Model:
        """The final model."""
        return self.steps[-1].model

    @cached_property
    def recordings(self) -> tuple[Prediction, ...]:
        """Each recording beside what the final model predicts of it, fitted ones first; without those that disagree."""
        return predict_recordings(self.model, self.data)

    @property
    def noise_floor(self) -> float:
        """Return the noise floor of a single joint; NaN for several joints."""
        return get_single(self.floors)

    @property
    def body(self) -> Mechanism:
        """Joints of the model."""
        return self.model.body

    @property
    def is_in_loop(self) -> bool:
        """Return whether errors are those of simulated motion with the controller in the loop."""
        return self.steps[0].errors["holdout"].is_in_loop

    def unit_at(self, joint: str) -> str:
        """Return the unit of the error at a joint: of torque, of current, or of motion in the loop."""
        return self.model.units(joint).unit(self.steps[0].errors["holdout"].unit)

    @property
    def selected(self) -> tuple[str, ...]:
        """Ids of the effects found to be missing, in the order in which they were added."""
        return tuple(step.added for step in self.steps if step.added is not None)

    @property
    def effects(self) -> tuple[tuple[str, ...], ...]:
        """Return the selected effects, each with the effects that these data do not distinguish from it."""
        rivals = {group[0]: group for group in self.ambiguous}
        return tuple(rivals.get(id, (id,)) for id in self.selected)

    @property
    def laws(self) -> list[str]:
        """Laws of the effects found to be missing: `stribeck: fs exp(-|q'/vs|^n) sgn q'`."""
        known = {term.id: term.law for term in self.model.terms}
        return [f"{id}: {known[id]}" for id in self.selected if id in known]

    @property
    def searched(self) -> bool:
        """Return whether effects were searched, which a comparison does not."""
        return bool(self.candidates or self.left)

    @property
    def headline(self) -> str:
        """The result in one sentence: `Stribeck friction is missing`."""
        return summarise(self)

    def __repr__(self) -> str:
        return f"<Diagnosis: {self.headline}>"

    def _repr_html_(self) -> str:
        return render_html(self)

    def json(self) -> JSON:
        """Return a dictionary for JSON; a pendulum has one joint, "".

        A comparison has the same units, model, regions and disagreements.
        """
        base = self.steps[0].model
        last = [] if self.forbidden is None or self.forbidden in self.findings else [self.forbidden]
        return make_result_json(self.model, self.torque_constant, self.unexplained, self.disagreements) | {
            "schema": SCHEMA,
            "base": {
                "terms": [term.id for term in base.terms],
                "theta": {name: estimate.json() for name, estimate in base.estimates.items()},
            },
            "selected": list(self.selected),
            "steps": [step.json() for step in self.steps],
            "candidates": [candidate.json() for candidate in self.candidates],
            "ambiguous": [list(group) for group in self.ambiguous],
            "unexplained": {
                "present": bool(self.unexplained),
                "where": "; ".join(region.kind for region in self.unexplained) or None,
                "joints": dict(self.left),
            },
            "noise_floor": make_floors_json(self.floors),
            "findings": [finding.json() for finding in (*self.findings, *last)],
            "treatments": [one.json() for one in self.treatments],
            "suggestion": self.suggestion.json() if self.suggestion is not None else None,
            "table": next(iter(self.tables), None),
            "tables": list(self.tables),
            "inseparable": [list(group) for group in self.inseparable],
            "alignments": [alignment.json() for alignment in self.alignments],
            "detectable": [one.json() for one in self.detectable],
            "horizon": None if self.refit is None else self.refit.json(),
        }


@dataclass(frozen=True, repr=False)
class Addition:
    """Result of adding an effect to a model.

    Attributes:
        before: the model refitted without the effect, and its errors.
        after: the same with the effect.
        floors: torque error that measurement noise alone gives at each joint [N m]; in the loop that of the position
            which encoder and clock may give [rad].
        objection: what speaks against the effect, None if nothing does.
        doubt: why the torque constant of a current is not known; None if it is, or torque was logged.
    """

    before: Step
    after: Step
    floors: Mapping[str, float]
    objection: Finding | None = None
    doubt: Finding | None = None

    @property
    def left(self) -> float:
        """Held-out error that is left, in noise floors."""
        error = self.after.errors["holdout"]
        return max(error.get_joint_error(at) / max(floor, 1e-300) for at, floor in self.floors.items())

    @property
    def model(self) -> Model:
        """The model with the effect."""
        return self.after.model

    def __repr__(self) -> str:
        return f"<Addition: {summarise(self)}>"

    def _repr_html_(self) -> str:
        return render_html(self)
