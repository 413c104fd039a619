"""Completeness of an identified model: its residual, and the agreement of the schemes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.decisions.criterion import Criterion, is_noise
from estimators.findings import Finding
from estimators.schemes.fitting import Identified
from estimators.selection.process_noise import find_process_noise
from estimators.weak_form.torque_windows import compute_negligible_residual
from pendulum_env.physics import Term


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
    def is_biasing(self) -> bool:
        """Return True: a missing effect shifts all estimates."""
        return True


def find_incompleteness(
    results: Sequence[Identified], regression_data: RegressionData, terms: Sequence[Term], criterion: Criterion
) -> list[Finding]:
    """Test whether the terms explain the recordings, by the residual and the agreement of the schemes.

    A residual above `agreement.unexplained` noise floors, of an arm a correlated residual (`is_noise`), or a
    difference of two schemes above `z_score` standard errors gives a finding. Torque noise of a pendulum that is not
    logged is a finding of its own.
    """
    layout = regression_data.layout
    residual, inertias, ratios = regression_data.residual(terms), regression_data.inertias(terms), dict[str, float]()
    findings, data, units = list[Finding](), regression_data.data, results[0].model.units()
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
    gaps = sorted(_compute_scheme_differences(results, criterion.agreement.scheme_difference))
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
