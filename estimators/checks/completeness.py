"""Checks of identified models: columns that were read wrongly, recordings that disagree, and missing effects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np

from estimators.checks.closed_loop import find_feedback
from estimators.checks.homogeneity import AGREEMENT, Own, find_disagreements, find_misfits, fit_each_recording
from estimators.checks.remedies import find_wrong_columns
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.findings import Finding, Kind, Quantity
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.fitting import Identified
from estimators.selection.physical import find_driving_friction
from estimators.weak_form.torque_windows import TorqueWindows, prepare
from pendulum_env.arms.body import Body
from pendulum_env.physics import Model, Term

DISAGREEMENT = 5.0  # standard errors between two schemes, which noise alone does not reach: 2.3 is the most seen,
COARSE = 0.05  # and share of a parameter, which slow sampling does not reach: 0.034 at 50 Hz

Results = dict[str, Identified]


def check_results(
    first: Model, results: Results, given: FitData, terms: Sequence[Term]
) -> tuple[TorqueWindows | None, list[Finding], Results]:
    """Check columns, then agreement of recordings, then the model, then feedback; of an arm the model alone.

    `first` is the model of the first scheme, in the unit of the recorded torque. Windows are None of an arm, and if
    there are too few; results are returned with estimates marked that a missing effect biases.
    """
    if isinstance(terms[0].mechanism, Body):
        found = find_driving_friction(next(iter(results.values())).model)
        with suppress(IdentificationError):
            missing, results = _check_completeness(results, RegressionData.from_arm(given.recordings, terms), terms)
            found = [*found, *missing]
        return None, found, results
    data, found = None, find_wrong_columns(first, given.recordings) or find_driving_friction(first)
    with suppress(IdentificationError):  # windows need more motion than some schemes
        data = prepare(given.recordings)
        found = [*found, *_check_recordings(given, fit_each_recording([data], terms), terms)]
        if not found:
            found, results = _check_completeness(results, RegressionData(data), terms)
    return data, [*found, *find_feedback(given.recordings)], results


def _check_recordings(given: FitData, fits: Sequence[Own], terms: Sequence[Term]) -> list[Finding]:
    """Check the recordings: timing of torque, agreement."""
    timed = given.with_timing()
    return [
        *timed.find_timing(True),
        *(timed.find_timing(False) if not {"dead_time", "actuator_lag"} & {term.id for term in terms} else ()),
        *(one.finding for one in find_disagreements(fits, only_if_all_fit=True)),
        *(one.finding for one in find_misfits(fits)),
    ]


def _check_completeness(
    results: Results, prepared: RegressionData, terms: Sequence[Term]
) -> tuple[list[Finding], Results]:
    """Test whether the terms explain the recordings: by the residual, and by the agreement of the schemes.

    Schemes share the noise, so that their estimates differ by less than independent ones. A missing effect biases each
    of them differently.
    Estimates on which the schemes disagree are marked in the results; of a single scheme, all estimates.
    """
    data, floors = prepared.data, prepared.floors
    left = prepared.joint_errors(prepared.residual(terms))
    least = {at: AGREEMENT.misfits * max(floors[at], data.negligible(at)) for at in left}
    times = {at: error / max(floors[at], 1e-300) for at, error in left.items() if error > least[at]}
    gaps = sorted(_compute_scheme_differences(list(results.values())))
    disputed = {name: gap for gap, name in gaps if gap > DISAGREEMENT}  # of each name the largest
    numbers = {"residual": Quantity(max(times.values()))} if times else {}
    numbers |= {"disagreement": Quantity(max(disputed.values()))} if disputed else {}
    joints, names = (tuple(sorted(filter(None, own), key=lambda one: -own[one])) for own in (times, disputed))
    if not numbers:
        return [], results
    marked = {
        id: replace(own, model=own.model.mark_biased(disputed if len(results) > 1 else None))
        for id, own in results.items()
    }
    return [Finding(Kind.INCOMPLETE, numbers, names, joints=joints)], marked


def _compute_scheme_differences(results: Sequence[Identified]) -> Iterator[tuple[float, str]]:
    """Yield the difference of each two schemes in each parameter, in standard errors, with its name."""
    for one, other in combinations(results, 2):
        for name in one.model.estimates.keys() - one.withheld - other.withheld:
            first, second = (own.model.estimates[name] for own in (one, other))
            gap = abs(first.value - second.value)
            if first.std > 0 and second.std > 0 and gap > COARSE * max(abs(first.value), abs(second.value)):
                yield gap / float(np.hypot(first.std, second.std)), name
