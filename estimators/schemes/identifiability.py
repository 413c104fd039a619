"""Findings on parameters that recordings do not determine."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from typing import NamedTuple

import numpy as np

from estimators.findings import Finding, Quantity, collect_withheld
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.balance import Segments, make_regressions, stack_equations, stack_series
from estimators.schemes.fitting import Identified, join_names
from estimators.schemes.six import scheme
from estimators.signals.measurements import Measurements, measure_segments
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import BASE, SIGNIFICANT, Estimate, Model, Term
from pendulum_env.physics.joints import DRAWS
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.physics.term import return_one
from pendulum_env.recording import NEWTON_METRE, Recording
from pendulum_env.recording.columns import NONE
from pendulum_env.settings import format_setting
from pendulum_env.units import TURNING, JointUnits

SMALL_ANGLE = 0.3  # [rad]; up to this angle, sin q and q differ by less than 1.5 %
MIN_LENGTH = 1e-4  # least length of a weighted sum of independent columns of length one
MAX_UNEXPLAINED = 0.9  # largest unexplained share of the squared torque of motion that follows the torque
ONE_SIDED_SHARE = 0.002  # largest share of motion against the main direction, as noise
ONE_SIZE_RESIDUAL = 0.02  # residual of a torque that depends on the direction of motion alone, as a share of its RMS
N_POSITIONS = 50  # instants at which the inertia of the joints is computed


class Gap(StrEnum):
    """Reason why recordings do not determine parameters; comments name its size."""

    NO_MOTION = "no_motion"
    TORQUE_IS_NOISE = "torque_is_noise"  # mean torque
    TORQUE_FOLLOWS_DIRECTION = "torque_follows_direction"  # torque
    ONE_DIRECTION = "one_direction"
    SMALL_ANGLES = "small_angles"  # largest angle
    NEVER_ACTS = "never_acts"
    ACT_ALIKE = "act_alike"
    LARGE_ERROR = "large_error"  # best fit of the parameter


# gaps in the recordings that leave no parameter determined, and terms that look alike in them: an effect, a base term
TOTAL = {Gap.NO_MOTION, Gap.TORQUE_IS_NOISE, Gap.TORQUE_FOLLOWS_DIRECTION}
RIVALS = {Gap.ONE_DIRECTION: ("torque_offset", "coulomb"), Gap.SMALL_ANGLES: ("spring", "gravity")}


@dataclass(frozen=True)
class Undetermined(Finding):
    """Parameters that the recordings do not determine.

    Attributes:
        gap: the reason.
        parameters: their names; may be empty if a term of the model and an effect of the library are `rivals`.
        size: torque, angle or best fit that shows the reason, see `Gap`; None for others.
        combination: of two parameters that act alike, the factors in the sum that is determined; else empty.
    """

    gap: Gap
    parameters: tuple[str, ...] = ()
    size: Quantity | None = None
    combination: Mapping[str, float] = field(default_factory=dict)

    @property
    def withheld(self) -> tuple[str, ...]:
        """Names of the undetermined parameters."""
        return self.parameters

    @property
    def is_total(self) -> bool:
        """Return whether no parameter is determined."""
        return self.gap in TOTAL

    @property
    def is_open(self) -> bool:
        """Return True: other motion or torque determines them."""
        return True

    @property
    def rivals(self) -> tuple[str, str] | None:
        """The effect and the term that look alike; None for other gaps."""
        return RIVALS.get(self.gap)


class ClearRows(NamedTuple):
    """Rows of a fit, clear of stick: velocity and torque, with that of a load (R,), and the columns of terms (R, P)."""

    velocity: Array
    torque: Array
    phi: Array


def find_undetermined(
    measurements: Sequence[Measurements],
    terms: Sequence[Term],
    units: JointUnits = TURNING,
    rows: ClearRows | None = None,
) -> tuple[Finding, ...]:
    """Find the parameters of the terms that all recordings together do not determine.

    Checks motion, effective torque, both directions, large angles, and columns that are zero or dependent. Known
    parameters are determined, and act as a known torque.

    Args:
        measurements: of all segments; their directions and angles count, also those that are held out.
        terms: terms of the model.
        units: units of the joint.
        rows: rows of a fit; by default the samples of which no filter reaches stick or a reversal.
    """
    columns = [column for term in terms for column in term.columns]
    is_unknown = np.array([not column.is_known for column in columns], dtype=bool)
    unknown = [column for column in columns if not column.is_known]
    names, phi_by_recording = [column.name for column in unknown], _list_columns(measurements, terms)
    rows = rows or _select_clear(measurements, phi_by_recording)
    if not len(rows.velocity):
        return (Undetermined(Gap.NO_MOTION, tuple(names)),)

    doubts: list[Finding] = []
    is_free = not any(m.held.any() for m in measurements)
    if not is_free and not any(has_effective_torque(m) for m in measurements):
        mean = float(np.mean([m.held.mean() for m in measurements]))
        doubts.append(Undetermined(Gap.TORQUE_IS_NOISE, tuple(names), Quantity(mean, unit=units.unit(NEWTON_METRE))))
    known_torque = rows.phi[:, ~is_unknown] @ np.array([column.least for column in columns if column.is_known])
    friction = next((k for k, column in enumerate(columns) if column.dry is return_one and is_unknown[k]), None)
    if friction is not None and not (doubts or is_free):
        size = _find_size_of_friction(rows.torque - known_torque, rows.phi[:, friction])
        if size is not None:
            torque = Quantity(size, unit=units.unit(NEWTON_METRE))
            doubts.append(Undetermined(Gap.TORQUE_FOLLOWS_DIRECTION, tuple(names), torque))
    moving = np.concatenate([m.velocity[m.moving] for m in measurements])  # clear samples are few if noise is large
    forwards = float(np.mean((moving if len(moving) else rows.velocity) > 0))
    constant = [column for column in columns if column.is_constant]  # a known one determines the others
    is_open = bool(constant) and not any(column.is_known for column in constant)
    if is_open and not ONE_SIDED_SHARE < forwards < 1 - ONE_SIDED_SHARE:
        doubts.append(Undetermined(Gap.ONE_DIRECTION, tuple(column.name for column in constant)))
    furthest = max(float(np.abs(m.position).max()) for m in measurements)
    functions = [pair for term in terms for pair in zip(term.by_angle, term.columns, strict=False)]
    alike = [column for function, column in functions if function in ("sine", "line")]  # a known one, as above
    is_open = bool(alike) and not any(column.is_known for column in alike)
    if is_open and furthest < SMALL_ANGLE and not units.is_prismatic:
        withheld = tuple(column.name for column in alike) if len(alike) > 1 else ()
        angle = Quantity(furthest, unit=units.unit("rad"))
        doubts.append(Undetermined(Gap.SMALL_ANGLES, withheld, angle))
    acts = np.any([np.any(phi, axis=0) for phi in (*phi_by_recording, rows.phi)], axis=0)
    withheld_names = collect_withheld(doubts)
    dependent = find_dependent_columns(rows.phi[:, is_unknown], names, acts[is_unknown])
    return (*doubts, *(doubt for doubt in dependent if not withheld_names.issuperset(doubt.withheld)))


def _list_columns(measurements: Sequence[Measurements], terms: Sequence[Term]) -> list[Array]:
    """Compute the columns of the torque balance at all samples of each recording, (N, P) each."""
    return [scheme("dynamic").regression(m, terms).equations.phi for m in measurements]


def _select_clear(measurements: Sequence[Measurements], columns: Sequence[Array]) -> ClearRows:
    """Select the samples clear of stick and reversals."""
    clear = [m.find_clear(0.0) for m in measurements]
    torques = [m.held + np.asarray(m.load.torque) for m in measurements]
    groups = zip(measurements, torques, columns, clear, strict=True)
    parts = [(m.velocity[k], torque[k], phi[k]) for m, torque, phi, k in groups]
    return ClearRows(*map(np.concatenate, zip(*parts, strict=True)))


def find_undetermined_parameters(recordings: Sequence[Recording], terms: Sequence[Term]) -> tuple[Finding, ...]:
    """Find the parameters of a pendulum that recordings do not determine; none without recordings."""
    measured = [segment for recording in recordings for segment in measure_segments(recording)]
    return find_undetermined(measured, terms) if measured else ()


def find_unidentifiable(
    model: Model, measurements: Sequence[Measurements], doubts: Sequence[Finding] = ()
) -> tuple[Finding, ...]:
    """Find base parameters that a fitted model does not determine, without those withheld by `doubts`."""
    position, velocity, torque, acceleration = (
        np.concatenate([getattr(m, name) for m in measurements])[:, None]
        for name in ("position", "velocity", "held", "acceleration")
    )
    if not torque.any() and "inertia" in model.estimates:  # a free swing
        torque = model.estimates["inertia"].value * acceleration
    withheld = collect_withheld(doubts)
    found = [name for name in find_undetermined_links(model, position, velocity, torque) if name not in withheld]
    estimates = {name: model.estimates[name] for name in found}
    sizes = {name: Quantity(estimate.value, estimate.std, estimate.unit) for name, estimate in estimates.items()}
    return tuple(Undetermined(Gap.LARGE_ERROR, (name,), size) for name, size in sizes.items())


def withhold_estimates(
    results: Mapping[str, Identified], segments: Segments, terms: Sequence[Term], units: JointUnits = TURNING
) -> tuple[dict[str, Identified], tuple[Finding, ...]]:
    """Remove estimates that recordings do not determine.

    A finding on the recordings withholds its parameters from all schemes. A large standard error withholds an estimate
    from its scheme alone.

    Returns:
        Results by id of the scheme, and findings on parameters that no scheme determines.
    """
    measured = [joints for group in segments for joints in group]
    mechanism = terms[0].mechanism
    if isinstance(mechanism, LinkedMechanism):
        doubts = _find_dependent_terms(segments, terms)
        motions = [stack_series(joints, "position", "velocity", "held") for joints in measured]
        series_of_joints = [np.concatenate(series) for series in zip(*motions, strict=True)]
        withheld = collect_withheld(doubts)
        names = {id: find_undetermined_links(result.model, *series_of_joints) for id, result in results.items()}
        unknown = {id: {*of_scheme} - withheld for id, of_scheme in names.items()}
        if shared := set.intersection(*unknown.values()):
            doubts = (*doubts, Undetermined(Gap.LARGE_ERROR, tuple(sorted(shared))))
    else:
        measurements = [m for (m,) in measured]
        doubts = find_undetermined(measurements, terms, units)
        by_scheme = {id: find_unidentifiable(result.model, measurements, doubts) for id, result in results.items()}
        unknown = {id: collect_withheld(findings) for id, findings in by_scheme.items()}
        shared = set.intersection(*unknown.values())
        doubts = (*doubts, *(doubt for doubt in next(iter(by_scheme.values())) if shared.issuperset(doubt.withheld)))
    withheld = collect_withheld(doubts)
    return {
        id: replace(result, model=result.model.mark_unknown(withheld | unknown[id])) for id, result in results.items()
    }, doubts


def refuse_idle_joints(recordings: Sequence[Recording], segments: Segments, terms: Sequence[Term]) -> None:
    """Raise an `IdentificationError` if a joint with links never moves, or torque never moves a pendulum."""
    measured = [joints for group in segments for joints in group]
    mechanism = terms[0].mechanism
    for k, joint in enumerate(mechanism.joints if isinstance(mechanism, LinkedMechanism) else ()):
        if not any(joints[k].moving.any() for joints in measured):
            raise IdentificationError(
                f"{join_names(recordings)}: joint '{joint}' never moves: record with all joints moving"
            )
    if isinstance(mechanism, LinkedMechanism) or all(r.is_free for r in recordings):
        return
    if not any(has_effective_torque(m) for (m,) in measured):
        column = "torque" if any(r.torque.any() for r in recordings) else "load_torque"
        raise IdentificationError(
            f"{join_names(recordings)}: the {column} is constant or noise, and the motion does not follow it: read "
            f"the file without it, {format_setting('columns', {column: NONE})}, or mend its offset"
        )


def _find_dependent_terms(segments: Segments, terms: Sequence[Term]) -> tuple[Finding, ...]:
    """Find the dependent columns of the torque with links; see `find_dependent_columns`."""
    data = stack_equations(segments, partial(make_regressions(terms), scheme("dynamic")))
    columns = [column.name for term in terms for column in term.columns]
    phi = data.equations.phi
    return tuple(find_dependent_columns(phi[data.usable], columns, np.any(phi, axis=0)))


def find_undetermined_links(model: Model, position: Array, velocity: Array, torque: Array) -> list[str]:
    """Find parameters of links and friction that a model fitted to N samples of n joints (N, n) does not determine.

    These are insignificant parameters with a large standard error. An error is large if its torque, at the recorded
    speeds and the worst angle, exceeds the largest recorded torque of a joint. It is also large if it allows a joint
    without inertia.
    """
    largest, fastest = np.abs(torque).max(axis=0), np.abs(velocity).max(axis=0)
    largest = np.where(largest > 0, largest, largest.max())  # a joint without a motor has no torque
    large = {"inertia": 0.0, "gravity": float(largest[0])}  # of a pendulum
    for joint, most, fast in zip(model.mechanism.joints, largest.tolist(), fastest.tolist(), strict=True):
        at = f"@{joint}" if joint else ""
        large |= {f"viscous{at}": most / max(fast, 1e-300), f"coulomb{at}": most}
    if isinstance(model.mechanism, LinkedMechanism):
        large |= _compute_error_limits(model, model.mechanism, position, largest)
    limited = ((name, estimate) for name, estimate in model.estimates.items() if name in large)
    return [name for name, estimate in limited if not is_determined(estimate, large[name])]


def _compute_error_limits(
    model: Model, mechanism: LinkedMechanism, position: Array, largest: Array
) -> dict[str, float]:
    """Compute the limit of each base parameter's standard error by torque and inertia of the joints.

    `position` (N, n) [rad] is the recorded motion, and `largest` (n,) the largest torque of each joint [N m].
    """
    places = position[:: max(1, len(position) // N_POSITIONS)]
    units = np.eye(len(mechanism.joints))
    masses = [mechanism.momentum(places, np.broadcast_to(unit, places.shape))[:, k] for k, unit in enumerate(units)]
    mean = np.mean(masses, axis=1)  # (n, P)
    felt = np.sqrt(np.mean(np.square(masses), axis=1))  # RMS inertia of a unit of each parameter (n, P)
    anywhere = np.random.default_rng(0).uniform(-np.pi, np.pi, (DRAWS, len(mechanism.joints)))
    weight = np.abs(mechanism.torque(anywhere, 0 * anywhere, 0 * anywhere)).max(axis=0)  # (n, P)
    inertia = np.abs(mean @ model.theta[: len(mechanism.base)])  # of each joint (n,)
    with np.errstate(divide="ignore"):
        links = np.minimum(inertia[:, None] / SIGNIFICANT / felt, largest[:, None] / weight).min(axis=0)
    return dict(zip(mechanism.names, links.tolist(), strict=True))


def is_determined(estimate: Estimate, large: float) -> bool:
    """Return whether an estimate determines its parameter: it is significant, or its error is below a limit."""
    return estimate.is_significant or estimate.std <= large


def _find_size_of_friction(torque: Array, friction: Array) -> float | None:
    """Find the size of dry friction that explains a torque (N,) [N m] alone, else None; `friction` is its column (N,).

    With tau = c sgn v, the balance J a + g sin q + b v + (f - c) sgn v = 0 is solved by f = c and J = g = b = 0, unless
    f is known.
    """
    size = float(friction @ torque / (friction @ friction))
    residual = torque - size * friction
    return abs(size) if residual @ residual <= ONE_SIZE_RESIDUAL**2 * (torque @ torque) else None


def has_effective_torque(m: Measurements) -> bool:
    """Return whether torque changes by more than noise, or the motion follows a constant or white torque."""
    if np.std(m.held) > max(3 * m.torque_noise, 1e-9):
        return True
    equations, usable = scheme("dynamic").regression(m, BASE)
    phi, y = equations.phi[usable], equations.y[usable]
    if len(y) <= 10 * len(BASE):
        return False
    residual = y - phi @ np.linalg.lstsq(phi, y, rcond=None)[0]
    return bool(y @ y > 1e-18 * len(y) and residual @ residual < MAX_UNEXPLAINED * (y @ y))


def find_dependent_columns(phi: Array, names: Sequence[str], acts: Mask) -> list[Undetermined]:
    """Find linearly dependent columns of a regressor, and columns that never act.

    Args:
        phi: regressor (R, P), clear of stick and reversals; columns of zeros are left out.
        names: names of the columns (P,).
        acts: whether each column acts anywhere, also near reversals (P,).
    """
    length = np.linalg.norm(phi, axis=0)
    idle = [name for name, does_act in zip(names, acts, strict=True) if not does_act]
    doubts = [Undetermined(Gap.NEVER_ACTS, (name,)) for name in idle]
    nonzero = np.flatnonzero(length)
    scaled = phi[:, nonzero] / length[nonzero]
    squares, directions = np.linalg.eigh(scaled.T @ scaled)
    for direction in directions.T[squares < MIN_LENGTH**2]:
        alike = np.flatnonzero(np.abs(direction) > 0.1)
        group, change = tuple(names[nonzero[j]] for j in alike), direction[alike] / length[nonzero[alike]]
        factors = (1.0, float(-change[0] / change[1])) if len(group) == 2 else ()  # orthogonal to the null vector
        doubts.append(Undetermined(Gap.ACT_ALIKE, group, combination=dict(zip(group, factors, strict=False))))
    return doubts
