"""A comparison in words."""

import numpy as np

from estimators.results import Comparison
from pendulum_env.formatting import format_percent
from pendulum_env.quantity import Quantity
from pendulum_env.recording.channel import NEWTON_METRE
from workbench.narrator.findings import advise_inertia, measure


def describe_comparison(found: Comparison) -> str:
    """State the error of the model in one sentence."""
    errors = found.joint.errors
    times, at = max((errors.joints[at] / max(floor, 1e-300), at) for at, floor in found.joint.floors.items())
    units, where = found.model.units(at), f" at {at}" if at else ""
    error = f"{errors.joints[at]:.3g} {units.unit(NEWTON_METRE)}{where}"
    text = f"The model is off by {error}, {times:.2g} times the noise floor"
    if np.isnan(errors.position_rms):
        return text
    position = measure(Quantity(errors.position_rms, unit=units.unit("rad")))
    return f"{text}, and by {position} in free run over {found.horizon:g} s"


def describe_unstable(found: Comparison) -> str | None:
    """Name the windows that are not counted in the error of free runs; None if all are."""
    if not found.model.has_known_inertia:
        return f"The free-running position is unknown, as the inertia of the model is. {advise_inertia()}"
    share = found.joint.unstable
    if share == 0:
        return None
    windows = f"windows of {found.horizon:g} s"
    text = f"In {format_percent(share)} of the {windows} a small error grows tenfold, as with the arm upright"
    return f"{text}: there are no others." if share == 1 else f"{text}: these are not counted in free run."


def describe_loop(found: Comparison) -> str | None:
    """State the error in the loop; None where the controller is unknown."""
    error = Quantity(found.joint.errors.total, unit=found.model.units().unit("rad"))
    text = f"Simulated from its goals alone, the model is off by {measure(error)} on average."
    return text if found.joint.errors.is_in_loop else None
