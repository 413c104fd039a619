"""Choice of the case of a diagnosis by the recordings."""

from collections.abc import Sequence

from estimators.diagnosis.arm import ARM
from estimators.diagnosis.case import Case
from estimators.diagnosis.pendulum import PENDULUM
from estimators.diagnosis.servo import SERVO
from pendulum_env.physics import Term
from pendulum_env.recording import Recording


def choose_case(base: Sequence[Term], recordings: Sequence[Recording]) -> Case:
    """Return the first case that takes the recordings: an arm, servos with controllers, or a pendulum.

    Raises:
        RecordingError: if some recordings have a known controller, and others do not.
    """
    return next(case for case in (ARM, SERVO, PENDULUM) if case.accepts(base, recordings))
