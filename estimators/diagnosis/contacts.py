"""Contacts that no effect of a model explains: torque at rest or at a reversal that dry friction cannot hold."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.settings import DATA
from estimators.data.split import Parts, make_contact_finder
from estimators.decisions.errors import Step, Terms
from estimators.diagnosis.result import Candidate
from estimators.diagnosis.untested import UntestedRange
from estimators.findings import Finding, Quantity
from estimators.selection.evidence import Evidence
from estimators.selection.motion_score import is_misfit
from estimators.simulation.free_running import Segments, select_segments
from estimators.weak_form.contacts import bound_friction, compute_deviations, count_contacts
from estimators.weak_form.links import join_recording
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.torque_windows import join_windows
from estimators.weak_form.windows import Windows, mark_contacts
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Model, has_link, has_stop
from pendulum_env.units import JointUnits

Place = tuple[float, float, float, str]  # of a contact: size of its torque [N m], angle [rad], time [s], recording


@dataclass(frozen=True)
class Contact(Finding):
    """Contacts of a joint that no effect explains.

    Attributes:
        joint: joint of an arm; empty for a pendulum.
        count: number of contacts.
        torque, angle, time: unexplained torque of the largest, and its place.
        recording: name of its recording.
    """

    joint: str
    count: int
    torque: Quantity
    angle: Quantity
    time: Quantity
    recording: str


def find_contacts(evidence: Evidence, final: Terms, model: Model) -> list[Contact]:
    """Return a finding on contacts that a model without a stop leaves, with the place of the largest, or an empty list.

    A contact is a torque at a reversal or at rest that exceeds dry friction, see `ContactTest`. The
    list is empty if the model leaves structure where the joint moves.
    """
    has_contacts = has_stop(final) or count_contacts(evidence.train.data)
    if has_link(final) or has_contacts or not all(evidence.residuals.is_noise_by_part(final)):
        return []
    places, parts = list[Place](), _add_contacts(evidence, model)
    for part in parts:
        residual = part.residual(model.terms, model.theta) / part.data.scale
        is_contact = np.concatenate([mark_contacts(w) for w in part.data.windows])
        places += _list_places(part, residual, is_contact)
    return _make_findings(places, sum(count_contacts(part.data) for part in parts), model.units())


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
            places += _list_places(run, residual, is_contact)
            touching.append(replace(w, centers=w.centers[is_contact[rows]]))
        findings += _make_findings(
            places, count_contacts(join_windows(touching)) if places else 0, model.units(joint), joint
        )
    return findings


def is_misfit_between_contacts(evidence: Evidence, step: Step) -> bool:
    """Return whether a model of a pendulum is a misfit to free motion, see `FreeMotion.is_misfit`.

    Segments with contacts do not count, unless the model has a stop of known stiffness. A single contact may be an
    accident, and counts.
    """
    model = step.model
    stops = [model.estimates[term.columns[0].name] for term in model.terms if term.has_impacts]
    if (
        not evidence.motion.is_misfit(step)
        or has_link(model.terms)
        or any(not stiffness.is_unknown for stiffness in stops)
    ):
        return evidence.motion.is_misfit(step)
    parts = evidence.fits.parts if stops else _add_contacts(evidence, model)
    if sum(count_contacts(part.data) for part in parts) < DATA.repeated:
        return True
    pairs = zip(evidence.train.segments, parts[0].data.windows, strict=True)
    segments = tuple(select_segments(segment, _is_clear(segment, w)) for segment, w in pairs)
    clear_segments = tuple(segment for segment in segments if len(segment.first))
    return is_misfit(clear_segments, model, evidence.criterion)


def mark_met_stops(candidates: Sequence[Candidate], findings: Sequence[Finding]) -> tuple[Candidate, ...]:
    """Replace an untested range as the reason of candidates by contacts, at joints where findings have them."""
    met = {contact.joint: contact for contact in findings if isinstance(contact, Contact)}
    return tuple(
        replace(candidate, reason=met[at])
        if isinstance(candidate.reason, UntestedRange) and (at := candidate.effect.partition("@")[2]) in met
        else candidate
        for candidate in candidates
    )


def _add_contacts(evidence: Evidence, model: Model) -> Parts:
    """Return the parts of a pendulum's data with windows in contact, by the residual of a model."""
    add = make_contact_finder(evidence.fits.parts, model.terms)
    return add(evidence.train), add(evidence.holdout)


def _is_clear(segments: Segments, w: Windows) -> Mask:
    """Return whether each segment (B,) overlaps no window in contact."""
    contacts, m = w.centers[mark_contacts(w)], len(w.kernel) // 2
    first, last = segments.first[:, None] - m, segments.first[:, None] + len(segments.torque) + m
    return ~np.asarray(((contacts >= first) & (contacts <= last)).any(axis=1))


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


def _list_places(data: RegressionData, residual: Array, which: Mask) -> list[Place]:
    """Return the places of windows selected by `which` (R,); `residual` (R,) is their unexplained torque."""
    x, names = data.samples, [w.recording.name for w in data.data.windows for _ in w.centers]
    return [(float(abs(residual[k])), float(x.position[k]), float(x.time[k]), names[k]) for k in np.flatnonzero(which)]


def _make_findings(places: Sequence[Place], count: int, units: JointUnits, at: str = "") -> list[Contact]:
    """Return a finding on contacts of a joint with the place of the largest; empty for none."""
    if not places:
        return []
    torque, angle, time, name = max(places)
    unexplained, place = Quantity(torque, unit=units.unit("N m")), Quantity(angle, unit=units.unit("rad"))
    return [Contact(at, count, unexplained, place, Quantity(time, unit="s"), name)]
