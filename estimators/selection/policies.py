"""Policies of the search: the questions that a model must answer to take the place of another.

The stages are in `gates`, their limits in `estimators.decisions.criterion`.
"""

from estimators.decisions.decision import Policy
from estimators.selection.evidence import Hypothesis
from estimators.selection.gates import (
    require_base,
    require_better_form,
    require_coarse_gain,
    require_determined_lag,
    require_excitation,
    require_fewer_parameters,
    require_gain,
    require_gain_held_out,
    require_gain_in_torque,
    require_known_parameters,
    require_lower_cost,
    require_lower_errors,
    require_motion,
    require_motion_share,
    require_needed_share,
    require_noise,
    require_parameters,
    require_share,
    require_share_of_table,
    require_share_of_torque,
    require_simpler_table,
    require_stop,
    require_tie,
    require_torque_error,
)

Rule = Policy[Hypothesis]

# An effect is added, or kept when it might be dropped.
ADD = Rule("add", (require_gain, require_known_parameters, require_share, require_parameters))
# The same beside a residual that another law causes: the effect explains most of it.
NEED = Rule("need", (require_gain, require_known_parameters, require_needed_share, require_parameters))
# A larger model neither loses the inertia nor turns gravity of a smaller one.
KEEP_BASE = Rule("keep base", (require_base,))
# Held-out data confirm a larger model within physical bounds.
CONFIRM = Rule("confirm", (require_lower_errors,))
# Another form of one effect is confirmed.
CHANGE_FORM = Rule("change form", (require_better_form,))
# A model predicts significantly better.
SWAP = Rule("swap", (require_gain_in_torque,))
# The same on held-out data alone.
SWAP_HELD_OUT = Rule("swap held out", (require_gain_held_out,))
# Two models are equally probable.
TIE = Rule("tie", (require_tie,))
# Other parameters or link states lower the held-out errors.
REFIT = Rule("refit", (require_lower_cost,))
# Parameters fitted together with link states do not raise the torque error.
REFIT_LINK = Rule("refit link", (require_torque_error,))
# A variant on a coarse grid is near enough to the data to be refined.
REFINE = Rule("refine", (require_coarse_gain,))
# A law explains enough of the residual torque.
EXPLAIN_TORQUE = Rule("explain torque", (require_share_of_torque,))
# An ambiguous effect may take the place of the selected one.
REPLACE = Rule("replace", (require_base, require_lower_errors, require_determined_lag))
FOLLOW_MOTION = Rule("follow motion", (require_motion_share,))
# Windows in contact with a stop, and windows near reversals, are of use.
ADD_STOP = Rule("add stop", (require_stop,))
FOLLOW = Rule("follow", (require_motion,))
# A lag or delay is no answer of a controller.
DETERMINE_LAG = Rule("determine lag", (require_determined_lag,))
# The recorded torque would show the effect.
EXCITE = Rule("excite", (require_excitation,))
# A simpler model with known parameters free explains the effects.
IMITATE = Rule("imitate", (require_fewer_parameters, require_noise, require_tie, require_motion))
# A table ties with the effects that it replaces, or beats them.
TIE_TABLE = Rule("tie table", (require_noise, require_simpler_table, require_tie))
BEAT_BY_TABLE = Rule("beat by table", (require_gain_in_torque, require_share_of_table))
