"""Registry of cases, and the choice of a case by recordings."""

from collections.abc import Sequence

from estimators.data.preparation import ENTRY_POINTS, list_preparations, register_preparation
from estimators.diagnosis.case import Case, DividedCase
from estimators.diagnosis.pendulum import PENDULUM
from pendulum_env.physics import Term
from pendulum_env.plugins import make_missing_error
from pendulum_env.recording import Recording


def register_case(case: Case) -> Case:
    """Add a case to the cases of this process; it is asked before those that were registered earlier."""
    register_preparation(case)
    return case


def list_cases() -> tuple[Case, ...]:
    """List all cases in the order in which they are asked; the pendulum is the last."""
    return (*(item for item in list_preparations() if isinstance(item, Case)), PENDULUM)


def find_division(base: Sequence[Term], recordings: Sequence[Recording]) -> DividedCase | None:
    """Return the case by which the joints of a machine are diagnosed one by one; None for other machines."""
    cases = (item for item in list_preparations() if isinstance(item, DividedCase))
    return next((case for case in cases if case.accepts(base, recordings)), None)


def choose_case(base: Sequence[Term], recordings: Sequence[Recording]) -> Case:
    """Return the first case that accepts a base model and recordings.

    Raises:
        UserError: if they have links or a controller, and no installed package has a case for these.
    """
    for case in list_cases():
        if case.accepts(base, recordings):
            return case
    raise make_missing_error(ENTRY_POINTS, "has a case for these recordings")
