"""Comparison: how far a model is from recordings, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimators.agreement import Disagreement, disagreements_with, misfits
from estimators.dataset import dataset
from estimators.evidence import Errors, Evidence
from estimators.inputs import Recordings, chosen_recordings, model_that_moves
from estimators.regions import Profile, Region, profiles, stand_out
from pendulum_env._typing import JSON
from pendulum_env.physics import Model

SCHEMA = "pendulum-ident/comparison@1"


@dataclass(frozen=True)
class Distance:
    """Errors of a model on one recording, or on all.

    Attributes:
        name: of the recording.
        errors: in torque and in free-running position.
        noise_floor: torque error that measurement noise alone gives [N m].
    """

    name: str
    errors: Errors
    noise_floor: float

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {"name": self.name, "errors": self.errors.json(), "noise_floor": {"torque_rms": self.noise_floor}}


@dataclass(frozen=True, repr=False)
class Comparison:
    """A model against recordings.

    Attributes:
        model: as it came; nothing is fitted.
        distances: one a recording.
        joint: all recordings together.
        profiles: residual torque over position, velocity, torque, time and frequency, all recordings together.
        regions: where it stands out of the noise, the most telling first.
        disagreements: recordings that show another plant than the model is of, or than the others.
    """

    model: Model
    distances: tuple[Distance, ...]
    joint: Distance
    profiles: tuple[Profile, ...]
    regions: tuple[Region, ...]
    disagreements: tuple[Disagreement, ...] = ()

    @property
    def headline(self) -> str:
        """The result in one sentence."""
        torque, position = self.joint.errors.torque_rms, self.joint.errors.position_rms
        times = torque / max(self.joint.noise_floor, 1e-300)
        return (
            f"the model is off by {torque:.3g} N m, {times:.2g} times what noise leaves, and by {position:.3g} rad in "
            "free run"
        )

    def __repr__(self) -> str:
        return f"<Comparison: {self.headline}>"

    def _repr_html_(self) -> str:
        from estimators.notebook import show_comparison  # only a notebook asks for it

        return show_comparison(self)

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "schema": SCHEMA,
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


def distance(name: str, evidence: Evidence, model: Model) -> Distance:
    """Errors of a model with inertia on a body of evidence, as it is."""
    return Distance(name, evidence.errors(model), evidence.data.noise(abs(model.estimates["inertia"].value)))


def joined(parts: Sequence[Evidence]) -> Evidence:
    """Evidence of several recordings, with what is watched in each."""
    data = dataset([window for part in parts for window in part.data.windows])
    watched = {id: [x for part in parts for x in part.data.watched[id]] for id in parts[0].data.watched}
    return Evidence(replace(data, watched=watched), tuple(flight for part in parts for flight in part.flights))


def compare(model: Model, recordings: Recordings) -> Comparison:
    """Compare a model with recordings, as it is: torque residual and free-running simulation.

    Raises:
        IdentificationError: if one of the recordings holds too little motion.
        ModelError: if the model has no inertia.
        TypeError: if something else is given than a model and recordings.
    """
    model, recordings = model_that_moves(model), chosen_recordings(recordings)
    parts = [Evidence.of([recording]).watching(model) for recording in recordings]
    together = joined(parts)
    joint = distance("all", together, model)
    maps = profiles(together.samples, together.residual(model.terms, model.theta), joint.noise_floor)
    distances = [distance(recording.name, part, model) for recording, part in zip(recordings, parts, strict=True)]
    odd = (*disagreements_with(model, together.data), *misfits(together.data, model.terms))
    return Comparison(model, tuple(distances), joint, tuple(maps), tuple(stand_out(maps)), odd)
