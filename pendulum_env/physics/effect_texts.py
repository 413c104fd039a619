"""Texts on built-in effects and base terms; users' effects have a `Description` or only an id."""

import re
from collections.abc import Iterable

from pendulum_env.formatting import join_words
from pendulum_env.physics.description import DESCRIPTIONS, Description

NAMES = {  # names of schemes that differ from their id
    "filtered_hamiltonian": "filtered Hamiltonian",
    "hamiltonian": "Hamiltonian",
}

# id, joint behind it or at the end, and name of a parameter within its effect
PARAMETER = re.compile(r"(?P<id>\w+)(@(?P<joint>[^.]+))?(\.(?P<own>\w+))?(@(?P<last>.+))?")


def find_description(effect: str) -> Description:
    """Return the texts on an effect, perhaps at a joint; default texts if it has none."""
    id = effect.partition("@")[0]
    return DESCRIPTIONS.get(id) or EFFECTS.get(id) or Description()


def find_look_alikes(id: str) -> list[str]:
    """List the ids of similar terms, named by this effect or naming it."""
    named = find_description(id).resembles
    others = [other for other, description in (EFFECTS | DESCRIPTIONS).items() if id in description.resembles]
    return [*named, *(other for other in others if other not in named)]


def name_effect(effect: str) -> str:
    """Return the name of an effect in a sentence: `Stribeck friction`, `Stribeck friction at elbow`."""
    id, at, joint = effect.partition("@")
    title = find_description(id).title or NAMES.get(id, id.replace("_", " "))
    return f"{title} at {joint}" if at else title


def name_effects(effects: Iterable[str], conjunction: str = "and") -> str:
    """Join the names of effects to a list in words."""
    return join_words([name_effect(effect) for effect in effects], conjunction)


def name_parameter(name: str) -> str:
    """Return the name of a parameter in a sentence: `Stribeck velocity`, `cogging torque: order`."""
    parts = PARAMETER.fullmatch(name)
    if parts is None or not parts["own"] or parts["id"] not in EFFECTS | DESCRIPTIONS:
        return name_effect(name)
    id, own, joint = parts["id"], parts["own"].replace("_", " "), parts["joint"] or parts["last"]
    if own.startswith("stribeck"):
        own = own.capitalize()
    elif not own.startswith(id.replace("_", " ")):
        own = f"{name_effect(id).removeprefix('a ')}: {own}"
    return f"{own} at {joint}" if joint else own


