"""Payloads that only some recordings of an arm show, as a treatment of its recordings."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial

from estimators.data.fit_data import FitData
from estimators.data.treatment import DataChange
from estimators.diagnosis.case import Trial
from estimators.findings import Change, Finding, Quantity
from pendulum_env.recording import NEWTON_METRE, Recording
from robots.arms.body import Body, find_body
from robots.arms.payload import Payload, detect_payloads
from robots.arms.recording import add_payload


@dataclass(frozen=True)
class CarriedPayload(DataChange, Finding):
    """Payload of an arm that some recordings show.

    Attributes:
        joint: joint before the link that carries it.
        mass: its mass.
        center: its centre in the frame of the joint, by axis.
        torque_rms: torque error of joints without and with it.
        recordings: names of the recordings.
    """

    joint: str
    mass: Quantity
    center: Mapping[str, Quantity]
    torque_rms: Mapping[str, Change]
    recordings: tuple[str, ...]

    @property
    def n_assumptions(self) -> int:
        """Return 1."""
        return 1

    @property
    def has_new_inputs(self) -> bool:
        """Return True: recordings have other loads with it."""
        return True


def include_payload(trial: Trial) -> FitData | None:
    """Return data with payloads that only some recordings of an arm show; None without any, or if all is explained."""
    data = trial.data
    if not trial.unexplained or len(data.recordings) + len(data.holdout) < 2:
        return None
    parts = [part.data for part in (data.parts if data.holdout else data.parts[:1])]
    for payload, numbers in detect_payloads(parts, trial.result.terms):
        names = tuple(data.all_recordings[k].name for k in numbers)
        finding = make_payload_finding(payload, find_body(trial.options.base), names)
        data = change_recordings(data, partial(add_payload, load=payload.load), numbers).with_treatment(finding)
    return None if data is trial.data else data


def change_recordings(data: FitData, change: Callable[[Recording], Recording], numbers: Collection[int]) -> FitData:
    """Return data, also untimed, with some recordings changed, numbered from 0, fitted ones first."""
    changed, logged = (
        tuple(change(recording) if k in numbers else recording for k, recording in enumerate(recordings))
        for recordings in (data.all_recordings, data.timing.logged)
    )
    count, timing = len(data.recordings), replace(data.timing, logged=logged)
    return replace(data, recordings=changed[:count], holdout=changed[count:], timing=timing)


def make_payload_finding(payload: Payload, body: Body, names: tuple[str, ...]) -> CarriedPayload:
    """Return the finding on a payload in recordings: mass, centre, and torque RMS of joints without and with it."""
    estimates = {"mass": payload.estimates["m"], **payload.center}
    sizes = {name: Quantity(estimate.value, estimate.std, estimate.unit) for name, estimate in estimates.items()}
    units = {at: body.units(at).unit(NEWTON_METRE) for at in payload.torque_rms}
    errors = {
        at: Change(Quantity(before, unit=units[at]), Quantity(after, unit=units[at]))
        for at, (before, after) in payload.torque_rms.items()
    }
    return CarriedPayload(payload.joint, sizes.pop("mass"), sizes, errors, names)
