"""Choice of the case of a diagnosis by what was recorded: the one place that asks."""

from collections.abc import Sequence

from estimators.diagnosis.arm import ARM
from estimators.diagnosis.case import Case
from estimators.diagnosis.pendulum import PENDULUM
from estimators.in_loop.case import SERVO
from estimators.in_loop.rollouts import are_driven
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import find_body
from pendulum_env.physics import Term
from pendulum_env.recording import Recording


def choose_case(base: Sequence[Term], recordings: Sequence[Recording]) -> Case:
    """Return the case of recordings: of an arm, of servos with their controllers, or of a joint and its torque.

    Raises:
        RecordingError: if some recordings are of servos with a known controller, and others are not.
    """
    if isinstance(find_body(base), Body):
        return ARM
    return SERVO if are_driven(recordings) else PENDULUM
