"""Addition of one chosen effect to a model: by torque and free runs, or of servos in the loop."""

from collections.abc import Mapping

from estimators.arguments import (
    HasModel,
    Recordings,
    apply_limits,
    check_model,
    select_recordings,
    select_visible_effects,
)
from estimators.diagnosis.cases import choose_case
from estimators.diagnosis.fit import fit_addition
from estimators.diagnosis.result import Addition
from estimators.diagnosis.setting import Setting
from estimators.free_swings import find_scaling_values
from estimators.progress import Progress, no_progress
from pendulum_env.arms.joints import find_kind
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.physics import Bounds, Model


@refuse_unknown_arguments
def add(
    model: Model | HasModel,
    id: str,
    recordings: Recordings,
    holdout: Recordings = (),
    progress: Progress = no_progress,
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Bounds | None = None,
) -> Addition:
    """Refit a model's terms, then with one more effect.

    Args:
        model: to start from.
        id: of the effect, or of a function to be kept as a table, such as `torque_by_angle`; of an arm at one of its
            joints, `stribeck@elbow`.
        recordings: fitted jointly.
        holdout: recordings to confirm on; without them the last 30 % of each recording is held out.
        progress: called with what is being done and the share that is done.
        fixed: values that are known, by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"stribeck": (0.0, 0.5)}`; None is no limit.

    Raises:
        ValueError: if the effect, its joint or a parameter is unknown.
        ModelError: if the model has it already, or has no inertia.
        IdentificationError: if the recordings hold too little motion, or do not show the effect.
        TypeError: if something else is given than a model, an id and recordings.
    """
    if not isinstance(id, str):
        raise TypeError(f"an effect is added by its id, such as 'stribeck', got {id!r}")
    model = check_model(model)
    body = model.body
    recordings = select_recordings(recordings, body=body, log_format=model.log_format)
    holdout = select_recordings(holdout, empty=True, body=body, log_format=model.log_format)
    kind = find_kind(id, body)
    model.add(kind())  # raises if it is there already
    select_visible_effects({kind.id: kind}, recordings)  # raises if it needs a quantity that none has
    if all(recording.is_free for recording in recordings):
        fixed = find_scaling_values(model, fixed)
    terms, library = apply_limits(model.terms, {kind.id: kind}, fixed, bounds)
    setting = Setting(terms, library, progress=progress)
    case = choose_case(terms, (*recordings, *holdout))
    progress("reading the motion", 0.0)
    data, setting = case.prepare(recordings, holdout, setting)
    return fit_addition(case, data, setting, model, library[kind.id])
