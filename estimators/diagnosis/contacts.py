"""Contacts that no effect of a model explains: torque at rest or at a reversal that dry friction cannot hold."""

from collections.abc import Sequence
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
from estimators.weak_form.contacts import count_contacts
from estimators.weak_form.windows import Windows, mark_contacts
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Model, has_link, has_stop
from pendulum_env.units import JointUnits

Place = tuple[float, float, float, str]  # of a contact: size of its torque [N m], angle [rad], time [s], recording


@dataclass(frozen=True)
class Contact(Finding):
    """Contacts of a joint that no effect explains.

    Attributes:
        joint: name of the joint; empty for a pendulum.
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
        places += list_places(part, residual, is_contact)
    return make_contact_findings(places, sum(count_contacts(part.data) for part in parts), model.units())


def is_misfit_between_contacts(evidence: Evidence, step: Step) -> bool:
    """Return whether a model of a pendulum is a misfit to free motion, see `FreeMotion.is_misfit`.

    Segments with contacts or at their angles do not count, unless the model has a stop of known stiffness: dry friction
    hides the force of a stop at rest. A single contact may be an accident, and counts.
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
    """Return whether each segment (B,) overlaps no window in contact, and reaches no angle of one."""
    contacts, m = w.centers[mark_contacts(w)], len(w.kernel) // 2
    first, last = segments.first[:, None] - m, segments.first[:, None] + len(segments.torque) + m
    low, high, angles = segments.position.min(axis=0), segments.position.max(axis=0), w.samples.position[contacts]
    overlaps = (contacts >= first) & (contacts <= last)
    reaches = (angles >= low[:, None]) & (angles <= high[:, None])
    return ~np.asarray((overlaps | reaches).any(axis=1))


def list_places(data: RegressionData, residual: Array, which: Mask) -> list[Place]:
    """Return the places of windows selected by `which` (R,); `residual` (R,) is their unexplained torque."""
    x, names = data.samples, [w.recording.name for w in data.data.windows for _ in w.centers]
    return [(float(abs(residual[k])), float(x.position[k]), float(x.time[k]), names[k]) for k in np.flatnonzero(which)]


def make_contact_findings(places: Sequence[Place], count: int, units: JointUnits, at: str = "") -> list[Contact]:
    """Return a finding on contacts of a joint with the place of the largest; empty for none."""
    if not places:
        return []
    torque, angle, time, name = max(places)
    unexplained, place = Quantity(torque, unit=units.unit("N m")), Quantity(angle, unit=units.unit("rad"))
    return [Contact(at, count, unexplained, place, Quantity(time, unit="s"), name)]
