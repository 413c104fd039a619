"""A fleet whose changes are known: which of them a survey finds, and what else it names.

Friction drifts in some joints, an effect sets in at a date in others. Ends with 1 unless all of that is found, and
nothing else.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.survey import GROWTH, HIDDEN, Meter, Plan, cases_of, day, measured, record
from workbench.processes import connected
from workbench.survey import Dataset, Fleet
from workbench.survey.cases import joints
from workbench.terminal import Terminal

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
            *((one.joint.label, f"{one.parameter} drifts") for one in fleet.drifting),
            *((one.joint.label, f"{one.parameter} jumps") for one in fleet.jumping),
            *((one.joint.label, f"{one.effect} is missing") for one in fleet.effects if one.significant),
            *((one.joint.label, f"{one.effect} since {one.since:%Y-%m-%d}") for one in fleet.effects if one.since),
            *((one.joint.label, f"{one.parameter} is odd") for one in fleet.odd),
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
    data, out = folder / "data", folder / "out"
    record(data, plan, rate)
    cases, meter = cases_of(data), Meter()
    terminal.say(f"{len(cases)} recordings of {joints(cases)} joints, {plan.seconds:g} s at {rate:g} Hz")
    with connected(None, workers) as client:
        seconds, tally = measured(client, cases, out, tell=meter)
    judged = Judged.of(Fleet.of(Dataset(out)), plan)
    each = statistics.mean(row["seconds"] for row in Dataset(out).rows(["seconds"]))
    table = [
        ("throughput", f"{60 * tally.new['done'] / seconds:.0f} cases a minute"),
        ("a case, in its worker", f"{each:.2f} s"),
        ("most memory, client / worker", f"{meter.own:.0f} / {meter.worker:.0f} MB"),
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
    return int(judged.told != judged.wanted or bool(judged.false))


if __name__ == "__main__":
    sys.exit(main())
