"""Texts of findings on servos."""

from estimators.texts import FindingTexts
from pendulum_env.formatting import measure
from pendulum_env.physics.effect_texts import name_effect
from pendulum_env.quantity import Quantity
from robots.servos.back_emf import BACK_EMF_INCLUDED
from robots.servos.conclusion import DoubtfulDrive, ResultOfLongSteps, ScaledTorque, UnknownSpeedRate
from robots.servos.in_loop.conventions import ControllerConvention, GoalConvention, UnseenCounts
from robots.servos.rest import RestBand


def _describe_goals(finding: GoalConvention) -> str:
    reading, alternative, setting = "running on between rows", "that are held from row to row", 'goal = "held"'
    if finding.is_held:
        reading, alternative, setting = "held from row to row", "that run on between rows", 'goal = "ramp"'
    if finding.gain is None:  # decided by the selected effects
        return f"Goals are read as {reading}. Goals {alternative} predict worse."
    late = [f" with {name_effect(id)} of {1000 * size.value:.1f} ms" for id, size in finding.lateness.items()]
    fit = _compare_fits(finding.gain, f"The other reading, goals {alternative}{''.join(late)},")
    return f"Goals are read as {reading}. {fit} If it is right, give `{setting}` in `[drive]`."


def _describe_controller(finding: ControllerConvention) -> str:
    if finding.is_of_position:
        readings = {"counts": "whole counts of its encoder", "exact": "the exact position"}
        reading = readings.pop(finding.settings["reads"])
        fit = _compare_fits(finding.gain, f"The other reading, {next(iter(readings.values()))},")
        return f"The controller is simulated with {reading}. {fit} Give the right one: `reads` in `[drive]`."
    settings = ", ".join(f'`{name} = "{value}"`' for name, value in finding.settings.items())
    fit = _compare_fits(finding.gain, "The likeliest other convention")
    return f"The controller is simulated with {settings}. {fit} Give the right one in `[drive]`."


def _describe_rest(finding: RestBand) -> str:
    parts = f"{measure(finding.friction, 2)} of dry friction and {measure(finding.weight, 2)} of weight"
    return (
        f"At its present gain the joint rests within {measure(finding.distance, 2)} of its goal: {parts} over the "
        f"stiffness. A gain {finding.factor:.2g} times as large brings it within 1 degree; to feed the weight forward "
        "leaves the friction alone."
    )


def _compare_fits(gain: Quantity, alternative: str) -> str:
    """State whether another convention fits worse; `gain`: of the chosen one [nat], with standard error."""
    times = gain.value / max(gain.std or 0.0, 1e-9)
    if times > 2:
        return f"{alternative} fits worse, by {times:.1f} standard errors."
    difference = f"the difference is {abs(times):.1f} standard errors"
    return f"{alternative} fits about as well: {difference}. The log does not decide."


TEXTS = FindingTexts(
    {
        BACK_EMF_INCLUDED: "The base model has back-EMF.",
        GoalConvention: _describe_goals,
        ControllerConvention: _describe_controller,
        UnknownSpeedRate: (
            "If the drive computes its speed from two readings of its encoder, give the rate of the readings (`rate`). "
            "At {rate.value:g} readings a second, the inertia is {inertia:2} larger than stated here."
        ),
        ScaledTorque: (
            "The logged torque is {factor:.2f} times the torque that the described drive asks for, and all "
            "parameters are by the drive. Check its gains and limit, and the unit of the torque column."
        ),
        RestBand: _describe_rest,
        DoubtfulDrive: (
            "No effect that was tried explains the residual. Check the drive: kp, kd and ki in the units of `output`, "
            "`limit`, `supply`, `rate`, `delay`, and how it integrates and differentiates. Then record under "
            "more gains."
        ),
        UnseenCounts: (
            "The log shows no step of an encoder: the controller is simulated with the exact position, though its "
            'drive has `reads = "counts"`. Log the position as the encoder counts it, without a filter.'
        ),
        ResultOfLongSteps: "with shorter steps of the integrator it predicts no better, or explains too little",
    }
)
