"""Findings on recordings and on the model of a session, for the stages and the report."""

from collections.abc import Iterable

from estimators import RegressionData
from estimators.data.regions import find_failures
from estimators.findings import Finding
from estimators.schemes.identifiability import find_undetermined
from estimators.signals.measurements import measure_segments
from estimators.signals.residual import Region
from pendulum_env.physics import Model, Term
from pendulum_env.recording import Recording

Findings = tuple[Finding, ...]


def find_doubts(recordings: Iterable[Recording], terms: tuple[Term, ...]) -> Findings:
    """Find the parameters of a pendulum that recordings do not determine."""
    measured = [segment for recording in recordings for segment in measure_segments(recording)]
    return find_undetermined(measured, terms) if measured else ()


def find_model_failures(data: RegressionData, model: Model) -> tuple[Region, ...]:
    """Find the regions in which the residual of a model exceeds the noise, joint by joint."""
    residual = data.with_link_states(model).residual(model.terms, model.theta)
    return tuple(region for at in data.floors for region in find_failures(data, residual, at))
