"""Conclusion of the diagnosis of an arm: the residual of each joint, tables that explain it, and the next step."""

from dataclasses import dataclass, replace

from estimators.data.regions import find_regions_at
from estimators.decisions.criterion import is_noise
from estimators.decisions.errors import Terms
from estimators.diagnosis.case import Trial
from estimators.diagnosis.conclusion import NoKnownEffect
from estimators.diagnosis.ranking import Tie
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.unexplained import HeldOutResidual
from estimators.findings import Finding
from estimators.selection.evidence import Evidence
from estimators.selection.tables import find_explaining_law
from estimators.signals.residual import Region, make_region_everywhere
from estimators.weak_form.torque_windows import compute_negligible_residual


@dataclass(frozen=True)
class MissingRotors(Finding):
    """Joints whose motor inertia the robot file lacks."""

    joints: tuple[str, ...]


def conclude_arm(trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
    """Return the diagnosis of an arm with the residual of each joint, tables that explain it, and the next step."""
    evidence, terms = trial.evidence, trial.terms
    residuals, regions = find_joint_residuals(evidence, terms)
    joints = [region.at for region in regions if not region.held_out_recordings]
    tables_at_joints = ([table for table in evidence.tables if table.at == joint] for joint in joints)
    tables = tuple(id for kinds in tables_at_joints if (id := find_explaining_law(evidence, terms, kinds)) is not None)
    no_experiment: Finding | None = NoKnownEffect(tables) if residuals else None
    if residuals and not joints:
        no_experiment = HeldOutResidual(evidence.holdout.names)
    elif diagnosis.ambiguous:
        no_experiment = Tie(diagnosis.ambiguous[0])
    return replace(diagnosis, no_experiment=no_experiment, tables=tables, joint_residuals=residuals)


def find_joint_residuals(evidence: Evidence, terms: Terms) -> tuple[dict[str, float], list[Region]]:
    """Return the residual of each joint that is not noise [N m], and one region for each, the most significant.

    The residual is its correlated part if that is significant, else its RMS. Held-out data count at a joint if its
    fitted data leave only noise.
    """
    sizes, regions, criterion = dict[str, float](), list[Region](), evidence.criterion
    residuals = evidence.train.residual(terms), evidence.residuals.holdout_residual(terms)
    parts = zip(evidence.fits.parts, residuals, ((), evidence.holdout.names), strict=True)
    for (part, residual, names), structures in zip(parts, evidence.residuals.structures(terms), strict=True):
        for joint, structure in structures.items():
            floor = max(evidence.residuals.noise_floor(part, joint), compute_negligible_residual(part.data, joint))
            if joint not in sizes and not is_noise(structure, floor, criterion):
                sizes[joint] = structure.correlated_rms if structure.z_score > criterion.z_score else structure.rms
                places = find_regions_at(part, residual, joint, most=1)
                region = places[0] if places else make_region_everywhere(at=joint, units=part.units(joint))
                regions.append(replace(region, held_out_recordings=names))
    return sizes, regions
