"""Correction of torque that is logged late or through a filter."""

from __future__ import annotations

from estimators.arguments import Recordings, Terms, check_options, select_recordings, select_terms
from estimators.data.timing import Timing
from estimators.decisions.criterion import Criterion
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.physics import BASE, list_ids
from pendulum_env.physics.joints import find_mechanism
from pendulum_env.physics.mechanism import LinkedMechanism


@refuse_unknown_arguments
def align(recordings: Recordings, terms: Terms = BASE, *, criterion: Criterion = Criterion()) -> Timing:
    """Estimate the time between torque and motion, and correct torque that is logged late or filtered.

    Recordings share one delay unless they contradict it, as in `diagnose` and with `--align`.

    Args:
        recordings: one or more.
        terms: of the model, or their ids; with links `robots.arms.arm_base(body)`. Effects are fitted with the delay.
        criterion: limits of the decisions.

    Returns:
        The corrected `recordings`, the `alignments` with delay and lag of each, and `findings`.

    Raises:
        TypeError: if an argument is neither recordings nor terms.
        ValueError: if a name is unknown.
    """
    check_options(criterion)
    terms = select_terms(terms)
    mechanism, known = find_mechanism(terms), list_ids(BASE)
    logged = select_recordings(recordings, terms=terms)
    effects = terms if isinstance(mechanism, LinkedMechanism) else [term for term in terms if term.id not in known]
    return Timing.from_recordings(logged, effects, criterion)
