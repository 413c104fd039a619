"""Detection of wrong signs and zeros of columns by a fit, with the columns that correct them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.checks.settings import CHECKS
from estimators.checks.signs import (
    NegativeParameters,
    compute_significant_sign,
    find_driving_friction,
    is_significantly_negative,
)
from estimators.decisions.criterion import Criterion
from estimators.findings import Finding, Quantity
from estimators.regression.least_squares import Equations, IdentificationError, solve, subtract_known_columns
from estimators.weak_form.preparation import prepare_windows
from pendulum_env.physics import BASE, Column, Model
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.recording import NEWTON_METRE, Recording
from pendulum_env.recording.notes import NoteKind
from pendulum_env.recording.origin import Origin

# minus the load torque in the balance: its parameter is 0, or -2 if the sensor has the opposite sign
# noise s in a load l beyond the other columns makes these -s^2 / (l^2 + s^2) and -(2 l^2 + s^2) / (l^2 + s^2)
LOAD_TORQUE = Column("load_torque", "1", force=lambda x: -1.0 * x.load.torque)


@dataclass(frozen=True)
class Remedy:
    """Settings of columns that read some recordings correctly."""

    columns: Mapping[str, str]  # as in `read_recording`
    recordings: tuple[str, ...]  # names


@dataclass(frozen=True)
class WrongColumn(Finding):
    """Column that was read with another sign or zero.

    Attributes:
        column: `load_torque` or `torque`, with the opposite sign; or `position`, with another zero, also of a joint.
        remedies: settings that read the recordings correctly.
        inertia: negative inertia, by which the torque has the opposite sign; else None.
        angle: error of the zero; None for other columns, and if the upright position was taken as zero.
        has_bias: whether the model has no tilt for the error of the zero, so that all estimates are biased.
        joint: joint of an arm with this column; without an angle, its signs are opposite. Empty for a pendulum.
    """

    column: str
    remedies: tuple[Remedy, ...] = ()
    inertia: Quantity | None = None
    angle: Quantity | None = None
    has_bias: bool = False
    joint: str = ""

    @property
    def is_biasing(self) -> bool:
        """Return whether the model lacks the error of the zero."""
        return self.has_bias


@dataclass(frozen=True)
class UnevenClock(Finding):
    """Time steps of a recording with a scatter `std` about their `period`, without a uniform clock."""

    recording: str
    std: Quantity
    period: Quantity


def find_remedies(
    model: Model,
    recordings: Sequence[Recording],
    ambiguous: Sequence[Sequence[str]] = (),
    is_complete: bool = True,
    criterion: Criterion = Criterion(),
) -> list[Finding]:
    """Find wrong columns by the model fitted to recordings, or else friction that accelerates.

    A shifted zero is not reported for an incomplete model, because a missing effect may imitate it. No column is
    reported if a tilt is ambiguous.
    """
    is_tilt_open = any("gravity_tilt" in group for group in ambiguous)
    columns = [] if is_tilt_open else find_wrong_columns(model, recordings, criterion)
    if not is_complete:
        columns = [found for found in columns if not isinstance(found, WrongColumn) or found.column != "position"]
    return columns or [*find_driving_friction(model)]


def find_uneven_clocks(recordings: Sequence[Recording]) -> list[UnevenClock]:
    """Find the recording with the largest scatter of time steps, if any was resampled: wrong stamps bias the motion."""
    resampled = [(note, item) for item in recordings for note in item.notes if note.kind is NoteKind.RESAMPLED]
    if not resampled:
        return []
    note, recording = max(resampled, key=lambda pair: pair[0].numbers["std"].value)
    return [UnevenClock(recording.name, note.numbers["std"], Quantity(1e3 / recording.rate, unit="ms"))]


def find_wrong_columns(
    model: Model, recordings: Sequence[Recording], criterion: Criterion = Criterion()
) -> list[Finding]:
    """Find a column of the recordings with a wrong sign or zero, by the fitted parameters and known loads."""
    limits = criterion.columns
    if _is_load_torque_turned(model, recordings, criterion):
        remedies = _make_remedies(recordings, lambda origin: origin.flip_sign("load_torque"))
        return [WrongColumn("load_torque", remedies)]
    if is_significantly_negative(model, "inertia"):
        quantity = "torque" if any(recording.torque.any() for recording in recordings) else "load_torque"
        remedies = _make_remedies(recordings, lambda origin: origin.flip_sign(quantity))
        inertia = model.estimates["inertia"]
        return [WrongColumn("torque", remedies, Quantity(inertia.value, inertia.std, inertia.unit))]
    if model.is_prismatic:
        return []
    gravity, tilt = (model.estimates.get(name) for name in ("gravity", "gravity_tilt"))
    load_gravities = {0.0 if recording.load is None else recording.load.gravity for recording in recordings}
    if gravity is None or gravity.std == 0:  # no gravity, or fixed by the user
        return []
    down = gravity.value + max(load_gravities, key=abs)
    if tilt is not None and compute_significant_sign(model, "gravity_tilt") and len(load_gravities) == 1:
        # g sin(q - d) = g cos d sin q - g sin d cos q
        angle = float(np.arctan2(tilt.value, down))
        error = float(np.hypot(tilt.std * down, gravity.std * tilt.value)) / (down**2 + tilt.value**2)
        digits = int(np.clip(-np.floor(np.log10(max(np.degrees(error), 1e-9))), 0, 3))
        remedies = _make_remedies(recordings, lambda origin: origin.shift_zero(angle, digits))
        return [WrongColumn("position", remedies, angle=Quantity(angle, error, "rad"))]
    if is_significantly_negative(model, "gravity") and down < 0:
        if any(term.is_weight and term.id != "gravity_tilt" for term in model.terms):
            return []
        if springs := [term.columns[0].name for term in model.terms if term.is_restoring]:
            return [NegativeParameters(("gravity", *springs))]
        torque = max(float(np.sqrt(np.mean(recording.torque**2))) for recording in recordings)
        if abs(down) < limits.upright_share * torque:
            return []
        has_one_load = len(load_gravities) == 1
        if tilt is None and has_one_load and (tilted := _fit_tilt(model, recordings, criterion)) is not None:
            found = find_wrong_columns(tilted, recordings, criterion)
            return [replace(one, has_bias=True) if isinstance(one, WrongColumn) else one for one in found]
        remedies = _make_remedies(recordings, lambda origin: origin.shift_zero(np.pi, 0))
        return [WrongColumn("position", remedies)]
    return []


def _is_load_torque_turned(model: Model, recordings: Sequence[Recording], criterion: Criterion) -> bool:
    """Return whether the balance needs the opposite sign of the load torque.

    False if other columns explain the load torque, as that of a viscous brake.
    """
    loaded = [r for r in recordings if r.has_varying_load and r.torque_unit == NEWTON_METRE]
    try:
        data = prepare_windows(loaded) if loaded else None
    except IdentificationError:
        data = None
    if data is None:
        return False
    base = {term.id for term in BASE}  # an added effect may imitate twice the load
    equations = data.equations([term for term in model.terms if term.id in base])
    averages = data.window_columns.averages
    phi = np.column_stack([equations.phi, averages.column(LOAD_TORQUE, averages.samples)])
    fit = solve(Equations(phi, equations.y), data.weights, data.blocks(criterion.block)[0])
    excess = -1.0 - float(fit.theta[-1])  # l^2 / (l^2 + s^2) if the sensor has the opposite sign
    least = max(criterion.columns.turned_share, criterion.z_score * float(fit.std[-1]))
    return fit.condition < CHECKS.dependent and excess > least


def _fit_tilt(model: Model, recordings: Sequence[Recording], criterion: Criterion) -> Model | None:
    """Return a model fitted with a tilt of gravity, which shows any error of the zero; None if it is insignificant.

    Known parameters keep their values.
    """
    try:
        data = prepare_windows(recordings)
    except IdentificationError:
        return None
    terms = (*model.terms, GravityTilt())
    columns = [column for term in terms for column in term.columns]
    unknown = np.array([not column.is_known for column in columns], dtype=bool)
    theta, std = np.array([column.least if column.is_known else 0.0 for column in columns]), np.zeros(len(columns))
    equations = subtract_known_columns(data.equations(terms), np.flatnonzero(~unknown).tolist(), theta[~unknown])
    fit = solve(equations, data.weights, data.blocks(criterion.block)[0])
    theta[unknown], std[unknown] = fit.theta, fit.std
    tilted = Model.build(terms, theta, std)
    is_determined = fit.condition < CHECKS.dependent and compute_significant_sign(tilted, "gravity_tilt") != 0
    return tilted if is_determined else None


def find_reversed_torque(
    model: Model, recordings: Sequence[Recording], criterion: Criterion = Criterion()
) -> Finding | None:
    """Find torque with the opposite sign, by the parameters of the base model.

    No parameter may be positive, and inertia and two others must be significantly negative.
    """
    known = [name for name in ("inertia", "gravity", "viscous", "coulomb") if name in model.estimates]
    n_negative = sum(is_significantly_negative(model, name) for name in known)
    if (
        n_negative < 3
        or not is_significantly_negative(model, known[0])
        or any(model.estimates[name].value > 0 for name in known)
    ):
        return None
    return find_wrong_columns(model, recordings, criterion)[0]


def _make_remedies(
    recordings: Sequence[Recording], correct: Callable[[Origin], dict[str, str] | None]
) -> tuple[Remedy, ...]:
    """Make the remedies of recordings; `correct` returns the corrected columns of an origin, or None."""
    origins = ((recording.name, recording.origin) for recording in recordings)
    return group_remedies((name, None if origin is None else correct(origin)) for name, origin in origins)


def group_remedies(corrected: Iterable[tuple[str, Mapping[str, str] | None]]) -> tuple[Remedy, ...]:
    """Make a remedy for each set of corrected columns, with the names of its recordings; those without are left out."""
    names_of: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for name, columns in corrected:
        if columns is not None:
            names_of.setdefault(tuple(columns.items()), []).append(name)
    return tuple(Remedy(dict(columns), tuple(names)) for columns, names in names_of.items())
