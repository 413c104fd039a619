"""Diagnosis: which physical effects does the model lack?"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from estimators.arguments import Recordings, Terms, chosen_effects, chosen_recordings, chosen_terms, within_limits
from estimators.checks.alignment import Aligned
from estimators.checks.closed_loop import feedback
from estimators.checks.homogeneity import disagreements, own_fits
from estimators.checks.identifiability import identifiability, untold
from estimators.checks.remedies import remedies, turned_round
from estimators.checks.residual import Region, everywhere, stand_out
from estimators.checks.torque_constant import Calibrated, of_the_drive, told
from estimators.diagnosis.experiment import USUAL, Limits, questions, suggest
from estimators.diagnosis.in_loop import diagnose_in_loop
from estimators.diagnosis.judge import doubted, judge
from estimators.diagnosis.result import KEPT, UNNAMED, Diagnosis
from estimators.diagnosis.sensitivity import detectable
from estimators.diagnosis.setting import HELD_OUT, Setting
from estimators.in_loop.rollouts import are_driven
from estimators.progress import Progress, forward, no_progress
from estimators.regression.equations import IdentificationError
from estimators.selection.criterion import Criterion
from estimators.selection.data import PreparedData, fit_terms, with_impacts
from estimators.selection.errors import noise_floor
from estimators.selection.models import Models, held_out_cost
from estimators.selection.motion import is_misfit, refine, refit, reselect_transmission
from estimators.selection.moves import explaining, ids, settle
from estimators.selection.physical import impossible
from estimators.selection.prepared import Comparable
from estimators.selection.search import Selection, select
from estimators.signals.measurements import measure_segments
from estimators.weak_form.dataset import choose_half_width, prepare
from estimators.weak_form.instruments import fit_by_reference
from estimators.weak_form.windows import SLOWEST
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Term
from pendulum_env.physics.table import TABLES
from pendulum_env.recording import Recording
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.words import listing

SHORTEST = 0.25  # share of the windows' length, the least, where longer windows are too few
BOLDER = 10.0  # times the largest recorded torque, which a motor is not asked for without a word
PLENTY = 40  # stretches of motion, below which little can be told
MOTION = 0.5  # of the motion, that has to come before what is held out of the end of recordings


def gather(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = (), shorter: float = 1.0
) -> tuple[PreparedData, PreparedData]:
    """Training and held-out data, prepared; without held-out recordings, the end of each recording is held out.

    Args:
        recordings: to fit.
        holdout: to check on.
        shorter: factor on the lengths of the windows, which are shorter still where they would be too few.

    Raises:
        IdentificationError: if a part holds too little motion, or torque is never applied.
    """
    if not any(recording.torque.any() for recording in recordings):
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: torque is never applied, so that only ratios of parameters are known: record with torque"
        )
    try:
        return _gather(recordings, holdout, shorter)
    except IdentificationError:
        if shorter <= SHORTEST:
            raise
        return gather(recordings, holdout, Criterion.closer * shorter)  # through more noise, but there are more of them


def _gather(
    recordings: Sequence[Recording], holdout: Sequence[Recording], shorter: float
) -> tuple[PreparedData, PreparedData]:
    widths = [shorter * choose_half_width(recording) for recording in recordings]
    if holdout:
        return PreparedData.of(recordings, widths), PreparedData.of(
            holdout, [shorter * choose_half_width(r) for r in holdout]
        )

    def split(share: float) -> tuple[PreparedData, PreparedData]:
        return PreparedData.of(recordings, widths, (0.0, share)), PreparedData.of(recordings, widths, (share, 1.0))

    motion = np.concatenate([w.centers / len(w.recording) for w in prepare(recordings, widths).windows])
    if np.mean(motion < 1 - HELD_OUT) >= MOTION:
        with suppress(IdentificationError):  # the end may be at rest
            return split(1 - HELD_OUT)
    return split(float(np.quantile(motion, 1 - HELD_OUT)))  # of the motion, not of the time


def diagnose(
    recordings: Recordings,
    holdout: Recordings = (),
    base: Terms = BASE,
    progress: Progress = no_progress,
    *,
    max_torque: float | None = None,
    max_angle: float | None = None,
    max_speed: float | None = None,
    library: Mapping[str, type[Term]] | None = None,
    only: Sequence[str] | None = None,
    without: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    criterion: Criterion | None = None,
    rng: np.random.Generator | None = None,
    by_reference: bool = False,
) -> Diagnosis:
    """Find the effects that the base model lacks.

    Torque that is logged late or filtered is corrected first: no effect acts before its cause. Where that is otherwise
    beside the effects that are found, it is corrected so, and they are looked for anew. Recordings that disagree with
    the others are named and not fitted: no effect of one plant explains two plants. Known loads are no part of the
    model; where a current was logged, they tell the torque constant, and without them all is per ampere.

    Args:
        recordings: fitted jointly.
        holdout: recordings to confirm on; without them the last 30 % of each recording is held out, or of its motion
            where it hardly moves before.
        base: terms of the model to start from, at least one, as they are or by id; a loaded model's terms will do.
        progress: called with what is being done and the share that is done.
        max_torque: bound of the torque in the experiment that is suggested [N m]; without it the paper's 6 N m, but no
            more than ten times the largest recorded, and no less than that.
        max_angle: bound of its angle to either side of hanging down [rad], infinity for any; without it the angles
            that were recorded, or any within the same number of turns where the joint turned.
        max_speed: bound of its speed [rad/s]; without it the highest that was recorded.
        library: effects that may be named, by id; all that are known if it is not given.
        only: ids of the effects of the library that are looked for; all if it is not given.
        without: ids of effects that the joint cannot have.
        fixed: values that are known, by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"stribeck": (0.0, 0.5), "cogging.order": (10, 14)}`.
        criterion: what they have to achieve.
        rng: of the bootstrap; the same seed gives the same result, and so does none.
        by_reference: fit the base model by instruments, made of the reference that a controller followed; effects are
            looked for, and fitted, by least squares all the same.

    Raises:
        IdentificationError: if the recordings hold too little motion, or no reference that instruments need.
        ValueError: if a name is unknown.
        TypeError: if something else is given than recordings and terms.
    """
    chosen = chosen_effects(library, only, without)
    terms, chosen = within_limits(chosen_terms(base), chosen, fixed, bounds)
    progress = forward(progress)
    fitted, unseen = chosen_recordings(recordings), chosen_recordings(holdout, empty=True)
    setting = Setting(
        terms,
        chosen,
        criterion or Criterion(),
        rng or np.random.default_rng(0),
        progress,
        Limits(max_torque or USUAL, max_angle, max_speed),
        by_reference=by_reference,
    )
    if are_driven([*fitted, *unseen]):
        return diagnose_in_loop(fitted, unseen, setting)
    given = Prepared.of(fitted, unseen, progress)
    usual = given.usual_torque
    setting = replace(setting, usual=usual, limits=replace(setting.limits, torque=max_torque or usual))
    found = _of_one_plant(given, setting)
    if given.aligned.has_moved:  # what an effect does may look like torque that is logged late
        beside = [term for term in found.model.terms if term.id not in ids(BASE)]
        again = Prepared.timed(given.calibrated, beside)
        if not again.aligned.agrees(given.aligned):
            given, found = again, _of_one_plant(again, setting)
    progress("done", 1.0)
    return given.told(found)


@dataclass(frozen=True)
class Prepared:
    """Recordings whose torque is calibrated and timed, and the data prepared of them, fitted and held out."""

    calibrated: Calibrated
    aligned: Aligned
    parts: tuple[PreparedData, PreparedData]

    @classmethod
    def of(cls, recordings: Sequence[Recording], holdout: Sequence[Recording], progress: Progress) -> Prepared:
        """Calibrate and time the torque of recordings."""
        progress("reading the motion", 0.0)
        calibrated = Calibrated.of(recordings, holdout)
        progress("timing the torque", 0.0)
        return cls.timed(calibrated)

    @classmethod
    def timed(cls, calibrated: Calibrated, beside: Sequence[Term] = ()) -> Prepared:
        """Time the torque, beside effects that the joint has."""
        aligned = Aligned.of(calibrated.recordings, calibrated.holdout, beside)
        return cls(calibrated, aligned, gather(aligned.recordings, aligned.holdout))

    @property
    def usual_torque(self) -> float:
        """Torque that an experiment may ask of the motor where no bound is given, in the unit of the recordings."""
        largest = max(float(np.abs(recording.torque).max()) for recording in self.aligned.recordings)
        trusted = min(USUAL, BOLDER * largest) if self.calibrated.unit == NEWTON_METRE else 0.0
        return max(trusted, largest)

    def told(self, found: Diagnosis) -> Diagnosis:
        """A diagnosis with what was found of the torque channel."""
        constant, recordings = self.calibrated.constant, self.aligned.recordings
        wrong = remedies(found.model, recordings, found.ambiguous)
        return replace(
            found,
            torque_unit=self.calibrated.unit,
            torque_constant=constant,
            alignments=self.aligned.alignments,
            advice=(
                *wrong,
                *filter(None, [self.calibrated.doubt]),
                *(of_the_drive(found.model, constant, self.parts[0].data) if constant is not None else ()),
                *_of_timing(self, found),
                *(loop.text for loop in feedback(recordings)),
                *(text for text in found.advice if text not in wrong),
            ),
        )


def _of_one_plant(given: Prepared, setting: Setting) -> Diagnosis:
    """Find the effects that the recordings of one plant call for, and which recordings are another plant's."""
    recordings, holdout, everything = given.aligned.recordings, given.aligned.holdout, given.parts
    datasets = [part.data for part in (everything if holdout else everything[:1])]
    odd = {one.recording: one for one in disagreements(own_fits(datasets, setting.base), only_if_all_fit=True)}
    while True:
        kept = agreeing(recordings, odd)
        prepared = everything if len(kept) == len(recordings) else gather(kept, holdout)
        found = _examine(kept, holdout, prepared, setting)
        named = odd | {one.recording: one for one in disagreements(own_fits(datasets, found.model.terms))}
        left = agreeing(recordings, named)
        odd = named if left else odd  # where every recording would be another plant's, what was said before stands
        if len(left) in (0, len(kept)):
            break
    *others, last = (replace(step, model=told(step.model, prepared[0].data)) for step in found.steps)
    return replace(
        found,
        steps=(*others, replace(last, model=last.model.biased()) if found.unexplained else last),
        disagreements=tuple(odd[number] for number in sorted(odd)),
    )


def _of_timing(given: Prepared, found: Diagnosis) -> list[str]:
    """What is said of the time between torque and motion: what was corrected, and what the drive may have done.

    The latter is asked again beside the effects that were found, and not at all where they explain everything: then
    what looked like a delay of the drive was theirs.
    """
    mended = "this diagnosis has corrected it, other steps do where that is asked for (--align)"
    corrected = [f"{text}: {mended}" for text in given.aligned.texts(True)]
    named = {*found.selected, *(id for group in found.ambiguous for id in group)}
    if named & {"dead_time", "actuator_lag"}:
        return [*corrected, *given.aligned.texts(False)]
    if not (found.unexplained and given.aligned.texts(False)):
        return corrected
    beside = [term for term in found.model.terms if term.id in found.selected]
    return [*corrected, *Aligned.of(given.aligned.recordings, given.aligned.holdout, beside).texts(False)]


def agreeing(recordings: Sequence[Recording], odd: Container[int]) -> list[Recording]:
    """Fitted recordings without those of the given numbers."""
    return [recording for number, recording in enumerate(recordings, 1) if number not in odd]


def _examine(
    recordings: Sequence[Recording],
    holdout: Sequence[Recording],
    prepared: tuple[PreparedData, PreparedData],
    setting: Setting,
) -> Diagnosis:
    """Find the effects that recordings of one plant call for."""
    models = setting.models(prepared)
    followed = fit_by_reference(prepared[0].data, setting.base) if setting.by_reference else None
    wrong = turned_round(fit_terms(prepared[0], setting.base)[0], recordings)
    if wrong is not None:
        return _mislogged(models, setting.base, wrong)
    rough, window_share, beside = _looked_closer(models, recordings, holdout, setting)
    setting.progress("refitting", 0.93)
    found = reselect_transmission(refit(rough))
    models, steps = found.models, found.steps
    if followed is not None:
        steps = [models.with_errors(None, followed), *steps[1:]]
    final = (rough.steps if ids(rough.terms) == ids(steps[-1].model.terms) else steps)[-1].model.terms
    candidates, groups = judge(replace(found, steps=steps), final)
    measured = [m for recording in recordings for m in measure_segments(recording)]
    doubts = identifiability(measured, steps[-1].model.terms)
    doubts = (*doubts, *untold(steps[-1].model, measured, doubts))
    setting.progress("looking for the next experiment", 0.95)
    left = unexplained(replace(found, steps=steps))
    candidates = doubted(candidates, doubts)
    asked = questions(models, steps[-1].model.terms, groups, candidates, doubts)
    if impossible(steps[-1].model, models.train.motions):
        asked = []  # nobody knows what motion to expect
    table = found.table.id if found.table is not None and found.table.id in TABLES else None
    if left and table is None:
        table = explaining(models, steps[-1].model.terms, TABLES.values())
    kept = None if table is None else KEPT.format(table=table)
    suggestion, hopeless, forbidden = suggest(models, steps[-1].model, asked, setting.limits, setting.usual, left)
    if left and not asked:
        forbidden = _of_held_out(models, final) or kept or UNNAMED
    look_alike = [
        f"{' and '.join(group)} look the same in these data; to tell them apart: {models.library[group[-1]].reveal}"
        for group in groups
    ]
    return Diagnosis(
        steps=tuple(steps),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=tuple(left),
        noise_floor=noise_floor(models.left.floor, steps[-1].errors.values()),
        advice=(
            *look_alike,
            *_of_little(prepared[0]),
            *(doubt.text for doubt in doubts),
            *filter(None, (term.beyond(*prepared[0].reach) for term in steps[-1].model.terms)),
            *([suggestion.text] if suggestion else []),
            *([forbidden] if forbidden else []),
            *([kept] if kept and kept != forbidden else []),
        ),
        detectable=() if left or len(final) > len(models.base) else detectable(models, tuple(final), models.library),
        suggestion=suggestion,
        forbidden=forbidden,
        table=table,
        inseparable=tuple((aim.instead, aim.effect) for aim in hopeless if aim.instead),
        window_share=window_share,
        impacts_beside=beside,
    )


def _looked_closer(
    models: Models, recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting
) -> tuple[Selection, float, tuple[Term, ...] | None]:
    """What was found, the share of the windows' length, and the terms beside which impacts were looked at.

    What happens near turns shows in windows that come closer to them, if through more noise, and in those near turns
    that miss more torque than dry friction can be.
    """
    rough, window_share, beside, closer = refine(select(models)), 1.0, None, models.criterion.closer
    if rough.models.left.are_noise(rough.terms)[0] and is_misfit(rough.models, rough.steps[-1]):
        found = refine(select(setting.models(gather(recordings, holdout, closer))))
        if len(found.steps) > 1 and held_out_cost(found.steps[-1]) < held_out_cost(rough.steps[-1]):
            rough, window_share = found, closer
    impacts = with_impacts(rough.models.parts, rough.terms, models.criterion.repeated)
    if impacts is not rough.models.parts:
        found = refine(select(setting.models(impacts)))
        before = found.models.with_errors(None, rough.steps[-1].model)
        if len(found.steps) > 1 and found.models.is_confirmed(found.steps[-1], before):
            rough, beside = found, rough.terms
    return rough, window_share, beside


def _of_little(fitted: PreparedData) -> list[str]:
    """A caveat where little of the motion tells anything."""
    count = len(fitted.data.weights)
    text = "stretches of motion are clear of stick and reversals: much may be missing that does not show"
    return [f"only {count} {text}, record longer, faster or wider motion"] if count < PLENTY else []


def _of_held_out(models: Models, final: Sequence[Term]) -> str | None:
    """What is said where held-out data alone show more."""
    if models.left.are_noise(tuple(final)) != (True, False):
        return None
    return f"what was fitted is explained, and what was held out ({_held_out(models)}) is not: fit that, too"


def _mislogged(models: Models, base: Sequence[Term], text: str) -> Diagnosis:
    """What is said of torque that is logged turned round: no effect is named before that is mended."""
    step = models.report(None, settle(models, tuple(base)))
    region = Region("time", 0.0, float(models.train.samples.time.max()), 0.0, 0.0, text)
    return Diagnosis((step,), (), (), (region,), models.left.floor, (text,), forbidden=text)


def unexplained(found: Selection) -> list[Region]:
    """Regions that the final model leaves unexplained, in torque or else in free-running motion, fitted or held out."""
    models, last = found.models, found.steps[-1]
    wrong = impossible(last.model, models.train.motions)
    if wrong:
        text = (
            f"the best fit has {listing(wrong)}, which no body has: check the signs of torque and position, "
            "or record a motion of more than one frequency"
        )
        return [everywhere(text)]
    left = models.train.watching(last.model).residual(last.model.terms, last.model.theta)
    is_noise = found.table is None and models.left.is_noise(models.train, left)
    regions = [] if is_noise else stand_out(models.train.samples, left, models.left.floor)
    if found.table is not None:
        place = next((own for own in regions if own.axis == found.table.axis), None)
        text = f"{found.table.told} would explain most of it, and no effect of the library is such a law"
        if place is None:
            return [everywhere(text, models.train.samples), *regions]
        return [replace(place, text=f"{text}; {place.text}"), *(own for own in regions if own is not place)]
    if not is_noise:
        return regions or _nowhere(models, models.train, left)
    unseen = models.left.unseen(last.model.terms)
    if not models.left.is_noise(models.holdout, unseen):
        beyond = stand_out(models.holdout.samples, unseen, models.left.noise_of(models.holdout))
        unlike = f"in what was held out ({_held_out(models)})"
        beyond = beyond or _nowhere(models, models.holdout, unseen)
        return [replace(region, text=f"{unlike} {region.text}") for region in beyond]
    if not is_misfit(models, last):
        return []
    error = last.errors["train"].position_rms
    text = (
        f"the torque fits where the joint moves freely, but free-running simulation errs by {error:.2g} rad: "
        "something acts near reversals or at rest, where velocity is close to zero"
    )
    return [Region("velocity", -SLOWEST, SLOWEST, 0.0, 0.0, text)]


def _held_out(models: Models) -> str:
    """Names of the held-out recordings."""
    return listing(list(dict.fromkeys(recording.name for recording in models.holdout.recordings)))


def _nowhere(models: Models, part: Comparable, left: Array) -> list[Region]:
    """What is said of a residual (R,) that stands out nowhere: nothing, unless it is too much for noise."""
    size, floor = float(np.sqrt(np.mean(left**2))), models.left.noise_of(part)
    if size <= models.criterion.misfit * floor:
        return []
    text = (
        f"{size:.2g} N m of torque are left, {size / floor:.2g} times what the sensors' noise gives, at no one speed, "
        "angle or time: something faster than can be resolved here, or now and then"
    )
    return [everywhere(text, part.samples, size, floor)]
