"""An added effect in words."""

import numpy as np

from estimators.diagnosis.likeness import Likeness, find_likenesses
from estimators.diagnosis.result import Addition
from estimators.selection.errors import Step
from pendulum_env.formatting import join_words
from pendulum_env.physics.term import list_loads
from pendulum_env.units import JointUnits
from workbench.narrator.reasons import ERRORS, describe_objection

FORMS = {
    "power": "|q'|^{0}",
    "wave": "a wave of {0} a turn",
    "line": "a straight line",
    "bump": "a bump at {0} {rad}, {1} {rad} wide",
    "step": "a step at {0} {rad}, {1} {rad} wide",
}
SIGNIFICANT = 3.0  # times its standard errors, from which a table has a shape


def describe_addition(found: Addition) -> str:
    """State whether the effect lowers errors on data to which it was not fitted."""
    if found.objection is not None:
        objection = describe_objection(found.objection)
        return f"{found.after.added} {objection}: these recordings give no reason to keep it."
    old, new = found.before.errors["holdout"], found.after.errors["holdout"]
    joint = next(iter(list_loads((found.after.added or "").partition("@")[2])))
    shares = {kind: getattr(new, kind) / getattr(old, kind) for kind in new.kinds if kind in old.kinds}
    shares[next(iter(shares))] = new.get_joint_error(joint) / old.get_joint_error(joint)
    falls = [f"{ERRORS[kind]}{f' at {joint}' if joint else ''} to {share:.1%}" for kind, share in shares.items()]
    return f"{found.after.added} lowers the held-out errors: {', '.join(falls)} of before."


def describe_table(step: Step) -> str | None:
    """Name the formulas that an added table comes nearest to; None of an effect."""
    tables = step.model.tables
    if step.added not in tables:
        return None
    table, curve = tables[step.added]
    if np.mean(curve.value**2) < (SIGNIFICANT * np.median(curve.std)) ** 2:  # at an end they may be large
        return f"{step.added} looks like no formula: its standard errors are nearly as large as itself."
    near = [describe_likeness(one, table.slides) for one in find_likenesses(table, curve)]
    nearest = f"{join_words(near, 'or')} of its shape" if near else "no formula that is known here"
    return f"{step.added} looks like {nearest}."


def describe_likeness(found: Likeness, slides: bool = False) -> str:
    """Write a formula and the share of the shape that it explains: `|q'|^0.4 (99.7 %)`."""
    unit = JointUnits(slides=slides).unit("rad")
    text = FORMS[found.form].format(*(f"{value:.3g}" for value in found.values), rad=unit)
    text = text.replace("of 1 a turn", "of one a turn")
    return f"{text} ({100 * found.share:.3g} %)"
