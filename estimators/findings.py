"""Findings on data, a model or the next step: a kind and numbers; the narrator of the workbench writes the text."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from pendulum_env._typing import JSON
from pendulum_env.notebook import summarise
from pendulum_env.quantity import Quantity as Quantity


class Kind(StrEnum):
    """Kind of a finding; comments name its numbers."""

    # parameters that the recordings do not determine
    NO_MOTION = "no_motion"
    TORQUE_IS_NOISE = "torque_is_noise"  # torque
    TORQUE_IS_CONSTANT = "torque_is_constant"  # torque
    TORQUE_FOLLOWS_DIRECTION = "torque_follows_direction"  # torque
    ONE_DIRECTION = "one_direction"
    SMALL_ANGLES = "small_angles"  # angle
    NEVER_ACTS = "never_acts"
    INDISTINGUISHABLE = "indistinguishable"
    UNIDENTIFIABLE = "unidentifiable"  # the best fit, by name of the parameter
    RELATIVE_TO_INERTIA = "relative_to_inertia"

    # the torque constant of a drive: torque_constant
    LOADS_UNKNOWN = "loads_unknown"
    LOADS_EQUAL = "loads_equal"
    CONSTANT_TOO_SHORT = "constant_too_short"
    ONE_LOAD_MOVED = "one_load_moved"  # loads
    CONSTANT_UNCERTAIN = "constant_uncertain"  # inverse
    CONSTANT_NEGATIVE = "constant_negative"
    INTEGRAL_CONTROLLER = "integral_controller"
    GEAR_LOSS_UNKNOWN = "gear_loss_unknown"  # share of the motion that the motor drives
    LOAD_BRAKES = "load_brakes"
    BACK_EMF = "back_emf"  # back_emf

    # time between torque and motion: delay, lag, rival_delay, rival_lag
    TORQUE_LATE = "torque_late"
    TORQUE_LATE_CORRECTED = "torque_late_corrected"
    TORQUE_SAMPLED = "torque_sampled"
    TORQUE_SAMPLED_CORRECTED = "torque_sampled_corrected"
    ACTS_LATE = "acts_late"

    # treatments of the recordings before a model is fitted
    TORQUE_CONSTANT = "torque_constant"  # torque_constant
    NARROWER_WINDOWS = "narrower_windows"  # share of the length
    WINDOWS_BY_INERTIA = "windows_by_inertia"  # inertia of the model, and that of the base model
    IMPACTS_INCLUDED = "impacts_included"
    RECORDINGS_EXCLUDED = "recordings_excluded"
    TIMED_BESIDE = "timed_beside"
    TIMED_AS_LOGGED = "timed_as_logged"
    BACK_EMF_INCLUDED = "back_emf_included"
    GOALS_HELD = "goals_held"  # gain over goals that run on; the size of an effect that these need
    GOALS_RUN_ON = "goals_run_on"  # gain over held goals; the size of an effect that these need
    CONTROLLER_READ = "controller_read"  # gain over the likeliest other convention; pairs: settings of the drive
    POSITION_READ = "position_read"  # gain over the other reading; pairs: setting of the drive
    COUNTS_UNSEEN = "counts_unseen"  # declared, but the log shows no step of an encoder
    PAYLOAD = "payload"  # mass, x, y, z; of each joint the torque error `.before` and `.after`

    # recordings
    FEEDBACK = "feedback"  # gain
    OUTLIER_RECORDING = "outlier_recording"  # number; of each parameter its value, and `others.` that of the others
    SCALED_TORQUE = "scaled_torque"  # number, factor
    SCALED_INERTIA = "scaled_inertia"  # number, factor
    TURNED_ROUND = "turned_round"  # number
    MISFIT = "misfit"  # number, residual, times
    FEW_STRETCHES = "few_stretches"  # count
    CLOCK_UNEVEN = "clock_uneven"  # std, period
    FILTER_SLOWED = "filter_slowed"  # rate
    ENCODER_COARSE = "encoder_coarse"
    SPEED_RATE_UNKNOWN = "speed_rate_unknown"  # rate, inertia
    TORQUE_SCALED = "torque_scaled"  # factor

    # columns that were read with another sign or zero
    LOAD_TORQUE_TURNED = "load_torque_turned"
    INERTIA_NEGATIVE = "inertia_negative"  # inertia
    ZERO_SHIFTED = "zero_shifted"  # angle
    ZERO_UPRIGHT = "zero_upright"

    # the model
    GRAVITY_BESIDE_SPRING = "gravity_beside_spring"
    FRICTION_NEGATIVE = "friction_negative"
    INCOMPLETE = "incomplete"  # residual in noise floors, disagreement of the schemes in standard errors
    TIED = "tied"
    NOISE_NOT_LOGGED = "noise_not_logged"  # torque of a sample, and the largest RMS of a hidden effect
    STIFF_STOP = "stiff_stop"  # angle, and largest depth
    SCALE_UNKNOWN = "scale_unknown"  # share of the motion that the torque drives
    SMALL_EFFECT = "small_effect"  # explained share, least share, p_value
    ROTORS_MISSING = "rotors_missing"
    PART_OF_TURN = "part_of_a_turn"  # angle that the motion covers
    UNTESTED_RANGE = "untested_range"  # low, high: ends of the motion at which no stop was met

    # unexplained residual of a model
    IMPOSSIBLE = "impossible"  # violated bounds, by name of the gate or the parameter
    TABLE_EXPLAINS = "table_explains"  # nonlinear parameters of the table, by name
    NEAR_REVERSALS = "near_reversals"  # error
    CONTACT = "contact"  # count, and of the largest torque, angle, time
    NOWHERE = "nowhere"  # residual, times
    SERVO_OFF = "servo_off"  # error, times, worst

    # verdicts on effects
    ERRORS_FALL = "errors_fall"  # each kind of error `.before` and `.after`
    ERROR_FALLS_AT_JOINT = "error_falls_at_joint"  # share
    TIES = "ties"
    IMITATES = "imitates"
    IMITATES_TABLE = "imitates_table"  # nonlinear parameters of the table, by name
    NOT_TESTED = "not_tested"  # low, high: ends of the motion at which no stop was met
    NOT_EXCITED = "not_excited"
    ONLY_CONTACTS = "only_contacts"  # angle
    GATE_FAILED = "gate_failed"  # value and `limit.` of each gate
    OTHERS_BETTER = "others_better"
    LONG_STEPS = "long_steps"
    BY_CHANCE = "by_chance"

    # the next step
    TABLE_HELPS = "table_helps"
    NO_EFFECT_OPEN = "no_effect_open"
    FIT_HELD_OUT = "fit_held_out"
    INERTIA_UNKNOWN = "inertia_unknown"
    BEYOND_LIMITS = "beyond_limits"  # torque, angle, speed, place
    CHECK_DRIVE = "check_drive"


class Verdict(StrEnum):
    """Verdict on a candidate effect."""

    SELECTED = "selected"
    AMBIGUOUS = "ambiguous"
    REJECTED = "rejected"
    NOT_EXCITED = "not_excited"


class Obstacle(StrEnum):
    """Reason why an effect is not followed online."""

    HAS_STATE = "depends_on_the_past"
    LOADS_TWO_JOINTS = "loads_two_joints"
    IS_SUDDEN = "happens_at_one_moment"
    JOINT_AT_REST = "joint_has_hardly_moved"
    NO_VARIANT = "has_no_form_here"


# kinds of findings that mark all estimates as biased
BIASING = {Kind.INCOMPLETE, Kind.TORQUE_LATE, Kind.TORQUE_SAMPLED}
# kinds of findings that withhold all parameters, and all that withhold parameters
NOTHING_DETERMINED = {Kind.NO_MOTION, Kind.TORQUE_IS_NOISE, Kind.TORQUE_IS_CONSTANT, Kind.TORQUE_FOLLOWS_DIRECTION}
WITHHOLDING = NOTHING_DETERMINED | {
    *(Kind.ONE_DIRECTION, Kind.SMALL_ANGLES, Kind.NEVER_ACTS, Kind.INDISTINGUISHABLE),
    *(Kind.UNIDENTIFIABLE, Kind.STIFF_STOP),
}


@dataclass(frozen=True)
class Remedy:
    """Settings of columns that read some recordings correctly."""

    columns: Mapping[str, str]  # as in `read_recording`
    recordings: tuple[str, ...]  # names


@dataclass(frozen=True)
class Finding:
    """Finding on data, a model or the next step.

    Attributes:
        kind: kind of the finding.
        numbers: numbers by name, see `Kind`; units are those of torque in N m.
        parameters: names of its parameters.
        effects: ids of its effects or terms; of an indistinguishable pair, the effect and the term of the model.
        recordings: names of its recordings; empty for all.
        joints: names of its joints, for an arm.
        pairs: effects with the indistinguishable term of the model, or None; or settings of a drive with their values.
        remedies: corrections of columns.
    """

    kind: Kind
    numbers: Mapping[str, Quantity] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    recordings: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    pairs: tuple[tuple[str, str | None], ...] = ()
    remedies: tuple[Remedy, ...] = ()

    def __str__(self) -> str:
        return summarise(self)

    @property
    def withheld(self) -> tuple[str, ...]:
        """Return the names of parameters without a meaningful estimate."""
        return self.parameters if self.kind in WITHHOLDING else ()

    @property
    def rivals(self) -> tuple[str, str] | None:
        """Return an effect and the indistinguishable term of the model; None for other findings."""
        return self.effects[:2] if self.kind in (Kind.ONE_DIRECTION, Kind.SMALL_ANGLES) else None  # type: ignore[return-value]

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "kind": str(self.kind),
            "numbers": {name: number.json() for name, number in self.numbers.items()},
            "parameters": [*self.parameters],
            "effects": [*self.effects],
            "recordings": [*self.recordings],
            "joints": [*self.joints],
            "pairs": [[*pair] for pair in self.pairs],
            "remedies": [{"columns": {**r.columns}, "recordings": [*r.recordings]} for r in self.remedies],
        }


def collect_withheld(findings: Iterable[Finding]) -> set[str]:
    """Return the names of all parameters that findings withhold."""
    return {name for finding in findings for name in finding.withheld}


def bias_everything(findings: Iterable[Finding]) -> bool:
    """Return whether one of some findings marks all estimates as biased."""
    return any(finding.kind in BIASING for finding in findings)


def withhold_everything(findings: Iterable[Finding]) -> bool:
    """Return whether one of some findings withholds all parameters."""
    return any(finding.kind in NOTHING_DETERMINED for finding in findings)
