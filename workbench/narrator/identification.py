"""Tables and texts of an identification, and its JSON content."""

import numpy as np

from estimators.checks.homogeneity import Disagreement
from estimators.checks.signs import NegativeParameters
from estimators.diagnosis.completeness import Incomplete
from estimators.findings import Finding
from estimators.schemes.result import Identification
from pendulum_env._typing import JSON
from pendulum_env.formatting import TextTable
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.units import show_angles
from workbench.narrator.findings import describe

TIMES = "relative error"  # row with the median ratio of standard errors to the smallest ones
TRUST = f"{TIMES}: standard errors of a scheme over the smallest; trust schemes near 1"


def tabulate_by_scheme(identification: Identification) -> TextTable:
    """Tabulate the estimates with a row for each parameter and a column for each scheme."""
    models = [scheme.model.estimates for scheme in identification.schemes.values()]
    rows = [(name, *(model[name].shown.text for model in models), models[0][name].shown.unit) for name in models[0]]
    conditions = [scheme.condition for scheme in identification.schemes.values()]
    if np.isfinite(conditions).all():  # there is none in the loop
        rows.append(("condition", *(f"{condition:.3g}" for condition in conditions), ""))
    if len(models) > 1:
        errors = np.array([[estimate.std for estimate in model.values()] for model in models])
        times = np.median(errors / np.maximum(errors.min(axis=0), 1e-300), axis=1)
        rows.append((TIMES, *(f"{seconds:.2g}" for seconds in times.tolist()), ""))
    return TextTable(("parameter", *identification.schemes, "unit"), rows, left=("unit",))


def tabulate_schemes(identification: Identification) -> TextTable:
    """Tabulate the estimates with a row for each scheme; for an arm as `tabulate_by_scheme`."""
    if isinstance(identification.mechanism, LinkedMechanism):
        return tabulate_by_scheme(identification)
    model = next(iter(identification.schemes.values())).model
    columns, units = model.columns, model.units()
    names = [column.name for column in columns]
    rows = []
    for id, result in identification.schemes.items():
        values = [result.model.estimates[name].text for name in names]
        rows.append((id, *values, f"{result.residual_rms:.3g} {result.unit}"))
    return TextTable(("scheme", *(f"{c.name} [{units.unit(c.unit)}]" for c in columns), "residual"), rows)


def explain_trust(table: TextTable) -> str:
    """Return the explanation of the row of relative errors; empty if the table has none."""
    return TRUST if any(row[0] == TIMES for row in table.rows) else ""


def list_warnings(identification: Identification) -> list[str]:
    """List the findings of an identification, each with its next step."""
    return [f"{describe(finding)}{_advise(finding)}" for finding in identification.findings]


def _advise(finding: Finding) -> str:
    """Return the next step after a finding; empty if its text has one."""
    if isinstance(finding, Incomplete) or (
        isinstance(finding, NegativeParameters) and "gravity" not in finding.parameters
    ):
        return " Run `diagnose`."
    is_outlier = isinstance(finding, Disagreement) and finding.residual is None
    return " Leave it out, or find out what was changed." if is_outlier else ""


@show_angles("rad")
def write_identification(identification: Identification) -> JSON:
    """Return the content of `identify --json`: results, and findings with their texts."""
    data = identification.json()
    for entry, text in zip(data["findings"], list_warnings(identification), strict=True):
        entry["text"] = text
    return data
