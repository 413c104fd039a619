"""Regions of the residual (R,) of a model at a joint, where it exceeds the noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from estimators.data.regression_data import RegressionData
from estimators.data.settings import DATA
from estimators.decisions.criterion import Criterion
from estimators.findings import Finding, Quantity
from estimators.signals.residual import (
    SYMBOLS,
    Profile,
    Region,
    compute_profiles,
    find_regions,
    make_region_everywhere,
)
from estimators.weak_form.torque_windows import compute_negligible_residual
from pendulum_env._typing import Array
from pendulum_env.recording.channel import NEWTON_METRE


def compute_profiles_at(
    data: RegressionData,
    residual: Array,
    at: str = "",
    axes: Sequence[str] = tuple(SYMBOLS),
    floor: float | None = None,
) -> list[Profile]:
    """Return the profiles of a residual (R,) [N m] of all rows, at a joint.

    `floor` is the noise floor [N m], by default that of the data.
    """
    floor, negligible = data.floors[at] if floor is None else floor, compute_negligible_residual(data.data, at)
    of_joint = residual[data.locate_rows(at)]
    return compute_profiles(data.data.part(at).samples, of_joint, floor, axes, data.units(at), negligible)


def find_regions_at(
    data: RegressionData, residual: Array, at: str = "", most: int = DATA.regions, floor: float | None = None
) -> list[Region]:
    """Return the most significant `most` regions of the profiles of a residual (R,) [N m] at a joint."""
    return [replace(r, at=at) for r in find_regions(compute_profiles_at(data, residual, at, floor=floor))[:most]]


@dataclass(frozen=True)
class ResidualWithoutPlace(Finding):
    """Residual at no one speed, angle or time.

    Attributes:
        residual: torque; with controllers the mean position error of a simulation from the references.
        noise_ratio: its ratio to the noise floor, or to the noise of the encoder.
        worst: largest error of a recording; None for a single recording.
        recording: name of that recording; empty without a controller.
        share: position error over the range of the motion; None without a controller.
    """

    residual: Quantity
    noise_ratio: float
    worst: Quantity | None = None
    recording: str = ""
    share: float | None = None


def find_failures(
    data: RegressionData,
    residual: Array,
    criterion: Criterion,
    most: int = DATA.regions,
    floors: Mapping[str, float] | None = None,
) -> list[Region]:
    """Find where a residual (R,) [N m] exceeds the noise, joint by joint; at most `most` regions of each.

    A joint without a region, but an RMS above `criterion.misfit_ratio` noise floors, has one region of all velocities.
    `floors` are the noise floors of joints by name [N m], by default those of the data.
    """
    regions: list[Region] = []
    for joint, error in data.layout.compute_joint_errors(residual).items():
        floor = (floors or data.floors)[joint]
        at_joint = find_regions_at(data, residual, joint, most=most, floor=floor)
        least = criterion.misfit_ratio * max(floor, compute_negligible_residual(data.data, joint))
        if not at_joint and error > least:
            units, samples = data.units(joint), data.data.part(joint).samples
            cause = ResidualWithoutPlace(Quantity(error, unit=units.unit(NEWTON_METRE)), error / floor)
            at_joint = [make_region_everywhere(cause, samples, error, floor, joint, units)]
        regions += at_joint
    return regions
