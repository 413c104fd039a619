"""Regions of the residual (R,) of a model at a joint, where it exceeds the noise."""

from collections.abc import Sequence
from dataclasses import replace

from estimators.checks.homogeneity import AGREEMENT
from estimators.data.regression_data import RegressionData
from estimators.findings import Finding, Kind, Quantity
from estimators.signals.residual import SYMBOLS, Region, find_regions, make_region_everywhere
from pendulum_env._typing import Array
from pendulum_env.recording.channel import NEWTON_METRE

MOST = 6  # regions of a residual


def find_regions_at(
    data: RegressionData, residual: Array, at: str, axes: Sequence[str] = tuple(SYMBOLS), most: int = MOST
) -> list[Region]:
    """Return the regions of a residual [N m] at a joint, the most significant first."""
    own, least = residual[data.locate_rows(at)], data.data.negligible(at)
    found = find_regions(data.data.part(at).samples, own, data.floors[at], axes, most, data.units(at))
    return [replace(region, at=at) for region in found if abs(region.residual) > least]


def find_failures(data: RegressionData, residual: Array, most: int = MOST) -> tuple[Region, ...]:
    """Return the regions of a residual (R,) [N m], joint by joint; everywhere if it is large at no single place."""
    regions: list[Region] = []
    for at, error in data.joint_errors(residual).items():
        found, floor = find_regions_at(data, residual, at, most=most), data.floors[at]
        if not found and error > AGREEMENT.misfits * max(floor, data.data.negligible(at)):
            found = [make_scattered_region(data, error, floor, at)]
        regions += found
    return tuple(regions)


def make_scattered_region(data: RegressionData, error: float, floor: float, at: str = "") -> Region:
    """Return the region of a residual of some size [N m] that exceeds the noise at no single place."""
    units = data.units(at)
    residual = Quantity(error, unit=units.unit(NEWTON_METRE))
    cause = Finding(Kind.NOWHERE, {"residual": residual, "times": Quantity(error / floor)})
    return make_region_everywhere(cause, data.data.part(at).samples, error, floor, at, units)
