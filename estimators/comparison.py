"""Comparison: how far a model is from recordings, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from estimators.arguments import Recordings, chosen_recordings, model_that_moves
from estimators.checks.homogeneity import Disagreement, disagreements_with, misfits, own_fits
from estimators.checks.residual import Profile, Region, profiles, stand_out
from estimators.checks.torque_constant import unit_of
from estimators.in_loop.fit import in_loop
from estimators.preprocessing import Preprocessed
from estimators.regression.equations import IdentificationError
from estimators.schemes.balance import ARM_SCHEMES, measure_arm, series
from estimators.schemes.fitting import regressions, stack
from estimators.selection.data import PreparedData
from estimators.selection.errors import Errors, Step, noise_floor
from estimators.simulation.free_running import growth, select
from estimators.simulation.multiple_shooting import has_link
from estimators.weak_form.dataset import dataset
from pendulum_env._typing import JSON
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import body_of
from pendulum_env.arms.model import model_of
from pendulum_env.arms.recording import of_arms
from pendulum_env.notebook import shown
from pendulum_env.physics import Model, ModelError
from pendulum_env.recording import Recording
from pendulum_env.recording.record import NEWTON_METRE, TorqueConstant
from pendulum_env.words import json_per, percent

SCHEMA, ARM_SCHEMA = "pendulum-ident/comparison@1", "pendulum-ident/arm-comparison@1"
GROWS = 10.0  # times, that an error of the initial position grows in a window of free run where the motion is unstable


@dataclass(frozen=True)
class Distance:
    """Errors of a model on one recording, or on all.

    Attributes:
        name: of the recording.
        errors: in torque and in free-running position.
        noise_floor: torque error that measurement noise alone gives [N m]; NaN of an arm, for which nobody has counted.
        unstable: share of the one-second windows in which a small error grows tenfold, as with the arm balanced
            upright; they are not counted in the error of position, unless there are no others.
    """

    name: str
    errors: Errors
    noise_floor: float
    unstable: float = 0.0

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "name": self.name,
            "errors": self.errors.json(),
            "noise_floor": {"torque_rms": self.noise_floor},
            "unstable": self.unstable,
        }


@dataclass(frozen=True, repr=False)
class Comparison:
    """A model against recordings.

    Attributes:
        model: as it came; nothing is fitted.
        distances: one a recording; empty of an arm, of which nothing but `joint` and the model is known.
        joint: all recordings together.
        profiles: residual torque over position, velocity, torque, time and frequency, all recordings together.
        regions: where it stands out of the noise, the most telling first.
        disagreements: recordings that show another plant than the model is of, or than the others.
        torque_constant: by which a current was turned into torque, if one was.
        data: that it was made of, all compared alike.
    """

    model: Model
    distances: tuple[Distance, ...]
    joint: Distance
    profiles: tuple[Profile, ...]
    regions: tuple[Region, ...]
    disagreements: tuple[Disagreement, ...] = ()
    torque_constant: TorqueConstant | None = None
    data: Preprocessed | None = field(default=None, compare=False, repr=False)

    @property
    def torque_unit(self) -> str:
        """`N m`, or that of a current that the model is of."""
        return self.model.torque_unit

    @property
    def caveat(self) -> str | None:
        """What is not counted in the error of free runs, in a sentence; None if all is."""
        share = self.joint.unstable
        if share == 0:
            return None
        told = f"in {percent(share)} of the one-second windows a small error grows tenfold, as with the arm upright"
        return f"{told}: they {'are all there are' if share == 1 else 'are not counted in free run'}"

    @property
    def headline(self) -> str:
        """The result in one sentence."""
        if self.joint.errors.shares:
            return worst(self.joint.errors)
        torque, position = self.joint.errors.torque_rms, self.joint.errors.position_rms
        times = torque / max(self.joint.noise_floor, 1e-300)
        return (
            f"the model is off by {torque:.3g} {self.torque_unit}, {times:.2g} times what noise leaves, and by "
            f"{position:.3g} rad in free run"
        )

    @property
    def told_in_loop(self) -> str | None:
        """Errors in the loop in a sentence; None where nobody knows the controller."""
        error = self.joint.errors
        told = f"simulated from its goals alone, the model is off by {error.in_loop:.3g} rad on average"
        return told if error.is_in_loop else None

    def __repr__(self) -> str:
        return f"<Comparison: {self.headline}>"

    def _repr_html_(self) -> str:
        return shown(self)

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        if (body := body_of(self.model.terms)) is not None:
            return {"schema": ARM_SCHEMA, "joints": of_joints(self.joint.errors, body)}
        data = {
            "schema": SCHEMA,
            "torque_constant": self.torque_constant.json() if self.torque_constant is not None else None,
            "model": self.model.json(),
            "recordings": [distance.json() for distance in self.distances],
            "joint": self.joint.json(),
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
            "regions": [region.json() for region in self.regions],
            "disagreements": [disagreement.json() for disagreement in self.disagreements],
        }
        return data | json_per({key: data[key] for key in ("profiles", "regions", "disagreements")}, self.torque_unit)


def distance(name: str, prepared: PreparedData, model: Model) -> Distance:
    """Errors of a model with inertia on prepared data, as they are, and in the loop if the recordings have drives."""
    steady = [growth(segments, model.terms, model.theta) < GROWS for segments in prepared.segments]
    kept = tuple(select(*pair) for pair in zip(prepared.segments, steady, strict=True) if pair[1].any())
    errors = (replace(prepared, segments=kept) if kept else prepared).errors(model)
    unstable = 1.0 - float(np.mean(np.concatenate(steady)))
    scatter = prepared.data.noise(abs(model.estimates["inertia"].value))
    errors = in_loop(model, prepared.recordings, errors)
    return Distance(name, errors, noise_floor(scatter, [errors]), unstable)


def joined(parts: Sequence[PreparedData]) -> PreparedData:
    """Prepared data of several recordings, with what is watched in each."""
    data = dataset([window for part in parts for window in part.data.windows])
    watched = {id: [x for part in parts for x in part.data.watched[id]] for id in parts[0].data.watched}
    return PreparedData(replace(data, watched=watched), tuple(segment for part in parts for segment in part.segments))


def compare(model: Model, recordings: Recordings) -> Comparison:
    """Compare a model with recordings, as it is: torque residual and free-running simulation.

    Where a current was logged, the model's own torque constant turns it into torque, or else their known loads do.
    Of an arm, the errors are those of the torque of each joint, clear of stick and reversals.

    Raises:
        IdentificationError: if one of the recordings holds too little motion, or a joint is never clear of stick.
        ModelError: if the model has no inertia, or is of a current and the recordings are not.
        TypeError: if something else is given than a model and recordings.
    """
    model = model_that_moves(model)
    recordings = chosen_recordings(recordings, body=body_of(model.terms))
    if body_of(model.terms) is not None:
        given, errors = Preprocessed(recordings), torque_errors(model, recordings)
        return Comparison(model, (), Distance("all", errors, np.nan), (), (), data=given)
    recordings = in_units_of(model, recordings).recordings
    parts = [_prepared(recording, model) for recording in recordings]
    together = joined(parts)
    joint, *distances = (
        distance(name, part, model)
        for name, part in zip(("all", *(recording.name for recording in recordings)), (together, *parts), strict=True)
    )
    left = together.samples, together.residual(model.terms, model.theta), joint.noise_floor
    fits = own_fits([together.data], model.terms)
    odd = (*disagreements_with(model, fits), *misfits(fits))
    return Comparison(
        model,
        tuple(distances),
        joint,
        tuple(profiles(*left)),
        tuple(stand_out(*left)),
        odd,
        recordings[0].torque_constant,
        Preprocessed(recordings, recordings).holding((together, together)),
    )


def torque_errors(model: Model, recordings: Sequence[Recording]) -> Errors:
    """Torque errors of a model of an arm on recordings, joint by joint: the paper's norm (10), clear of stick.

    Raises:
        IdentificationError: if a recording is too short, or a joint is never clear of stick.
    """
    segments = [measure_arm(recording) for recording in of_arms(recordings)]
    data = stack(segments, partial(regressions(model.terms), ARM_SCHEMES[0]))
    left = data.equations.y - data.equations.phi @ model.theta
    torque = np.concatenate([series(joints, "torque")[0].ravel() for own in segments for joints in own])
    body, errors, shares = body_of(model.terms), {}, {}
    for k, joint in enumerate(body.joints if body is not None else ()):
        own = data.usable & (data.joint == k)
        if not own.any():
            raise IdentificationError(
                f"{recordings[0].name}: joint '{joint}' is never clear of stick and reversals: its error cannot be told"
            )
        errors[joint], size = (float(np.sqrt(np.mean(values[own] ** 2))) for values in (left, torque))
        shares[joint] = errors[joint] / size if size else None
    return Errors(float(np.sqrt(np.mean(np.square(list(errors.values()))))), np.nan, joints=errors, shares=shares)


def step_of_arm(added: str | None, model: Model, **parts: Sequence[Recording]) -> Step:
    """A model of an arm with its torque errors on parts of the data, `train` and `holdout`; raises as they do."""
    return Step(added, model_of(model), {part: torque_errors(model, own) for part, own in parts.items()})


def worst(errors: Errors) -> str:
    """The joint of an arm whose torque a model has least, in a headline."""
    shares = {at: share or 0.0 for at, share in errors.shares.items()}
    most = max(shares, key=lambda at: shares[at])
    return f"The torque of {most} is {percent(shares[most])} off, the most of {len(shares)} joints"


def of_joints(errors: Errors, body: Body) -> list[JSON]:
    """Torque errors of an arm, joint by joint, as plain dictionaries for JSON."""
    return [
        {"joint": at, "torque_rms": error, "share": errors.shares[at], "unit": body.worded(at, NEWTON_METRE)}
        for at, error in errors.joints.items()
    ]


def _prepared(recording: Recording, model: Model) -> PreparedData:
    """Prepared data of a recording, with what turns the joint round there and is no friction of the model's."""
    prepared = PreparedData.of([recording])
    if has_link(model.terms):
        return prepared.watching(model)
    count, inertia = len(model.theta), abs(model.estimates["inertia"].value)
    covariance = model.assumed_covariance[:count, :count]
    return replace(prepared, data=prepared.data.with_impacts(model.terms, model.theta, covariance, inertia))


def in_units_of(model: Model, recordings: Sequence[Recording]) -> Preprocessed:
    """Recordings with the torque in the unit that a model has it in.

    Raises:
        IdentificationError: if a current is to be turned into torque, and nothing tells the torque constant.
        ModelError: if the model is of a current and the recordings are not.
    """
    unit, known, constant = unit_of(recordings), model.torque_constant, None
    if unit == model.torque_unit:
        return Preprocessed(tuple(recordings))
    if model.torque_unit != NEWTON_METRE:
        raise ModelError(f"the model is per {model.torque_unit}, and the recordings are in {unit}: read them alike")
    if known is not None and known.unit == f"{NEWTON_METRE}/{unit}":
        constant = TorqueConstant(known.value, known.std, unit)
    given = Preprocessed.of(recordings, constant=constant)
    if given.doubt is not None:
        raise IdentificationError(f"the model is in N m, but {given.doubt}")
    return given
