"""Which effect is missing where, and what is weak in each case but in all of a group."""

from __future__ import annotations

from workbench.report.section import Section
from workbench.survey.fleet import Fleet, Joint, Missing

MOST = 300  # joints in the table; those without an effect are left out first


def missing(fleet: Fleet) -> Section:
    """Joints by effects, and pooled scores."""
    effects = list(dict.fromkeys(one.effect for one in fleet.effects))
    cells: dict[tuple[Joint, str], Missing] = {(one.joint, one.effect): one for one in fleet.effects}
    lacking = {one.joint.label for one in fleet.effects}
    joints = sorted(fleet.joints, key=lambda joint: (joint.label not in lacking, joint.label))[:MOST]
    content = {
        "effects": effects,
        "rows": [(joint, [cells.get((joint, effect)) for effect in effects]) for joint in joints],
        "left_out": len(fleet.joints) - len(joints),
        "shared": fleet.shared,
        "chance": fleet.criterion.chance,
    }
    return Section("missing", "Missing", "What is missing where", content)
