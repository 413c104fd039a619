"""Servos with their controller in the loop: fitted and diagnosed by simulating whole recordings from the goal.

A diagnosis makes these calls, in this order:

    prepare                     case.py             calibrates the recordings
      decide_conventions        conventions.py      decides by fits how goals, encoder and controller are simulated
    make_evaluator              case.py             makes `RolloutRows` of fitted and held-out recordings
    search                      selection/search.py adds and drops effects by these rows, each time:
      RolloutRows.compare       rollout_rows.py     simulates the variants of an effect, each by one step
        Rollouts                rollouts.py         simulates all recordings at once by `simulate_servos`
        ComparedPositions       compared_positions.py has the measured positions to compare with
      RolloutFits.linearise     rollout_fits.py     fits each set of terms once by `fit_rollouts` (fit.py), and
        linearise_errors        linearisation.py    simulates the slopes of the positions by the parameters
        fit_link                link_fit.py         fits a link from many starts
    reread_goals                goal_reading.py     is tried with the found effects, if the fits left the goals open
    refine                      refit.py            refits with shorter steps, widens errors, drops effects not needed
      scan_profile              profile.py          fits the gap of a play by its profile likelihood
    find_loop_regions, conclude conclusion.py       find the residual of the motion and the findings
"""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from estimators.in_loop.convention_fits import complete_drives
    from estimators.in_loop.conventions import decide_conventions, has_open_torque
else:  # a recording without goals needs none of it
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = ["complete_drives", "decide_conventions", "has_open_torque"]
