"""Contacts of joints of an arm: torque at rest at an end of the range, beyond dry friction."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.diagnosis.contacts import Contact, Place, list_places, make_contact_findings
from estimators.selection.evidence import Evidence
from estimators.weak_form.contacts import bound_friction, compute_deviations, count_contacts
from estimators.weak_form.links import join_recording
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.torque_windows import join_windows
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array
from pendulum_env.physics import Model


def find_arm_contacts(evidence: Evidence, model: Model, joints: Iterable[str]) -> list[Contact]:
    """Return a finding on each of some joints of an arm that rests at an end of its range beyond dry friction.

    The torque of a joint at rest, less that of the model, exceeds twice its dry friction and noise, and presses
    outwards, beyond all angles at which the joint moves freely.
    """
    findings, runs = list[Contact](), [run for part in evidence.fits.parts for run in _split_with_rests(part, model)]
    measured = [(run, *_measure_residual(run, model)) for run in runs]
    for joint in joints:
        low, high, places, touching = np.inf, -np.inf, list[Place](), list[Windows]()
        for run, residual, limit in measured:
            rows, (w,) = run.locate_rows(joint), (windows for windows in run.data.windows if windows.at == joint)
            angle = run.samples.position[rows]
            is_free = ~np.isin(w.centers, w.stick.resting) & (np.abs(residual) <= limit)[rows]
            low, high = min(low, angle[is_free].min(initial=np.inf)), max(high, angle[is_free].max(initial=-np.inf))
        for run, residual, limit in measured:
            rows, (w,) = run.locate_rows(joint), (windows for windows in run.data.windows if windows.at == joint)
            angle, is_contact = run.samples.position[rows], np.zeros(len(residual), dtype=bool)
            is_outwards = np.where(residual[rows] > 0, angle > high, angle < low)
            is_contact[rows] = np.isin(w.centers, w.stick.resting) & is_outwards & (np.abs(residual) > limit)[rows]
            places += list_places(run, residual, is_contact)
            touching.append(replace(w, centers=w.centers[is_contact[rows]]))
        findings += make_contact_findings(
            places, count_contacts(join_windows(touching)) if places else 0, model.units(joint), joint
        )
    return findings


def _split_with_rests(part: RegressionData, model: Model) -> list[RegressionData]:
    """Return the windows of each recording of an arm, clear of stick or at rest; without those that lack a joint."""
    runs = dict.fromkeys(w.run for w in part.data.windows)
    with_rests = [replace(w, centers=np.union1d(w.centers, w.stick.resting), scale=None) for w in part.data.windows]
    entries = ([w for w in with_rests if w.run == run] for run in runs)
    return [
        RegressionData(join_recording(joints, model.terms), base=part.base)
        for joints in entries
        if all(len(w.centers) for w in joints)
    ]


def _measure_residual(data: RegressionData, model: Model) -> tuple[Array, Array]:
    """Return the residual of each window of an arm, and the limit of dry friction and noise, (R,) each [N m]."""
    terms, theta, windows = model.terms, model.theta, data.data.windows
    covariance = model.assumed_covariance[: len(theta), : len(theta)]
    deviations = compute_deviations(data.equations(terms).slopes(theta), covariance)
    inertias, limits = data.inertias(data.base), list[Array]()
    owner = np.array([term.at for term in terms for _ in term.columns])
    for w in windows:
        in_joint = owner == w.at
        at_joint = [term for term in terms if term.at == w.at]
        friction = bound_friction(w, at_joint, theta[in_joint], covariance[np.ix_(in_joint, in_joint)])
        limits.append(2 * friction + RESOLUTION.significant * w.noise.compute_std(inertias[w.at]))
    return data.residual(terms, theta), np.concatenate(limits) + RESOLUTION.significant * deviations
