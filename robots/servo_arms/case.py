"""Case of an arm of servos: each joint is diagnosed as a servo in its loop, while the others move as measured.

Each joint fits its own copy of the parameters of the links. So each joint has a search of its own, that of a servo, and
the results are joined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from estimators.data.fit_data import FitData
from estimators.decisions.errors import Step
from estimators.diagnosis.case import DividedCase, Part
from estimators.diagnosis.result import Diagnosis
from pendulum_env.errors import UserError
from pendulum_env.physics import Model, ModelError, Term, list_ids, list_nameable
from pendulum_env.physics.joints import find_mechanism, list_base_terms
from pendulum_env.recording import Recording
from robots.arms.body import Body, find_body
from robots.arms.recording import ArmRecording
from robots.servo_arms.joining import join_diagnoses, join_steps
from robots.servo_arms.joints import divide_arm
from robots.servo_arms.links import remove_weight
from robots.servo_arms.model import SCHEMA, ServoArmModel

QUICK = (  # effects that a diagnosis tries, if any of them is in the library; others need minutes for each joint
    "stribeck",
    "load_dependent_friction",
    "coulomb_asymmetry",
    "viscous_asymmetry",
    "quadratic_drag",
    "torque_saturation",
    "dead_time",
    "actuator_lag",
    "presliding",
)


class ServoArm(DividedCase):
    """Arms of servos with known controllers, joint by joint, by simulations in the loop."""

    models: ClassVar = {SCHEMA: ServoArmModel.from_json_of_body}

    def prepares(self, recordings: Sequence[Recording]) -> bool:
        """Return whether recordings are of an arm whose joints have drives."""
        return bool(recordings) and len(select_driven_arms(recordings)) == len(recordings)

    def accepts(self, base: Sequence[Term], recordings: Sequence[Recording]) -> bool:
        """Return whether the first term has the links of an arm, and its joints have drives."""
        return isinstance(find_mechanism(base), Body) and self.prepares(recordings)

    def divide(
        self,
        base: Sequence[Term],
        recordings: Sequence[Recording],
        holdout: Sequence[Recording] = (),
        library: Mapping[str, type[Term]] | None = None,
        model: Model | None = None,
    ) -> Mapping[str, Part]:
        """Return the joints as servos with their effects, and with the servos of a model.

        Raises:
            UserError: if a joint is linear, terms without a model are not those of the base, or a model is of torques.
        """
        body = find_body(base)
        if model is None and (added := set(list_ids(base)).difference(list_ids(list_base_terms(body)))):
            raise UserError(
                f"{min(added)} is beside the base terms of an arm of servos: leave it out, or add it to a model"
            )
        if not isinstance(model, ServoArmModel | None):
            raise ModelError("the model is of known torques, the recordings are of servos: identify them for a model")
        known, parts, library = list_nameable(), {}, library or {}
        servos = {} if model is None else model.servos
        arms = select_driven_arms(recordings), select_driven_arms(holdout)
        for joint in divide_arm(body, *arms, servos):
            ids = (_get_effect(kind) for kind in library.values() if kind.at == joint.name)
            kinds = {id: remove_weight(known[id]) for id in ids if id in known}
            parts[joint.name] = Part(joint.recordings, joint.holdout, joint.base, kinds, joint.model)
        return parts

    def select_quick(self, library: Mapping[str, type[Term]]) -> Mapping[str, type[Term]]:
        """Select the quick effects of each joint; all effects of a joint without a quick one."""
        joints = {kind.at for kind in library.values() if _get_effect(kind) in QUICK}
        return {id: kind for id, kind in library.items() if kind.at not in joints or _get_effect(kind) in QUICK}

    def join_diagnoses(self, data: FitData, diagnoses: Mapping[str, Diagnosis]) -> Diagnosis:
        """Join the diagnoses of the joints."""
        return join_diagnoses(data, diagnoses)

    def join_steps(self, model: Model, steps: Mapping[str, Step]) -> Step:
        """Join the steps of some joints to that of a model of the arm."""
        return join_steps(steps, find_body(model.terms), of=model)


def _get_effect(kind: type[Term]) -> str:
    """Return the id of an effect without its joint."""
    return kind.id.partition("@")[0]


def select_driven_arms(recordings: Sequence[Recording]) -> list[ArmRecording]:
    """Select the recordings of arms whose joints have drives."""
    return [one for one in recordings if isinstance(one, ArmRecording) and one.drives]


SERVO_ARM = ServoArm()
