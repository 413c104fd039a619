"""Tables of errors, parameters, candidates and residuals."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from estimators.decisions.errors import Errors, Step
from estimators.diagnosis.result import Candidate
from estimators.findings import Verdict
from estimators.results import Comparison
from estimators.signals.residual import REGIONS, SYMBOLS, Profile, split_bins
from estimators.simulation.free_running import HORIZON
from pendulum_env.formatting import TextTable, draw_bar, format_quantity, join_words
from pendulum_env.physics import Model
from pendulum_env.physics.estimate import shorten_name
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.units import TURNING, JointUnits, to_shown_unit
from workbench.narrator.findings import ERRORS, describe_reason

JOINT_LEGEND = (
    "noise floor: torque error caused by sensor noise alone; share of torque: the error over the torque of the joint"
)


def tabulate_joints(
    columns: Sequence[Errors], floors: Mapping[str, float], model: Model, headers: Sequence[str] = ("before", "after")
) -> TextTable:
    """Tabulate the joints: errors of models, noise floor, and last error as a share of the torque or the motion."""
    quantity = "motion" if columns[-1].is_of_motion else "torque"
    rows = [
        (
            at,
            *(f"{errors.joints[at]:.4g}" for errors in columns),
            f"{floors[at]:.4g}",
            model.units(at).unit(columns[-1].unit),
            "" if share is None else f"{100 * share:.2g} %",
        )
        for at, share in ((joint, columns[-1].get_share(joint)) for joint in columns[-1].shares)
    ]
    return TextTable(("joint", *headers, "noise floor", "unit", f"share of {quantity}"), rows, left=("unit",))


def tabulate_errors(steps: Sequence[Step], units: JointUnits = TURNING) -> TextTable:
    """Tabulate the errors of each step; ratios and bars: held-out error over that of the base model."""
    base = steps[0].errors["holdout"]
    headers, rows = ["model"], [["as it was" if step.added is None else f"+ {step.added}"] for step in steps]
    for kind, unit in base.kinds.items():
        name, (factor, unit) = ERRORS[kind], to_shown_unit(1.0, units.unit(unit))
        headers += [f"{name}, fitted [{unit}]", f"{name}, held out [{unit}]", "ratio"]
        for row, step in zip(rows, steps, strict=True):
            train, holdout = (step.errors[part].get_error(kind) for part in ("train", "holdout"))
            ratio = format_quantity(holdout / max(base.get_error(kind), 1e-300), 3)
            row += [format_quantity(factor * train, 4), format_quantity(factor * holdout, 4), ratio]
    return TextTable([*headers, ""], [[*row, draw_bar(float(row[3]))] for row in rows], left=("",))


def tabulate_parameters(*models: Model, headers: Sequence[str] = ("estimate",)) -> TextTable:
    """Tabulate the parameters of the last model with standard errors, and their values in earlier models."""
    named = [{**model.readable, **model.derived} for model in models]
    rows = [
        (
            shorten_name(name),
            *(estimates[name].shown.text if name in estimates else "" for estimates in named),
            last.shown.unit,
        )
        for name, last in named[-1].items()
    ]
    return TextTable(("parameter", *headers, "unit"), rows, left=("unit",))


def tabulate_candidates(candidates: Sequence[Candidate], max_rows: int) -> tuple[TextTable, str]:
    """Tabulate selected, ambiguous and at most `max_rows` rejected candidates; also return a text on the others."""
    accepted = [c for c in candidates if c.verdict.is_accepted]
    rejected = [c for c in candidates if c not in accepted]
    shown_candidates, hidden = rejected[:max_rows], rejected[max_rows:]
    rows = [
        (c.effect, str(c.verdict).replace("_", " "), f"{c.score:.2f}", describe_reason(c))
        for c in (*accepted, *shown_candidates)
    ]
    blind = [c.effect for c in hidden if c.verdict is Verdict.NOT_EXCITED]
    worse = len(hidden) - len(blind)
    parts = [f"{worse} more that are no better"] if worse else []
    parts += [f"{len(blind)} that could not be judged ({join_words(blind)})"] if blind else []
    return TextTable(("effect", "verdict", "score", "reason"), rows, left=("verdict", "reason")), " and ".join(parts)


def tabulate_recordings(comparison: Comparison) -> TextTable:
    """Tabulate the errors of a model for each recording, and for several also of all together."""
    of_recordings = comparison.recording_errors
    rows_of_errors = [*of_recordings, comparison.joint] if len(of_recordings) > 1 else of_recordings
    units = comparison.model.units()
    unit, (factor, angle) = units.unit(NEWTON_METRE), to_shown_unit(1.0, units.unit("rad"))
    over = "" if comparison.horizon in (None, HORIZON) else f" over {comparison.horizon:g} s"
    free_running = f"free-running position{over} [{angle}]"
    headers = ["recording", f"torque [{unit}]", "fit [%]", f"noise floor [{unit}]", free_running, "fit [%]"]
    if comparison.joint.errors.is_of_motion:
        headers += [f"in the loop, mean [{angle}]", f"RMS [{angle}]"]
    rows = []
    for item in rows_of_errors:
        errors = item.errors
        torque = [f"{size:.4g}" for size in (errors.torque_rms, errors.torque_fit, item.noise_floor)]
        motion = [format_quantity(size, 4) for size in (factor * errors.position_rms, errors.position_fit)]
        loop = [f"{factor * size:.4g}" for size in errors.motion_errors]
        rows.append((item.name, *torque, *motion, *loop))
    return TextTable(headers, rows)


def tabulate_profile(profile: Profile) -> TextTable:
    """Tabulate the mean residual over one quantity, with bars; if bins are many, neighbours of one run share a row."""
    joined = -(-len(profile.mean) // REGIONS.bins)  # largest number of bins of a row
    starts = np.concatenate([bins[::joined] for bins in split_bins(profile)])
    means = np.add.reduceat(profile.mean, starts) / np.diff(np.r_[starts, len(profile.mean)])
    largest = float(np.abs(means).max()) or 1.0
    edges, unit_of_axis = to_shown_unit(profile.edges[np.r_[starts, len(profile.mean)]], profile.unit)
    rows = [
        (f"{low:.3g} to {high:.3g}", f"{mean:.3g}", f"{draw_bar(min(share, 0)):>12}│{draw_bar(max(share, 0)):<12}")
        for (low, high), mean, share in zip(pairwise(edges), means.tolist(), (means / largest).tolist(), strict=True)
    ]
    unit = profile.units.unit(NEWTON_METRE)
    return TextTable((f"{SYMBOLS[profile.axis]} [{unit_of_axis}]", f"mean residual [{unit}]", ""), rows, left=("",))
