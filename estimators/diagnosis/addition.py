"""One effect added to a model by choice, and what the errors say of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.arguments import Recordings, chosen_recordings, model_that_moves, within_limits
from estimators.checks.physical import objection
from estimators.checks.torque_constant import Calibrated, told
from estimators.diagnosis.run import gather
from estimators.progress import Progress, no_progress
from estimators.selection.data import Evidence, Step, noise_floor, with_knocks
from estimators.selection.models import Models
from estimators.selection.motion import sharpen
from estimators.selection.moves import best, is_hidden, loosened, settle
from estimators.selection.search import Selection
from pendulum_env.notebook import shown
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.physics import effect as find_effect

CHANCE = "lowers the held-out errors by no more than chance would"


@dataclass(frozen=True, repr=False)
class Addition:
    """One effect added to a model.

    Attributes:
        before: the model refitted without the effect, and its errors.
        after: the same with the effect.
        noise_floor: torque error that measurement noise alone gives [N m].
        objection: what speaks against the effect, None if nothing does.
        doubt: why the torque constant of a current is not known; None if it is, or torque was logged.
    """

    before: Step
    after: Step
    noise_floor: float
    objection: str | None = None
    doubt: str | None = None

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
        return shown(self)


def fit(train: Evidence, holdout: Evidence, terms: Sequence[Term] = BASE) -> Step:
    """Fit a model's terms to what `gather` returns, as `diagnose` and `add` do: the model and its errors on both."""
    models = Models(train, holdout)
    return sharpen(Selection(models, [models.report(None, settle(models, tuple(terms)))])).steps[-1]


def add(
    model: Model,
    id: str,
    recordings: Recordings,
    holdout: Recordings = (),
    progress: Progress = no_progress,
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> Addition:
    """Refit a model's terms, then with one more effect.

    Args:
        model: to start from.
        id: of the effect.
        recordings: fitted jointly.
        holdout: recordings to confirm on; without them the last 30 % of each recording is held out.
        progress: called with what is being done and the share that is done.
        fixed: values that are known, by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"stribeck": (0.0, 0.5)}`.

    Raises:
        ValueError: if the effect or a parameter is unknown.
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
    terms, library = within_limits(model.terms, {id: kind}, fixed, bounds)
    model, kind = replace(model, terms=terms), library[id]
    progress("reading the motion", 0.0)
    calibrated = Calibrated.of(recordings, holdout)
    recordings, holdout = calibrated.recordings, calibrated.holdout
    evidence = with_knocks(gather(recordings, holdout), model.terms)
    models = Models(*evidence, progress, {kind.id: kind}, base=tuple(model.terms))
    progress("fitting without it", 0.1)
    before = models.report(None, settle(models, models.base))
    (shown,) = sharpen(Selection(models, [before]), model).steps
    progress(f"searching {id}", 0.3)
    trial = best(models, before.model.terms, kind)
    progress(f"fitting with {id}", 0.8)
    terms = settle(models, loosened(models, trial.terms)) if trial else (*before.model.terms, kind())
    progress("sharpening", 0.9)
    longer = Model.build(
        (*shown.model.terms, terms[-1]), np.append(shown.model.theta, np.zeros(len(terms[-1].columns)))
    )
    *_, after = sharpen(Selection(models, [before, models.report(id, terms)]), longer).steps
    against = objection(after, shown, models.train.motions)
    if against is None and trial is not None and not is_hidden(terms[-1]):  # motion tells of these
        against = None if models.is_sure(terms, before.model.terms) else CHANCE
    shown, after = (replace(step, model=told(step.model, models.train.data)) for step in (shown, after))
    floor = noise_floor(models.left.floor, after.errors.values())
    return Addition(shown, after, floor, against, calibrated.doubt)
