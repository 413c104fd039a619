"""Result of a comparison, and common parts of the JSON of all results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from estimators.checks.homogeneity import Disagreement
from estimators.data.fit_data import FitData
from estimators.decisions.errors import Errors, get_single
from estimators.findings import Finding
from estimators.prediction import Prediction, predict_recordings
from estimators.signals.residual import AXES, Profile, Region
from estimators.simulation.free_running import HORIZON
from pendulum_env._typing import JSON
from pendulum_env.notebook import Summarised
from pendulum_env.physics import Model
from pendulum_env.recording import TorqueConstant

SCHEMA = "pendulum-ident/comparison@3"


@dataclass(frozen=True)
class RecordingErrors:
    """Errors of a model on one or all recordings.

    Attributes:
        name: name of the recording.
        errors: errors in torque and in free-running position.
        floors: torque error by measurement noise alone at each joint [N m].
        unstable: share of free runs in which a small error grows tenfold, as near the upright; the error of position
            leaves them out unless all are unstable.
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
class Comparison(Summarised):
    """Comparison of a model with recordings.

    Attributes:
        model: the compared model.
        recording_errors: errors on each recording; empty with links.
        joint: errors on all recordings together.
        profiles: residual torque over position, velocity, torque, time and frequency, all recordings together; empty
            with links.
        regions: regions with a residual above the noise, the most significant first; with links, joint by joint.
        findings: on data and model.
        torque_constant: ratio of torque and current, if a current was converted.
        data: the compared recordings.
        horizon: length of free runs [s]; None with links.
    """

    model: Model
    recording_errors: tuple[RecordingErrors, ...]
    joint: RecordingErrors
    profiles: tuple[Profile, ...]
    regions: tuple[Region, ...]
    findings: tuple[Finding, ...] = ()
    torque_constant: TorqueConstant | None = None
    data: FitData | None = field(default=None, compare=False, repr=False)
    horizon: float | None = HORIZON

    @property
    def errors(self) -> Errors:
        """Return the errors on all recordings together."""
        return self.joint.errors

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Recordings of another plant than the model or the other recordings."""
        return tuple(finding for finding in self.findings if isinstance(finding, Disagreement))

    @cached_property
    def recordings(self) -> tuple[Prediction, ...]:
        """Return each recording with the predictions of the model, sample by sample."""
        return predict_recordings(self.model, self.data)

    @property
    def torque_unit(self) -> str:
        """Return the unit of torque of the model, `N m` or the unit of a current."""
        return self.model.torque_unit

    @property
    def is_torque_logged(self) -> bool:
        """Return whether a recording has measured torque instead of the command of a controller."""
        return self.data is None or any(recording.has_logged_torque for recording in self.data.recordings)

    def json(self) -> JSON:
        """Return a dictionary for JSON; `joint` has all recordings together."""
        return make_result_json(self.model, self.torque_constant, self.regions) | {
            "schema": SCHEMA,
            "findings": [finding.json() for finding in self.findings],
            "recordings": [distance.json() for distance in self.recording_errors],
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


def make_result_json(model: Model, constant: TorqueConstant | None, regions: Sequence[Region]) -> JSON:
    """Return the common entries of the files of `compare` and `diagnose`, as a dictionary for JSON."""
    return make_model_json(model) | {
        "torque_constant": constant.json() if constant is not None else None,
        "regions": [region.json() for region in regions],
    }


def make_model_json(model: Model) -> JSON:
    """Return a model and its units as a dictionary for JSON."""
    joint_units = {at: model.units(at) for at in model.mechanism.joints}
    return {
        "torque_unit": model.torque_unit,
        "units": {
            at: {name: units.unit(AXES[name]) for name in ("position", "torque")} for at, units in joint_units.items()
        },
        "model": model.json(),
    }


def make_floors_json(floors: Mapping[str, float]) -> JSON:
    """Return noise floors as a dictionary for JSON; the common floor of several joints is null."""
    return {"torque_rms": get_single(floors) if len(floors) == 1 else None, "joints": dict(floors)}
