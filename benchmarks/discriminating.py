"""How soon the online diagnosis names a hidden effect under each excitation, also effects no policy was trained on.

python -m benchmarks.discriminating

Every plant is drawn within 30 % and hides one effect, of a fifth to all of its typical size. What counts is the time
from which on the right effect is in the group that is named, and stays there for two seconds, within 20 s.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.baselines import BASELINE, SEPARATING, agent_in_turn
from agents.evaluation import improvement, interval
from agents.network import NAMES, load
from agents.observer import CONSTRAINTS, INPUTS
from agents.structure import PROBES
from agents.verdicts import MOMENTS, Verdicts, judge
from benchmarks.scoring import rate
from pendulum_env.lookup import find
from pendulum_env.policy import Policy, State
from workbench.terminal import Terminal

TRAINED = tuple(
    f"{term.id}:" + ",".join(f"{name}={value:g}" for name, value in term.shape.items()) if term.shape else term.id
    for term in PROBES
)
UNSEEN = ("spring", "viscous_asymmetry", "coulomb_asymmetry", "torque_ripple", "cogging:order=7")
EFFECTS = {"trained on": TRAINED, "not trained on": UNSEEN}
EACH = 4  # plants of each effect
AGENT, IN_TURN, CONVERGING = "agent", "agent for 3 s, then multisine", "agent, to converge"


@dataclass(frozen=True)
class Narrow:
    """A policy that was trained without what an observation tells of the structure."""

    policy: Policy

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, State]:
        return self.policy.predict(observation[:, :INPUTS], state, episode_start, deterministic)


def policies(constraint: str) -> dict[str, Callable[[int], Policy]]:
    """All that are compared, made from a seed."""
    known: dict[str, Callable[[int], Policy]] = {
        BASELINE: lambda seed: SEPARATING[BASELINE](CONSTRAINTS[constraint], seed),
        CONVERGING: lambda _: Narrow(load(constraint)),
    }
    shipped = f"discriminate-{constraint}"
    if shipped in NAMES:
        known[AGENT] = lambda _: load(shipped)
        known[IN_TURN] = lambda _: agent_in_turn(constraint)
    for name, make in SEPARATING.items():
        known.setdefault(name, lambda seed, make=make: make(CONSTRAINTS[constraint], seed))  # type: ignore[misc]
    return known


def compare(constraint: str, kind: str, names: Sequence[str], each: int, seed: int, terminal: Terminal) -> None:
    """All policies on the same plants."""
    known, effects = policies(constraint), EFFECTS[kind]
    found: dict[str, Verdicts] = {}
    for name in names or known:
        policy = find("policy", name, known)(seed)
        with terminal.progress(name) as tell:
            found[name] = judge(
                policy, constraint, effects, each * len(effects), seed=seed, tell=lambda share: tell("", share)
            )
    base = found.get(BASELINE)
    rows = []
    for name, one in found.items():
        shares = [rate(round(share * len(one.time)), len(one.time)) for share in one.shares]
        gain = ""
        if base is not None:
            low, high = interval(improvement, one.time, base.time)
            gain = f"{improvement(one.time, base.time):.2f} ({low:.2f} to {high:.2f})"
        rows.append((name, f"{np.median(one.time):.1f}", gain, *shares, f"{np.median(one.rms):.1f}"))
    terminal.heading(f"Constraint {constraint}, effects {kind}, {each * len(effects)} plants")
    headers = ("policy", "median [s]", f"sooner than {BASELINE}", *(f"right by {m:g} s" for m in MOMENTS), "RMS [N m]")
    terminal.table(headers, rows)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.discriminating", description=__doc__.splitlines()[0])
    parser.add_argument("policies", nargs="*", help="all by default")
    parser.add_argument("--constraint", choices=tuple(CONSTRAINTS), help="both by default")
    parser.add_argument("--each", type=int, default=EACH, help=f"plants of each effect (default {EACH})")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    terminal = Terminal()
    for constraint in [args.constraint] if args.constraint else CONSTRAINTS:
        for kind in EFFECTS:
            compare(constraint, kind, args.policies, args.each, args.seed, terminal)
    return 0


if __name__ == "__main__":
    sys.exit(main())