EFFECTS: dict[str, Description] = {
    "inertia": Description(informative_experiment="faster reversals"),
    "gravity": Description(informative_experiment="swings beyond 30 degrees"),
    "viscous": Description(title="viscous friction", informative_experiment="a range of speeds"),
    "coulomb": Description(title="Coulomb friction", informative_experiment="motion in both directions"),
    "torque_offset": Description(
        title="a torque offset",
        symptom="the same torque everywhere",
        signature="At every angle and speed, the joint needs the same torque more, or less, than the model says.",
        resembles=("coulomb_asymmetry", "gravity_tilt"),
        informative_experiment="motion in both directions",
    ),
    "torque_ripple": Description(
        symptom="waves over the angle",
        signature="The residual is a wave over the angle, as of cogging, that grows with the torque and has its sign.",
        resembles=("cogging", "position_dependent_friction"),
        informative_experiment="full turns under high torque",
    ),
    "torque_saturation": Description(
        symptom="a curve over the torque",
        signature=(
            "The joint gets less than the requested torque. The model is right for small torques, and has too much "
            "torque at the peaks of either sign."
        ),
        resembles=("quadratic_drag", "load_dependent_friction"),
        informative_experiment="torque peaks well above the usual ones",
    ),
    "actuator_lag": Description(
        symptom="torque that comes late",
        signature=(
            "The residual follows each change of torque in the same way, and fades within a time constant. It is zero "
            "while torque is steady."
        ),
        resembles=("dead_time", "joint_flexibility"),
        informative_experiment="fast changes of torque",
    ),
    "dead_time": Description(
        title="dead time of the torque",
        symptom="torque that comes late",
        signature=(
            "After a step of torque, the joint moves on unchanged for a moment. The residual is the step, for that "
            "time."
        ),
        resembles=("actuator_lag", "joint_flexibility"),
        informative_experiment="steps of torque",
    ),
    "back_emf": Description(informative_experiment="motion with the motor on and off"),
    "rotor": Description(
        title="inertia of the rotor", resembles=("coupling",), informative_experiment="fast accelerations of the joint"
    ),
    "coupling": Description(informative_experiment="motion of either joint without the other, and of both"),
    "coulomb_asymmetry": Description(
        title="Coulomb friction that differs by direction",
        symptom="the same torque everywhere",
        signature=(
            "Dry friction forwards and backwards differs by the same amount at any speed. The residual is a constant."
        ),
        resembles=("torque_offset", "gravity_tilt", "viscous_asymmetry"),
        informative_experiment=(
            "the motor mounted the other way round, as an offset then changes its sign and friction does not"
        ),
    ),
    "viscous_asymmetry": Description(
        title="viscous friction that differs by direction",
        symptom="a curve over the speed",
        signature=(
            "The residual over speed is a V: it grows with the speed, with the same sign forwards and backwards."
        ),
        resembles=("coulomb_asymmetry", "encoder_eccentricity"),
        informative_experiment="fast motion in both directions",
        fits_friction=True,
    ),
    "stribeck": Description(
        title="Stribeck friction",
        symptom="a peak around standstill",
        signature=(
            "Friction has a peak on either side of standstill, which falls off within a small part of the speeds. "
            "Slow motion stutters."
        ),
        resembles=("presliding", "backlash"),
        informative_experiment="slow motion, around and below the Stribeck velocity",
        fits_friction=True,
    ),
    "quadratic_drag": Description(
        symptom="a curve over the speed",
        signature=(
            "Friction over speed curves upwards: the model has too little at high speeds and too much at middle ones."
        ),
        resembles=("viscous", "torque_saturation"),
        informative_experiment="a wide range of speeds",
        fits_friction=True,
    ),
    "load_dependent_friction": Description(
        symptom="a curve over the torque",
        signature=(
            "Friction is larger under a large torque of the motor or the weight. At one speed, two torques give two "
            "frictions."
        ),
        resembles=("position_dependent_friction", "torque_saturation"),
        informative_experiment="the same speeds under different torques",
    ),
    "position_dependent_friction": Description(
        symptom="waves over the angle",
        signature=(
            "In each direction alone, the residual over the angle is a sine, with opposite signs. Where both "
            "directions are equally frequent, its mean is zero."
        ),
        resembles=("load_dependent_friction", "torque_ripple"),
        informative_experiment="full turns in both directions",
    ),
    "temperature_dependent_friction": Description(
        signature="Friction is larger or smaller when the joint is warm, in any motion and at any time.",
        resembles=("friction_drift",),
        informative_experiment="a recording that warms the joint up, with a column of its temperature",
        omission="friction is that at 25 deg C",
    ),
    "presliding": Description(
        symptom="a peak around standstill",
        signature=(
            "At each reversal, friction changes its sign over a small angle instead of at once (Dahl, LuGre). The "
            "residual has a short peak after each reversal, with the sign of the motion before it."
        ),
        resembles=("stribeck", "backlash", "joint_flexibility"),
        informative_experiment="many small reversals",
        omission="friction slips at once",
    ),
    "gravity_tilt": Description(
        title="tilted gravity",
        symptom="a curve over the angle",
        signature="The residual over the angle is a cosine: largest where the rod hangs, and zero where it is level.",
        resembles=("torque_offset", "coulomb_asymmetry", "spring", "encoder_eccentricity"),
        informative_experiment="swings beyond 30 degrees, to tell it from a constant",
    ),
    "cogging": Description(
        title="cogging torque",
        symptom="waves over the angle",
        signature=(
            "The residual is a wave over the angle with a whole number of periods in a turn. It is the same in both "
            "directions and under any torque."
        ),
        resembles=("torque_ripple", "periodic_disturbance"),
        informative_experiment="slow full turns",
    ),
    "spring": Description(
        title="a spring",
        symptom="a curve over the angle",
        signature=(
            "The residual over the angle is a line. It goes on where gravity turns back, and over several turns."
        ),
        resembles=("gravity", "gravity_tilt", "hard_stop"),
        informative_experiment="swings beyond 60 degrees or several turns, to tell it from gravity",
    ),
    "hard_stop": Description(
        title="a hard stop",
        symptom="a curve over the angle",
        signature=(
            "The residual is zero over most of the range, and steep beyond one angle or two, where the motion bounces."
        ),
        resembles=("spring",),
        informative_experiment="motion up to both ends of the range",
    ),
    "encoder_eccentricity": Description(
        symptom="a curve over the angle",
        signature=(
            "The measured angle is too large and too small once or twice a turn. The residual has one or two cycles a "
            "turn and grows with the square of the speed."
        ),
        resembles=("gravity_tilt", "viscous_asymmetry"),
        informative_experiment="full turns at high speed",
    ),
    "torque_by_angle": Description(title="a torque that varies with the angle", informative_experiment=""),
    "friction_by_angle": Description(title="dry friction that varies with the angle", informative_experiment=""),
    "friction_by_speed": Description(title="friction that varies with the speed", informative_experiment=""),
    "torque_by_time": Description(title="a torque that wanders with time", informative_experiment=""),
    "gain_by_time": Description(title="a motor gain that wanders with time", informative_experiment=""),
    "friction_drift": Description(
        title="friction that drifts with time",
        symptom="a change in time",
        signature=(
            "Friction falls from the beginning of the recording on, fast at first. The residual opposes the motion "
            "at its start and helps it at its end."
        ),
        resembles=("payload_change",),
        informative_experiment="a recording from cold that lasts several warm-up times",
        omission="friction is that of a warm joint",
    ),
    "payload_change": Description(
        title="a payload change",
        symptom="a change in time",
        signature=(
            "From one moment on, the joint has another load. A residual as of a wrong weight and inertia begins, or "
            "ends, within one sample."
        ),
        resembles=("friction_drift",),
        informative_experiment="a recording that spans the change",
        omission="the payload is that before the change",
    ),
    "periodic_disturbance": Description(
        title="a periodic disturbance",
        symptom="a change in time",
        signature=("The residual is a sine of time in any motion and at rest: one sharp peak in its spectrum."),
        resembles=("cogging",),
        informative_experiment="a recording of many periods",
    ),
    "joint_flexibility": Description(
        symptom="knocks and ringing",
        signature=(
            "After fast changes, the residual rings at one frequency. Above it, the inertia is smaller than below."
        ),
        resembles=("backlash", "actuator_lag", "dead_time", "presliding"),
        informative_experiment="excitation around the resonance",
    ),
    "backlash": Description(
        symptom="knocks and ringing",
        signature=(
            "After a reversal of the load, the motor turns freely by a small angle, then hits the link. The residual "
            "has short peaks, always near the same load."
        ),
        resembles=("joint_flexibility", "presliding", "stribeck"),
        informative_experiment="many reversals under changing load",
    ),
}
