"""A fleet whose changes are known: which of them a survey finds and what else it names, killed twice on the way.

Friction drifts in some joints, an effect sets in at a date in others. The survey that was killed must come to what an
uninterrupted one finds of every fifth recording, and of those that were at hand when it was killed: a case knows of no
other. A later one must do what is new and no more. Ends with 1 unless all of that is so.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.survey import COMPARED, GROWTH, HIDDEN, Meter, Plan, cases_of, day, killed, measured, record
from workbench.survey import Dataset, Fleet
from workbench.survey.cases import joints
from workbench.survey.cluster import connected
from workbench.terminal import Terminal

NEW = 10  # recordings that come later
EVERY = 5  # recordings of which one is surveyed without interruption, too
NEAR = 5  # cases before and after a kill that are so, too

Finding = tuple[str, str]  # joint or group of them, and what is said of it


@dataclass(frozen=True)
class Judged:
    """What a survey says of a fleet beside what is true.

    Attributes:
        wanted: what is true: parameters that drift, effects, and dates from which they are there.
        told: what was found of that.
        false: what was named and is not so.
    """

    wanted: frozenset[Finding]
    told: frozenset[Finding]
    false: frozenset[Finding]

    @classmethod
    def of(cls, fleet: Fleet, plan: Plan) -> Judged:
        """Judge a fleet by its plan.

        That a joint of growing friction differs in it from its siblings is true. So is that an effect which is in half
        of a joint's cases shows in those that do not name it, and in the sums over the joint's kind and over all.
        """
        label = [" / ".join(plan.label(joint)) for joint in range(plan.joints)]
        growing, broken = label[: plan.drifting], label[plan.joints - plan.broken :]
        since = f"{day(plan.weeks // 2):%Y-%m-%d}"
        drifts = {(name, "coulomb drifts") for name in growing}
        begins = {(name, f"stribeck {what}") for name in broken for what in ("is missing", f"since {since}")}
        groups = {*broken, "all joints", *(f"all {name.rpartition(' / ')[2]}" for name in broken)}
        named = {
            *((joint.label, f"{series.parameter} drifts") for joint, series in fleet.drifting),
            *((joint.label, f"{series.parameter} jumps") for joint, series in fleet.jumping),
            *((one.joint.label, f"{one.effect} is missing") for one in fleet.effects if one.sure),
            *((one.joint.label, f"{one.effect} since {one.since:%Y-%m-%d}") for one in fleet.effects if one.since),
            *((one.joint.label, f"{one.series.parameter} is odd") for one in fleet.odd),
            *((one.group, f"{one.effect} is weak in each") for one in fleet.shared),
        }  # fmt: skip
        wanted = drifts | begins
        also = {(one, "coulomb is odd") for one in growing} | {(one, "stribeck is weak in each") for one in groups}
        return cls(frozenset(wanted), frozenset(wanted & named), frozenset(named - wanted - also))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=1000, help="recordings (default 1000)")
    parser.add_argument("--joints", type=int, default=20, help="of which a quarter drifts (default 20)")
    parser.add_argument("--broken", type=int, default=3, help="joints in which an effect sets in (default 3)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each (default 10)")
    parser.add_argument("--rate", type=float, default=200.0, help="of each [Hz] (default 200)")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args(argv)
    weeks = arguments.n // arguments.joints
    if weeks < 4:  # no parameter drifts before
        parser.error(f"{arguments.n} recordings of {arguments.joints} joints are too few: there are to be four of each")
    growth = GROWTH / (weeks - 1)
    plan = Plan(arguments.joints, weeks, arguments.joints // 4, arguments.broken, arguments.seconds, growth)
    with tempfile.TemporaryDirectory() as name:
        return _run(Path(name), plan, arguments.rate, arguments.workers, Terminal())


def _run(folder: Path, plan: Plan, rate: float, workers: int, terminal: Terminal) -> int:
    data, whole, broken = folder / "data", folder / "whole", folder / "broken"
    record(data, plan, rate)
    cases = cases_of(data)
    count = len(cases)
    terminal.say(f"{count} recordings of {joints(cases)} joints, {plan.seconds:g} s at {rate:g} Hz")
    command = [sys.executable, "-m", "workbench.cli", "survey", str(data), "-o", str(broken), "--workers", str(workers)]
    stops = [killed(command, broken, share * count // 3) for share in (1, 2)]
    with connected(None, workers) as client:
        _, resumed = measured(client, cases, broken)
        judged = Judged.of(Fleet.of(Dataset(broken)), plan)
        near = {k for rows, _ in stops for k in range(rows - NEAR, rows + NEAR)}
        some = [case for k, case in enumerate(cases) if k % EVERY == 0 or k in near]
        meter = Meter()
        seconds, tally = measured(client, some, whole, tell=meter)
        found = {row["name"]: row for row in Dataset(broken).rows(COMPARED)}
        same = sorted(found) == [case.name for case in cases] and all(
            found[row["name"]] == row for row in Dataset(whole).rows(COMPARED)
        )
        each = statistics.mean(row["seconds"] for row in Dataset(broken).rows(["seconds"]))
        record(data, plan, rate, [(k % plan.joints, plan.weeks + k // plan.joints) for k in range(NEW)])
        _, more = measured(client, cases_of(data), broken)

    table = [
        ("throughput", f"{60 * tally.done / seconds:.0f} cases a minute"),
        ("a case, in its worker", f"{each:.2f} s"),
        ("most memory, client / worker", f"{meter.own:.0f} / {meter.worker:.0f} MB"),
        *(("killed", f"with {rows} of {count} written, {orphans} processes left behind") for rows, orphans in stops),
        ("then gone on with", f"{resumed.done} done, {resumed.unchanged} known"),
        ("without interruption", f"{tally.done} done; result the same: {same}"),
        (f"{NEW} more files", f"{more.done} done, {more.unchanged} known"),
    ]
    terminal.table(("what", "measured"), table, left=("measured",))
    terminal.heading("Found")
    terminal.say(
        f"hidden: dry friction grows by {100 * GROWTH:g} % over all weeks in {plan.drifting} joints; Stribeck friction "
        f"of {HIDDEN:g} N m sets in on {day(plan.weeks // 2):%Y-%m-%d} in {plan.broken}"
    )
    terminal.say(f"{len(judged.told)} of {len(judged.wanted)} found, {len(judged.false)} false alarms")
    for what, findings in (("not found", judged.wanted - judged.told), ("false alarm", judged.false)):
        for finding in sorted(findings):
            terminal.say(f"{what}: {' '.join(finding)}")
    as_promised = same and not any(orphans for _, orphans in stops) and (more.done, more.unchanged) == (NEW, count)
    return int(not as_promised or judged.told != judged.wanted or bool(judged.false))


if __name__ == "__main__":
    sys.exit(main())
