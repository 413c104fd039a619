"""Registry of cases, and the choice of a case by recordings."""

from collections.abc import Sequence

from estimators.diagnosis.arm import ARM
from estimators.diagnosis.case import Case
from estimators.diagnosis.pendulum import PENDULUM
from estimators.diagnosis.servo import SERVO
from pendulum_env.physics import Term
from pendulum_env.plugins import load_plugins
from pendulum_env.recording import Recording

ENTRY_POINTS = "pendulum_ident.cases"
_registered: list[Case] = [SERVO, ARM]


def register_case(case: Case) -> Case:
    """Add a case to the cases of this process; it is asked before those that were registered earlier.

    A case of the same name replaces the earlier one.
    """
    _registered[:] = [*(other for other in _registered if other.name != case.name), case]
    return case


def list_cases() -> tuple[Case, ...]:
    """List all cases in the order in which they are asked; the pendulum, which accepts everything, is the last."""
    installed = [case for case in load_plugins(ENTRY_POINTS) if isinstance(case, Case)]
    return (*reversed(_registered), *installed, PENDULUM)


def choose_case(base: Sequence[Term], recordings: Sequence[Recording]) -> Case:
    """Return the first case that accepts a base model and recordings."""
    return next(case for case in list_cases() if case.accepts(base, recordings))
