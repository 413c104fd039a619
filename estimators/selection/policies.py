"""Policies of the search: the questions that a model must answer to take the place of another.

The stages are in `gates`, their limits in `estimators.decisions.criterion`.
"""

from estimators.decisions.decision import Policy
from estimators.selection import gates
from estimators.selection.evidence import Hypothesis

Rule = Policy[Hypothesis]

# An effect is added, or kept when it might be dropped.
ADD = Rule("add", (gates.require_gain, gates.require_known_parameters, gates.require_share, gates.require_parameters))
# The same beside a residual that another law causes: the effect explains most of it.
NEED = Rule(
    "need", (gates.require_gain, gates.require_known_parameters, gates.require_needed_share, gates.require_parameters)
)
# A larger model neither loses the inertia nor turns gravity of a smaller one.
KEEP_BASE = Rule("keep base", (gates.require_base,))
# Held-out data confirm a larger model within physical bounds.
CONFIRM = Rule("confirm", (gates.require_lower_errors,))
# Another form of one effect is confirmed.
CHANGE_FORM = Rule("change form", (gates.require_better_form,))
# A model predicts significantly better.
SWAP = Rule("swap", (gates.require_gain_in_torque,))
# It does, in torque or in free motion, also without a penalty for the choice among many.
BEAT_CHANCE = Rule("beat chance", (gates.require_p_value,))
# The same on held-out data alone.
SWAP_HELD_OUT = Rule("swap held out", (gates.require_gain_held_out,))
# Two models are equally probable.
TIE = Rule("tie", (gates.require_tie,))
# Other parameters or link states predict held-out torque better.
REFIT = Rule("refit", (gates.require_gain_of_parameters,))
# Parameters fitted to the motion lower its held-out error, and do not predict torque worse.
REFIT_TO_MOTION = Rule("refit to motion", (gates.require_no_loss, gates.require_lower_position))
# A law explains enough of the residual torque.
EXPLAIN_TORQUE = Rule("explain torque", (gates.require_share_of_torque,))
# An ambiguous effect may take the place of the selected one.
REPLACE = Rule("replace", (gates.require_base, gates.require_lower_errors, gates.require_determined_lag))
FOLLOW_MOTION = Rule("follow motion", (gates.require_motion_share,))
# Windows in contact with a stop, and windows near reversals, are of use.
ADD_STOP = Rule("add stop", (gates.require_stop,))
FOLLOW = Rule("follow", (gates.require_inertia, gates.require_motion))
# So are windows cut by the inertia of a model.
HAVE_INERTIA = Rule("have inertia", (gates.require_inertia,))
# A lag or delay is no answer of a controller.
DETERMINE_LAG = Rule("determine lag", (gates.require_determined_lag,))
# The recorded torque would show the effect.
EXCITE = Rule("excite", (gates.require_excitation,))
# A simpler model with known parameters free explains the effects.
IMITATE = Rule(
    "imitate", (gates.require_fewer_parameters, gates.require_noise, gates.require_tie, gates.require_motion)
)
# A table ties with the effects that it replaces, or beats them.
TIE_TABLE = Rule("tie table", (gates.require_noise, gates.require_simpler_table, gates.require_tie))
BEAT_BY_TABLE = Rule("beat by table", (gates.require_gain_in_torque, gates.require_share_of_table))
