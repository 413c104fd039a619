"""Diagnosis: which physical effects does the model lack?"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.agreement import disagreements
from estimators.dataset import choose_half_width
from estimators.design import USUAL, Limits, questions, suggest
from estimators.diagnosis import Diagnosis, Step
from estimators.equations import IdentificationError
from estimators.evidence import Evidence, fit_terms
from estimators.identifiability import identifiability
from estimators.in_flight import (
    BETTER,
    fly,
    grow_in_flight,
    has_hidden_state,
    hides,
    is_astray,
    position_error,
    relink,
    sharpen,
    strays,
)
from estimators.inputs import Recordings, Terms, chosen_recordings, chosen_terms, model_that_moves
from estimators.measurements import measure
from estimators.plausibility import impossible, objection, turned_round, wrong_signs
from estimators.regions import Region, profiles, stand_out
from estimators.search import Progress, Search, look, no_progress
from estimators.timing import late_torque
from estimators.verdicts import judge
from estimators.windows import SLOWEST
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.physics import effect as find_effect
from pendulum_env.recording import Recording

HOLDOUT_SHARE = 0.3  # end of each recording that is held out when no recording is
NEAREST = 3  # effects beside which late torque is looked for where nothing fits
SHORTER = 0.5  # share of the windows' length at a second look


def gather(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = (), shorter: float = 1.0
) -> tuple[Evidence, Evidence]:
    """Training and held-out evidence; without held-out recordings, the end of each recording is held out.

    Args:
        recordings: to fit.
        holdout: to check on.
        shorter: factor on the lengths of the windows.

    Raises:
        IdentificationError: if a part holds too little motion, or torque is never applied.
    """
    if not any(recording.torque.any() for recording in recordings):
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: torque is never applied, so that only ratios of parameters are known: record with torque"
        )
    widths = [shorter * choose_half_width(recording) for recording in recordings]
    if not holdout:
        share = 1 - HOLDOUT_SHARE
        return Evidence.of(recordings, widths, (0.0, share)), Evidence.of(recordings, widths, (share, 1.0))
    return Evidence.of(recordings, widths), Evidence.of(holdout, [shorter * choose_half_width(r) for r in holdout])


def diagnose(
    recordings: Recordings,
    holdout: Recordings = (),
    base: Terms = BASE,
    progress: Progress = no_progress,
    max_torque: float | None = None,
    max_angle: float = np.inf,
    max_speed: float = np.inf,
) -> Diagnosis:
    """Find the effects that the base model lacks.

    Recordings that disagree with the others are named and not fitted: no effect of one plant explains two plants.

    Args:
        recordings: fitted jointly.
        holdout: recordings to confirm on; without them the last 30 % of each recording is held out.
        base: terms of the model to start from, at least one, as they are or by id; a loaded model's terms will do.
        progress: called with what is being done and the share that is done.
        max_torque: bound of the torque in the experiment that is suggested [N m]; without it the largest recorded,
            or the paper's 6 N m if that is more.
        max_angle: bound of its angle to either side of hanging down [rad].
        max_speed: bound of its speed [rad/s].

    Raises:
        IdentificationError: if the recordings hold too little motion.
        ValueError: if a name is unknown.
        TypeError: if something else is given than recordings and terms.
    """
    recordings, holdout = chosen_recordings(recordings), chosen_recordings(holdout, empty=True)
    base = chosen_terms(base)
    progress("reading the motion", 0.0)
    everything = gather(recordings, holdout)
    usual = max(USUAL, *(float(np.abs(recording.torque).max()) for recording in recordings))
    limits = Limits(max_torque or usual, max_angle, max_speed)
    datasets = [part.data for part in (everything if holdout else everything[:1])]
    odd = {one.recording: one for one in disagreements(datasets, base, only_if_all_fit=True)}
    while True:
        kept = agreeing(recordings, odd)
        evidence = everything if len(kept) == len(recordings) else gather(kept, holdout)
        found = _examine(kept, holdout, evidence, base, progress, limits, usual)
        named = odd | {one.recording: one for one in disagreements(datasets, found.model.terms)}
        left = agreeing(recordings, named)
        odd = named if left else odd  # where every recording would be another plant's, what was said before stands
        if len(left) in (0, len(kept)):
            break
    progress("done", 1.0)
    return replace(found, disagreements=tuple(odd[number] for number in sorted(odd)))


def agreeing(recordings: Sequence[Recording], odd: Container[int]) -> list[Recording]:
    """Fitted recordings without those of the given numbers."""
    return [recording for number, recording in enumerate(recordings, 1) if number not in odd]


def _examine(
    recordings: Sequence[Recording],
    holdout: Sequence[Recording],
    evidence: tuple[Evidence, Evidence],
    base: Sequence[Term],
    progress: Progress,
    limits: Limits,
    usual: float,
) -> Diagnosis:
    """Find the effects that recordings of one plant call for."""
    wrong = late_torque(recordings, [base]) or turned_round(fit_terms(evidence[0], base)[0])
    if wrong is not None:
        return _mislogged(Search(*evidence, progress), base, wrong)
    search, steps = look(*evidence, base, progress)
    window_share = 1.0
    if strays(search, steps[-1]) or has_hidden_state(steps[-1].model.terms):
        progress("fitting the flights", 0.9)
        steps = fly(search, steps)
    if hides(search, steps[-1]):
        # What happens near reversals shows in windows that come closer to them, if through more noise.
        closer, found = look(*gather(recordings, holdout, SHORTER), base, progress)
        found = fly(closer, found)
        without = min(position_error(steps[-1]), position_error(found[0]))
        if len(found) > 1 and position_error(found[-1]) < BETTER * without:
            search, steps, window_share = closer, found, SHORTER
    if hides(search, steps[-1]):
        steps = grow_in_flight(search, steps)
    tried = [step.model.terms for step in steps[1:]]
    if not search.fits(steps[-1]):  # late torque may hide the effect that would be found without it
        tried += [trial.terms for trial in search.alternatives(steps[-1].model.terms)[:NEAREST]]
    late = late_torque(recordings, tried)
    if late is not None:
        return _mislogged(search, base, late)
    progress("sharpening", 0.93)
    rough, steps = steps, relink(search, sharpen(search, steps))
    if [step.added for step in steps] != [step.added for step in rough]:
        rough = steps  # another transmission took the place of what windows took for one
    candidates, groups = judge(search, rough, steps)
    doubts = identifiability([measure(recording) for recording in recordings], steps[-1].model.terms)
    progress("looking for the next experiment", 0.95)
    asked = questions(search, steps[-1].model.terms, groups, candidates, doubts)
    suggestion, hopeless, forbidden = suggest(search, steps[-1].model, asked, limits, usual)
    inseparable = tuple((aim.instead, aim.effect) for aim in hopeless if aim.instead)
    look_alike = [
        f"{' and '.join(group)} look the same in these data; to tell them apart: {search.library[group[-1]].reveal}"
        for group in groups
    ]
    return Diagnosis(
        steps=tuple(steps),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=tuple(unexplained(search, steps[-1])),
        noise_floor=search.floor,
        advice=(
            *look_alike,
            *(doubt.text for doubt in doubts),
            *wrong_signs(steps[-1].model),
            *([suggestion.text] if suggestion else []),
            *([forbidden] if forbidden else []),
        ),
        suggestion=suggestion,
        forbidden=forbidden,
        inseparable=inseparable,
        window_share=window_share,
    )


def _mislogged(search: Search, base: Sequence[Term], text: str) -> Diagnosis:
    """What is said of torque that is late or turned round: no effect is named before that is mended."""
    step = search.report(None, search.settle(base))
    region = Region("time", 0.0, float(search.train.samples.time.max()), 0.0, 0.0, text)
    return Diagnosis((step,), (), (), (region,), search.floor, (text,))


def unexplained(search: Search, last: Step) -> list[Region]:
    """Regions that the final model leaves unexplained, in torque or else in free-running motion."""
    left = search.train.watching(last.model).residual(last.model.terms, last.model.theta)
    wrong = impossible(last.model, search.train.samples)
    if wrong:
        text = (
            f"{' and '.join(wrong)} came out negative, which no body has: check the signs of torque and position, "
            "or record a motion of more than one frequency"
        )
        return [Region("velocity", -np.inf, np.inf, 0.0, 0.0, text)]
    regions = stand_out(profiles(search.train.samples, left, search.floor))
    if search.unnamed is not None:
        fast = float(np.abs(search.train.samples.velocity).max())
        text = f"{search.unnamed.words} fits up to {fast:.3g} rad/s, and no effect of the library is such a law"
        return [Region("velocity", -fast, fast, 0.0, 0.0, text), *regions]
    if is_structured(left, search.floor):
        return regions
    if is_astray(search, last):
        error = last.errors["train"].position_rms
        text = (
            f"the torque fits where the joint moves freely, but free-running simulation errs by {error:.2g} rad: "
            "something acts near reversals or at rest, where velocity is close to zero"
        )
        return [Region("velocity", -SLOWEST, SLOWEST, 0.0, 0.0, text)]
    return []


def is_structured(residual: Array, floor: float) -> bool:
    """Whether a residual is above the noise floor and correlated from window to window."""
    excess = float(np.sqrt(np.mean(residual**2))) / floor
    centred = residual - residual.mean()
    correlation = float(centred[1:] @ centred[:-1] / max(centred @ centred, 1e-300))
    return excess > 2.0 or (excess > 1.3 and correlation > 0.3)


@dataclass(frozen=True, repr=False)
class Addition:
    """One effect added to a model.

    Attributes:
        before: the model refitted without the effect, and its errors.
        after: the same with the effect.
        noise_floor: torque error that measurement noise alone gives [N m].
        objection: what speaks against the effect, None if nothing does.
    """

    before: Step
    after: Step
    noise_floor: float
    objection: str | None = None

    @property
    def text(self) -> str:
        """Whether the effect earns its place, in a sentence: only data that it was not fitted to can tell."""
        if self.objection is not None:
            return f"{self.after.added} {self.objection}: these recordings give no reason to keep it"
        old, new = self.before.errors["holdout"], self.after.errors["holdout"]
        torque, position = new.torque_rms / old.torque_rms, new.position_rms / old.position_rms
        falls = f"torque to {torque:.1%}, position to {position:.1%} of before"
        return f"{self.after.added} lowers the held-out errors: {falls}"

    @property
    def model(self) -> Model:
        """The model with the effect."""
        return self.after.model

    def __repr__(self) -> str:
        return f"<Addition: {self.text}>"

    def _repr_html_(self) -> str:
        from estimators.notebook import show_addition  # only a notebook asks for it

        return show_addition(self)


def fit(train: Evidence, holdout: Evidence, terms: Sequence[Term] = BASE) -> Step:
    """Fit a model's terms to what `gather` returns, as `diagnose` and `add` do: the model and its errors on both."""
    search = Search(train, holdout)
    return sharpen(search, [search.report(None, search.settle(terms))])[-1]


