"""Completeness of an identified model: its residual, and the agreement of the schemes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.decisions.criterion import Criterion, is_noise
from estimators.decisions.decision import Policy, decide
from estimators.decisions.gate import Gate
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
        joints: names of the joints with a residual.
    """

    noise_ratio: float | None = None
    disagreement: float | None = None
    parameters: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()

    @property
    def is_biasing(self) -> bool:
        """Return True: a missing effect shifts all estimates."""
        return True


@dataclass(frozen=True)
class IdentifiedModel:
    """Terms identified by several schemes, on the rows of their recordings."""

    schemes: Sequence[Identified]
    rows: RegressionData
    terms: Sequence[Term]
    criterion: Criterion


def require_noise(after: IdentifiedModel, before: IdentifiedModel) -> Iterator[Gate]:
    """Test the residual of each joint: at most `agreement.unexplained` noise floors, and with links no correlation."""
    rows, criterion = after.rows, after.criterion
    residual, inertias = rows.residual(after.terms), rows.inertias(after.terms)
    limit = criterion.agreement.unexplained
    for at, floor in rows.floors.items():
        structure = rows.layout.structure(at, residual[rows.locate_rows(at)], inertias[at])
        negligible = compute_negligible_residual(rows.data, at)  # zero of a pendulum
        is_correlated = bool(negligible) and not is_noise(structure, max(floor, negligible), criterion)
        passed = not is_correlated and structure.rms <= limit * max(floor, negligible)
        yield Gate(f"residual@{at}", structure.rms / max(floor, 1e-300), limit, passed)


def require_equal_schemes(after: IdentifiedModel, before: IdentifiedModel) -> Iterator[Gate]:
    """Test the largest difference of two schemes in each parameter, in standard errors.

    Differences below the share `agreement.scheme_difference` of the parameter are left out.
    """
    least, gaps = after.criterion.agreement.scheme_difference, dict[str, float]()
    for result, other in combinations(after.schemes, 2):
        for name in result.model.estimates.keys() - result.withheld - other.withheld:
            first, second = (scheme.model.estimates[name] for scheme in (result, other))
            gap = abs(first.value - second.value)
            if first.std > 0 and second.std > 0 and gap > least * max(abs(first.value), abs(second.value)):
                gaps[name] = max(gaps.get(name, 0.0), gap / float(np.hypot(first.std, second.std)))
    for name in sorted(gaps, key=lambda name: (gaps[name], name)):
        yield Gate(name, gaps[name], after.criterion.z_score, gaps[name] <= after.criterion.z_score)


# A model explains the recordings from which it was identified.
NOISE_LEFT, EQUAL = Policy("noise left", (require_noise,)), Policy("equal schemes", (require_equal_schemes,))


def find_incompleteness(model: IdentifiedModel | None) -> list[Finding]:
    """Test whether a model explains its recordings: by its residual, and by the agreement of the schemes.

    Torque noise of a pendulum that is not logged explains a residual, and is a finding of its own. Nothing is found
    without a model, as too little of the motion is clear of stick.
    """
    if model is None:
        return []
    findings, rows = list[Finding](), model.rows
    ratios = {gate.name.partition("@")[2]: gate.value for gate in _list_failed(model, NOISE_LEFT)}
    if "" in ratios:  # of a pendulum
        residual, inertia = rows.residual(model.terms), rows.inertias(model.terms)[""]
        if (noise := find_process_noise(rows.data, residual, inertia, model.criterion.white)) is not None:
            findings, ratios = [noise.make_finding(model.schemes[0].model.units())], {}
    gaps = {gate.name: gate.value for gate in _list_failed(model, EQUAL)}
    if not (ratios or gaps):
        return findings
    joints, names = (tuple(sorted(filter(None, sizes), key=lambda name: -sizes[name])) for sizes in (ratios, gaps))
    largest_ratio, largest_gap = (max(sizes.values(), default=None) for sizes in (ratios, gaps))
    return [*findings, Incomplete(largest_ratio, largest_gap, names, joints)]


def _list_failed(model: IdentifiedModel, policy: Policy[IdentifiedModel]) -> list[Gate]:
    return [gate for gate in decide(model, model, policy).gates if not gate.passed]
