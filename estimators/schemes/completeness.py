"""Checks of identified models: columns that were read wrongly, recordings that disagree, and missing effects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from estimators.checks.closed_loop import find_feedback
from estimators.checks.homogeneity import RecordingFit, find_disagreements, find_misfits, fit_each_recording
from estimators.checks.remedies import find_uneven_clocks, find_wrong_columns
from estimators.checks.signs import find_driving_friction
from estimators.data.fit_data import FitData
from estimators.data.fits import find_inertia_of_noise
from estimators.data.regression_data import RegressionData
from estimators.decisions.criterion import Criterion, is_noise
from estimators.findings import Finding, bias_everything
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.fitting import Identified
from estimators.selection.process_noise import find_process_noise
from estimators.weak_form.preparation import prepare_windows
from estimators.weak_form.torque_windows import TorqueWindows, compute_negligible_residual
from pendulum_env.arms.body import Body
from pendulum_env.physics import Model, Term

Results = dict[str, Identified]


@dataclass(frozen=True)
class Incomplete(Finding):
    """Model that does not explain the recordings.

    Attributes:
        noise_ratio: largest ratio of residual and noise floor; None if the residual is noise.
        disagreement: largest difference of two schemes [standard errors]; None if they agree.
        parameters: names of the parameters on which the schemes disagree.
        joints: names of the joints of an arm with a residual.
    """

    noise_ratio: float | None = None
    disagreement: float | None = None
    parameters: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()

    @property
    def is_bias(self) -> bool:
        """Return True: a missing effect shifts all estimates."""
        return True


def check_results(
    first: Model, results: Results, fit_data: FitData, terms: Sequence[Term]
) -> tuple[TorqueWindows | None, list[Finding], Results]:
    """Check columns, then agreement of recordings, then the model, then feedback; of an arm the model alone.

    Limits are those of the data.

    Args:
        first: model of the first scheme, in the unit of the recorded torque.
        results: result of each scheme by its id.
        fit_data: recordings of the fit.
        terms: terms of the model.

    Returns:
        Windows, None for an arm or too little motion; findings; results, marked as biased by a finding.
    """
    if isinstance(terms[0].mechanism, Body):
        findings: list[Finding] = [*find_driving_friction(next(iter(results.values())).model)]
        with suppress(IdentificationError):
            data = RegressionData.from_arm(fit_data.recordings, terms)
            findings = [*findings, *_check_completeness(results, data, terms, fit_data.criterion)]
        return None, findings, _mark_biased(results, findings)
    recordings, criterion, windows = fit_data.recordings, fit_data.criterion, None
    findings = find_wrong_columns(first, recordings, criterion) or [*find_driving_friction(first)]
    with suppress(IdentificationError):  # windows need more motion than some schemes
        windows = prepare_windows(recordings, inertia=fit_data.cut.inertia)
        if (inertia := find_inertia_of_noise(RegressionData(windows), terms, criterion)) is not None:
            windows = prepare_windows(recordings, inertia=inertia.value)
        findings = [*findings, *_check_recordings(fit_data, fit_each_recording([windows], terms, criterion), terms)]
        if not findings:
            findings = _check_completeness(results, RegressionData(windows), terms, criterion)
            findings += [*find_uneven_clocks(recordings)] if findings else []
    return windows, [*findings, *find_feedback(recordings, criterion)], _mark_biased(results, findings)


def _mark_biased(results: Results, findings: Sequence[Finding]) -> Results:
    """Return the results marked as biased if a finding shifts all estimates, else the same results."""
    if not bias_everything(findings):
        return results
    return {id: replace(result, model=result.model.mark_biased()) for id, result in results.items()}


def _check_recordings(data: FitData, fits: Sequence[RecordingFit], terms: Sequence[Term]) -> list[Finding]:
    """Check the timing of the torque, the agreement of the recordings, and their residuals.

    A late action of torque is no finding if the model has a dead time or a lag.
    """
    timing = data.with_timing().timing
    return [
        *timing.find(is_late=True),
        *(timing.find(is_late=False) if not any(term.delays_torque for term in terms) else ()),
        *find_disagreements(fits, only_if_all_fit=True),
        *find_misfits(fits),
    ]


def _check_completeness(
    results: Results, regression_data: RegressionData, terms: Sequence[Term], criterion: Criterion
) -> list[Finding]:
    """Test whether the terms explain the recordings, by the residual and the agreement of the schemes.

    A residual above `agreement.unexplained` noise floors, of an arm a correlated residual (`is_noise`), or a
    difference of two schemes above `z_score` standard errors gives a finding. Torque noise of a pendulum that is not
    logged is a finding of its own.
    """
    layout = regression_data.layout
    residual, inertias, ratios = regression_data.residual(terms), regression_data.inertias(terms), dict[str, float]()
    findings, data, units = list[Finding](), regression_data.data, next(iter(results.values())).model.units()
    for at, floor in regression_data.floors.items():
        structure = layout.structure(at, residual[regression_data.locate_rows(at)], inertias[at])
        negligible = compute_negligible_residual(data, at)  # zero of a pendulum
        is_correlated = bool(negligible) and not is_noise(structure, max(floor, negligible), criterion)
        if is_correlated or structure.rms > criterion.agreement.unexplained * max(floor, negligible):
            noise = None if negligible else find_process_noise(data, residual, inertias[at], criterion.white)
            if noise is None:
                ratios[at] = structure.rms / max(floor, 1e-300)
            else:
                findings.append(noise.make_finding(units))
    gaps = sorted(_compute_scheme_differences(list(results.values()), criterion.agreement.scheme_difference))
    disagreements = {name: gap for gap, name in gaps if gap > criterion.z_score}  # largest gap of each name
    joints, names = (
        tuple(sorted(filter(None, sizes), key=lambda name: -sizes[name])) for sizes in (ratios, disagreements)
    )
    if not (ratios or disagreements):
        return findings
    largest_ratio, largest_gap = (max(sizes.values(), default=None) for sizes in (ratios, disagreements))
    return [*findings, Incomplete(largest_ratio, largest_gap, names, joints)]


def _compute_scheme_differences(results: Sequence[Identified], least: float) -> Iterator[tuple[float, str]]:
    """Yield differences of two schemes in a parameter [standard errors], with its name.

    Differences below the share `least` of the parameter are left out.
    """
    for result, other in combinations(results, 2):
        for name in result.model.estimates.keys() - result.withheld - other.withheld:
            first, second = (scheme.model.estimates[name] for scheme in (result, other))
            gap = abs(first.value - second.value)
            if first.std > 0 and second.std > 0 and gap > least * max(abs(first.value), abs(second.value)):
                yield gap / float(np.hypot(first.std, second.std)), name
