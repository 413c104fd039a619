"""Comparison of a model with recordings: errors, and regions of the residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from estimators.arguments import (
    HasModel,
    Recordings,
    check_horizon,
    check_model,
    select_recordings,
    select_visible_effects,
)
from estimators.checks.homogeneity import (
    Disagreement,
    find_disagreements_with_model,
    find_misfits,
    fit_each_recording,
)
from estimators.data.calibration import convert_to_model_unit
from estimators.data.fit_data import FitData
from estimators.data.regions import find_failures
from estimators.data.regression_data import RegressionData
from estimators.prediction import Prediction, predict_recordings
from estimators.selection.errors import Errors, get_single
from estimators.signals.residual import AXES, Profile, Region, compute_profiles
from estimators.simulation.free_running import HORIZON
from estimators.weak_form.torque_windows import join_windows
from pendulum_env._typing import JSON, Array
from pendulum_env.arguments import check_order
from pendulum_env.arms.body import Body
from pendulum_env.errors import UserError
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.notebook import render_html, summarise
from pendulum_env.physics import Model
from pendulum_env.physics.terms import has_link
from pendulum_env.recording import Recording
from pendulum_env.recording.channel import TorqueConstant
from pendulum_env.units import JointUnits

SCHEMA = "pendulum-ident/comparison@2"
SHOWN = 6  # regions where a model fails, shared by the joints


@dataclass(frozen=True)
class Distance:
    """Errors of a model on one or all recordings.

    Attributes:
        name: of the recording.
        errors: in torque and in free-running position.
        floors: torque error that measurement noise alone gives at each joint [N m].
        unstable: share of the windows of free run in which a small error grows tenfold, as with the arm balanced
            upright; they are not counted in the error of position, unless there are no others.
    """

    name: str
    errors: Errors
    floors: Mapping[str, float]
    unstable: float = 0.0

    @property
    def noise_floor(self) -> float:
        """Return the noise floor of a single joint; NaN for several joints."""
        return get_single(self.floors)

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "name": self.name,
            "errors": self.errors.json(),
            "noise_floor": make_floors_json(self.floors),
            "unstable": self.unstable,
        }


@dataclass(frozen=True, repr=False)
class Comparison:
    """Comparison of a model with recordings.

    Attributes:
        model: as it came; nothing is fitted.
        distances: one a recording; empty of an arm.
        joint: all recordings together.
        profiles: residual torque over position, velocity, torque, time and frequency, all recordings together; empty of
            an arm.
        regions: where it stands out of the noise, the most telling first, of an arm joint by joint.
        disagreements: recordings that show another plant than the model is of, or than the others.
        torque_constant: by which a current was turned into torque, if one was.
        data: that it was made of, all compared alike.
        horizon: length of the windows of free run [s]; None of an arm.
    """

    model: Model
    distances: tuple[Distance, ...]
    joint: Distance
    profiles: tuple[Profile, ...]
    regions: tuple[Region, ...]
    disagreements: tuple[Disagreement, ...] = ()
    torque_constant: TorqueConstant | None = None
    data: FitData | None = field(default=None, compare=False, repr=False)
    horizon: float | None = HORIZON

    @property
    def errors(self) -> Errors:
        """Return the errors on all recordings together."""
        return self.joint.errors

    @cached_property
    def recordings(self) -> tuple[Prediction, ...]:
        """Return each recording with the predictions of the model, sample by sample."""
        if self.data is None:
            raise UserError("the comparison has no data: compare the model with the recordings again")
        return predict_recordings(self.model, self.data)

    @property
    def torque_unit(self) -> str:
        """Return the unit of torque of the model, `N m` or the unit of a current."""
        return self.model.torque_unit

    @property
    def is_torque_logged(self) -> bool:
        """Return whether a recording has measured torque instead of the command of a controller."""
        return self.data is None or _is_logged(self.data.recordings)

    @property
    def headline(self) -> str:
        """Return the result in one sentence."""
        return summarise(self)

    def __repr__(self) -> str:
        return f"<Comparison: {self.headline}>"

    def _repr_html_(self) -> str:
        return render_html(self)

    def json(self) -> JSON:
        """Return a dictionary for JSON; `joint` has all recordings together."""
        return make_result_json(self.model, self.torque_constant, self.regions, self.disagreements) | {
            "schema": SCHEMA,
            "recordings": [distance.json() for distance in self.distances],
            "joint": self.joint.json(),
            "horizon": self.horizon,
            "profiles": [
                {
                    "axis": item.axis,
                    "unit": item.unit,
                    "edges": item.edges.tolist(),
                    "mean": item.mean.tolist(),
                    "error": item.error.tolist(),
                }
                for item in self.profiles
            ],
        }


def make_result_json(
    model: Model,
    constant: TorqueConstant | None,
    regions: Sequence[Region],
    disagreements: Sequence[Disagreement],
) -> JSON:
    """Return what the files of `compare` and `diagnose` share, as a plain dictionary for JSON."""
    every = {at: model.units(at) for at in model.body.joints}
    return {
        "torque_unit": model.torque_unit,
        "torque_constant": constant.json() if constant is not None else None,
        "units": {at: {name: units.unit(AXES[name]) for name in ("position", "torque")} for at, units in every.items()},
        "model": model.json(),
        "regions": [region.json() for region in regions],
        "disagreements": [disagreement.json() for disagreement in disagreements],
    }


def make_floors_json(floors: Mapping[str, float]) -> JSON:
    """Return noise floors as a plain dictionary for JSON; null stands for that of several joints together."""
    return {"torque_rms": get_single(floors) if len(floors) == 1 else None, "joints": dict(floors)}


def compute_distance(name: str, prepared: RegressionData, model: Model, loop_error: Array) -> Distance:
    """Compute errors of a model with inertia on prepared data; those of positions in the loop (R,) [rad] are known."""
    steady, unstable = prepared.with_steady_segments(model)
    return Distance(name, steady.errors(model).with_loop(loop_error), prepared.floors, unstable)


def join_recordings(parts: Sequence[RegressionData]) -> RegressionData:
    """Join prepared data of several recordings, with the link states of each."""
    data = join_windows([window for part in parts for window in part.data.windows])
    link_states = {id: [x for part in parts for x in part.data.link_states[id]] for id in parts[0].data.link_states}
    return RegressionData(
        replace(data, link_states=link_states), tuple(segment for part in parts for segment in part.segments)
    )


@refuse_unknown_arguments
def compare(model: Model | HasModel, recordings: Recordings, *, horizon: float | None = None) -> Comparison:
    """Compare a model with recordings, as it is: torque residual and free-running simulation.

    Where a current was logged, the model's own torque constant turns it into torque, or else their known loads do.
    Of an arm, the errors are those of the torque of each joint, all recordings together.

    Args:
        model: or a result that has one.
        recordings: compared one by one, and together.
        horizon: length of free-running simulations [s], each from the measured state under the recorded torque; by
            default 1 s.

    Raises:
        IdentificationError: if one of the recordings holds too little motion, or a joint of an arm does, or if none has
            a quantity that the model needs, such as a temperature, or one is shorter than the horizon.
        ModelError: if the model has no inertia, or is of a current and the recordings are not.
        TypeError: if something else is given than a model and recordings.
        ValueError: if the horizon is not above zero, or is given for an arm.
    """
    check_order("compare(model, recordings)", (model, Model), (recordings, Recording))
    model = check_model(model)
    check_horizon(horizon, model.body.can_simulate)
    recordings = select_recordings(recordings, body=model.body, log_format=model.log_format)
    recordings = convert_to_model_unit(model, recordings)
    if recordings[0].units.slides:
        model = model.convert_units(JointUnits(model.torque_unit, slides=True))
    select_visible_effects({term.id: type(term) for term in model.terms if term.needs}, recordings)
    joints = model.terms if isinstance(model.body, Body) else ()
    alone = [] if joints else [_prepare_data(recording, model, horizon) for recording in recordings]
    together = join_recordings(alone) if alone else RegressionData.of_arm(recordings, joints)
    data = FitData(recordings, recordings, terms=joints, horizon=horizon).with_parts((together, together))
    loop = data.simulate_in_loop(model)
    joint = compute_distance("all", together, model, loop.error)
    left = together.residual(model.terms, model.theta)
    fits = fit_each_recording([together.data], model.terms) if alone and not joint.errors.is_in_loop else []
    failing, most = joint.floors if _is_logged(recordings) else (), max(1, SHOWN // len(joint.floors))
    return Comparison(
        model,
        tuple(compute_distance(part.names[0], part, model, loop.of(k).error) for k, part in enumerate(alone)),
        joint,
        tuple(compute_profiles(together.samples, left, joint.noise_floor, units=together.units()) if alone else ()),
        tuple(region for at in failing for region in find_failures(together, left, at, most)),
        (*find_disagreements_with_model(model, fits), *find_misfits(fits)),
        recordings[0].torque_constant,
        data,
        None if joints else horizon or HORIZON,
    )


def _is_logged(recordings: Sequence[Recording]) -> bool:
    return any(recording.has_logged_torque for recording in recordings)


def _prepare_data(recording: Recording, model: Model, horizon: float | None) -> RegressionData:
    """Prepare a recording, with impacts that the friction of the model does not explain."""
    prepared = RegressionData.of([recording])
    prepared = prepared if horizon is None else prepared.with_horizon(horizon)
    if has_link(model.terms):
        return prepared.with_link_states(model)
    count, inertia = len(model.theta), abs(model.estimates["inertia"].value)
    covariance = model.assumed_covariance[:count, :count]
    data, known = prepared.data, (model.terms, model.theta, covariance, inertia)
    return replace(prepared, data=data.with_contacts(*known, data.free_range(*known)))
