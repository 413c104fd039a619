"""The payload of an arm in tables."""

from estimators.arms import Payload
from pendulum_env.arms import Body
from pendulum_env.formatting import TextTable, join_words
from pendulum_env.recording import NEWTON_METRE
from workbench.narrator.parts import Part


def narrate_payload(found: Payload, body: Body) -> list[Part]:
    """Describe the payload of an arm, and its effect on the errors."""
    rows = [(name, one.text, one.unit) for name, one in found.estimates.items()]
    rows += [(f"centre {axis}", one.text, one.unit) for axis, one in found.center.items()]
    content: list[TextTable | str] = [TextTable(("parameter", "estimate", "unit"), rows, left=("unit",))]
    if found.hidden:
        content.append(f"{join_words(found.hidden)}: no motion of the joints shows them")
    if found.exists is False:
        content.append(
            "No body has the moments of the best fit, so those of the nearest body are shown: something else changed "
            "as well, or the motion says too little."
        )
    left = [
        (at, f"{old:.4g}", f"{new:.4g}", body.units(at).unit(NEWTON_METRE))
        for at, (old, new) in found.torque_rms.items()
    ]
    explained = TextTable(("joint", "without payload", "with it", "unit"), left, left=("unit",))
    return [
        Part(f"Payload at the link behind {found.joint}, in that joint's frame", content),
        Part("Torque errors, friction refitted", [explained]),
    ]
