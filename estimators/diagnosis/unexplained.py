"""Unexplained residual of the final model in torque or motion: its regions and findings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimators.checks.remedies import find_reversed_torque
from estimators.data.fits import fit_within_laws
from estimators.data.regions import find_failures, find_regions_at
from estimators.diagnosis.contacts import is_misfit_between_contacts
from estimators.findings import Finding, Quantity
from estimators.selection.evidence import Evidence
from estimators.selection.process_noise import UnloggedTorque
from estimators.selection.search import SearchResult
from estimators.selection.tables import ExplainingTable
from estimators.signals.motion import SLOWEST
from estimators.signals.residual import Region, make_region_everywhere
from pendulum_env.physics import Term


@dataclass(frozen=True)
class ErrorNearReversals(Finding):
    """Position error of free-running simulation, without a residual where the joint moves freely."""

    error: Quantity


@dataclass(frozen=True)
class HeldOutResidual(Finding):
    """Residual of held-out recordings alone."""

    recordings: tuple[str, ...]


def check_torque_sign(evidence: Evidence) -> Finding | None:
    """Return a finding if the sign of the logged torque is reversed, by the base model within bounds of laws."""
    model = fit_within_laws(evidence.train, evidence.fits.base)
    return find_reversed_torque(model, evidence.train.recordings, evidence.criterion)


def find_unexplained(result: SearchResult) -> list[Region]:
    """Return the regions of the unexplained residual of the final model of a pendulum; empty if all is noise.

    The first cause in this order decides: a reversed sign of the torque (all time), a table that replaces effects,
    torque of fitted data, torque of held-out data, free-running motion near reversals without contacts.
    """
    evidence, last = result.evidence, result.steps[-1]
    if (reversal := check_torque_sign(evidence)) is not None:
        end = float(evidence.train.samples.time.max())
        return [Region("time", 0.0, end, 0.0, 0.0, is_profiled=False, cause=reversal)]
    train, holdout = evidence.fits.parts
    residual = train.with_link_states(last.model).residual(last.model.terms, last.model.theta)
    if result.table is not None:
        regions, cause = find_regions_at(train, residual), ExplainingTable.from_table(result.table)
        place = next((region for region in regions if region.axis == result.table.axis), None)
        if place is None:
            return [make_region_everywhere(cause, train.samples), *regions]
        return [replace(place, cause=cause), *(region for region in regions if region is not place)]
    if not evidence.residuals.is_noise_in(train, residual):
        return find_failures(train, residual, evidence.criterion)
    holdout_residual = evidence.residuals.holdout_residual(last.model.terms)
    if not evidence.residuals.is_noise_in(holdout, holdout_residual):
        floors = evidence.residuals.holdout_floors
        regions_held_out = find_failures(holdout, holdout_residual, evidence.criterion, floors=floors)
        return [replace(region, held_out_recordings=holdout.names) for region in regions_held_out]
    if (noise := evidence.residuals.find_process_noise(train, residual)) is not None:
        pairs = zip(evidence.train.segments, noise.data.windows, strict=True)
        segments = tuple(replace(segment, windows=w) for segment, w in pairs)
        noisier = replace(evidence.train, data=noise.data, segments=segments)
        evidence = evidence.with_fits(replace(evidence.fits, train=noisier))
    if not is_misfit_between_contacts(evidence, last):
        return []
    error, units = last.errors["train"].position_rms, last.model.units()
    reversals = ErrorNearReversals(Quantity(error, unit=units.unit("rad")))
    return [Region("velocity", -SLOWEST, SLOWEST, 0.0, 0.0, units.unit("rad/s"), is_profiled=False, cause=reversals)]


def find_noise_not_logged(result: SearchResult) -> list[UnloggedTorque]:
    """Return a finding if torque noise that is not logged explains the residual of the final model of a pendulum.

    Held-out data count if the fitted data leave only noise of the sensors.
    """
    evidence, model = result.evidence, result.steps[-1].model
    train, holdout = evidence.fits.parts
    residual = train.with_link_states(model).residual(model.terms, model.theta)
    noise = evidence.residuals.find_process_noise(train, residual) or evidence.residuals.find_process_noise(
        holdout, evidence.residuals.holdout_residual(model.terms)
    )
    return [] if noise is None else [noise.make_finding(model.units())]


def find_holdout_structure(evidence: Evidence, final: Sequence[Term]) -> HeldOutResidual | None:
    """Return a finding if the residual is noise in fitted data, but not in held-out data; else None."""
    is_there = evidence.residuals.is_noise_by_part(tuple(final)) == (True, False)
    return HeldOutResidual(evidence.holdout.names) if is_there else None