def add(
    model: Model, id: str, recordings: Recordings, holdout: Recordings = (), progress: Progress = no_progress
) -> Addition:
    """Refit a model's terms, then with one more effect.

    Raises:
        ValueError: if the effect is unknown.
        ModelError: if the model has it already, or has no inertia.
        IdentificationError: if the recordings hold too little motion.
        TypeError: if something else is given than a model, an id and recordings.
    """
    model, recordings = model_that_moves(model), chosen_recordings(recordings)
    holdout = chosen_recordings(holdout, empty=True)
    if not isinstance(id, str):
        raise TypeError(f"an effect is added by its id, such as 'stribeck', got {id!r}")
    kind = find_effect(id)
    model.add(kind())  # raises if it is there already
    progress("reading the motion", 0.0)
    search = Search(*gather(recordings, holdout), progress)
    progress("fitting without it", 0.1)
    before = search.report(None, search.settle(model.terms))
    (shown,) = sharpen(search, [before], model)
    progress(f"searching {id}", 0.3)
    trial = search.screen.best(before.model.terms, kind)
    progress(f"fitting with {id}", 0.8)
    terms = search.settle(trial.terms) if trial else (*before.model.terms, kind())
    progress("sharpening", 0.9)
    longer = Model.build(
        (*shown.model.terms, terms[-1]), np.append(shown.model.theta, np.zeros(len(terms[-1].columns)))
    )
    *_, after = sharpen(search, [before, search.report(id, terms)], longer)
    return Addition(shown, after, search.floor, objection(after, shown, search.train.samples))
