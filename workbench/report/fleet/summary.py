"""The fleet in a sentence and three tiles."""

from __future__ import annotations

from workbench.report.section import Section
from workbench.report.words import listing, name
from workbench.survey.fleet import Fleet


def summary(fleet: Fleet) -> Section:
    """What there is to know first."""
    dates = [row["date"] for row in fleet.rows]
    content = {
        "cases": len(fleet.rows),
        "troubled": len(fleet.troubled),
        "joints": len(fleet.joints),
        "robots": len({joint.robot for joint in fleet.joints}),
        "first": min(dates, default=None),
        "last": max(dates, default=None),
        "missing": sorted({one.joint.label for one in fleet.effects if one.sure}),
        "drifting": sorted({joint.label for joint, _ in (*fleet.drifting, *fleet.jumping)}),
        "odd": sorted({one.joint.label for one in fleet.odd}),
        "shared": fleet.shared,
        "seconds": sum(row["seconds"] or 0.0 for row in fleet.rows),
    }
    return Section("fleet", "Fleet", headline(fleet), content)


def headline(fleet: Fleet) -> str:
    """The fleet in one sentence: `2 of 20 joints drift, and Stribeck friction is missing in 1`."""
    total = len(fleet.joints)
    effects = sorted({one.effect for one in fleet.effects if one.sure})
    lacking = {one.joint.label for one in fleet.effects if one.sure}
    parts = []
    if fleet.drifting:
        count = len({joint.label for joint, _ in fleet.drifting})
        parts.append(f"{count} of {total} joints {'drifts' if count == 1 else 'drift'}")
    if fleet.jumping:
        count = len({joint.label for joint, _ in fleet.jumping})
        parts.append(f"{count}{'' if parts else f' of {total} joints'} {'has' if count == 1 else 'have'} jumped")
    if fleet.odd:
        count = len({one.joint.label for one in fleet.odd})
        parts.append(f"{count} {'differs from its' if count == 1 else 'differ from their'} siblings")
    if effects:
        is_or_are = "is" if len(effects) == 1 else "are"
        parts.append(f"{listing([name(id) for id in effects])} {is_or_are} missing in {len(lacking)}")
    if not parts:
        return f"{total} joints, and nothing that stands out" if total else "No case could be diagnosed"
    return listing(parts)[:1].upper() + listing(parts)[1:]
