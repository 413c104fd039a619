"""Outcomes of retellings: `diagnose` runs, printed remedies are followed, and the result is compared with the truth."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
import tempfile
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.retold.kinds import draw_scenario
from benchmarks.retold.scenario import Scenario
from workbench.cli import main as run_command

MOST = 4.0  # standard errors
LEAST_ERROR = 2e-4  # of a parameter; smaller deviations are right, whatever the standard error
MOST_REMEDIES = 4
LOOKS_ALIKE = (  # effects that a single recording cannot distinguish
    frozenset({"torque_offset", "coulomb_asymmetry"}),
    frozenset({"spring", "gravity_tilt"}),
)
OUTCOMES = ("right", "asked", "declined", "wrong")
REMEDY = re.compile(r"--(?:columns|fix|bound|align|unwrap)\b(?: (?:\"[^\"]+\"|'[^']+'|\S+[^\s,;:.]))?")


Judgement = tuple[str, str, float, str]  # outcome, names, largest deviation [standard errors], its parameter


@dataclass(frozen=True)
class Outcome:
    """Outcome of one retelling, with what was named and the largest deviation [standard errors]."""

    number: int
    row: str
    motion: str
    kind: str
    hidden: str
    outcome: str
    named: str
    z: float
    parameter: str
    remedies: str


@dataclass(frozen=True)
class _Answer:
    """Answer of `diagnose`: printed text, and its JSON; none after a refusal."""

    text: str
    found: dict[str, Any] | None


def judge_number(
    number: int, seed: int, kind: str | None = None, row: str | None = None, motion: str | None = None
) -> Outcome:
    """Draw a retelling, run `diagnose` on it, follow its printed remedies, and judge the outcome."""
    scenario = draw_scenario(seed, number, kind, row, motion)
    with tempfile.TemporaryDirectory() as folder:

        def judge(arguments: Sequence[str]) -> tuple[_Answer, Judgement]:
            answer = _diagnose(arguments, Path(folder))
            return answer, _judge(answer, scenario)

        arguments = scenario.write(Path(folder))
        answer, first = judge(arguments)
        outcome, shown, tried = first[0], first, list[str]()
        waiting = [(remedy, arguments) for remedy in list_remedies(answer.text, arguments)]
        while outcome not in ("right", "asked") and waiting and len(tried) < MOST_REMEDIES:
            remedy, arguments = waiting.pop(0)
            tried.append(" ".join(remedy))
            arguments = _join_options(arguments, remedy)
            answer, judgement = judge(arguments)
            waiting += [(remedy, arguments) for remedy in list_remedies(answer.text, arguments)]
            if judgement[0] == "right":
                outcome, shown = "asked", judgement
    if outcome == "declined" and not scenario.may_decline():
        outcome, shown = "wrong", (*shown[:1], f"too cautious: {shown[1]}", *shown[2:])
    hidden = "+".join(scenario.hidden) or "nothing"
    return Outcome(number, scenario.row, scenario.motion, scenario.kind, hidden, outcome, *shown[1:], "; ".join(tried))


def _diagnose(arguments: Sequence[str], folder: Path) -> _Answer:
    out, errors, text = folder / "out.json", io.StringIO(), io.StringIO()
    out.unlink(missing_ok=True)
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(errors):
        try:
            code = run_command(["diagnose", *arguments, "--json", str(out)])
        except Exception:
            return _Answer(f"TRACEBACK {traceback.format_exc(limit=-3)}", None)
    printed = " ".join((text.getvalue() + "\n" + errors.getvalue()).split())
    return _Answer(printed, json.loads(out.read_text(encoding="utf-8")) if code == 0 else None)


def list_remedies(text: str, options: Sequence[str]) -> list[list[str]]:
    """List the options in a text that were not given yet."""
    remedies = list[list[str]]()
    for match in REMEDY.finditer(text):
        words = shlex.split(match.group().replace("'", '"'))
        value = words[1] if len(words) > 1 else ""
        if words[0] in ("--align", "--unwrap"):
            words, value = words[:1], ""
        elif "=" not in value or re.search(r"\b(VALUE|LOW|HIGH|NAME|NUMBER|COLUMN)\b|\.\.\.|\?", value):
            continue
        is_given = words[0] in options and (not value or value in " ".join(options))
        if not is_given and words not in remedies:
            remedies.append(words)
    return remedies


def _join_options(options: Sequence[str], remedy: Sequence[str]) -> list[str]:
    """Return the options with a remedy; columns are one option, in which a new quantity replaces the old one."""
    if remedy[0] != "--columns" or "--columns" not in options:
        return [*options, *remedy]
    joined, at = list(options), list(options).index("--columns") + 1
    parts = dict(part.split("=", 1) for part in joined[at].split(","))
    parts |= dict(part.split("=", 1) for part in remedy[1].split(","))
    joined[at] = ",".join(f"{name}={text}" for name, text in parts.items())
    return joined


def _judge(answer: _Answer, scenario: Scenario) -> Judgement:
    """Return outcome, names, largest deviation and its parameter."""
    found = answer.found
    if found is None:
        return ("wrong" if "TRACEBACK" in answer.text else "declined", f"refused: {answer.text[-260:]}", np.nan, "")
    selected, is_left = tuple(found["selected"]), found["unexplained"]["present"]
    groups = {group[0]: tuple(group) for group in found["ambiguous"]}
    named = ["|".join(groups.get(id, (id,))) for id in selected] or ["nothing"]
    named += [f"table {id}" for id in found["tables"]] + ["unexplained"] * is_left
    families = [finding["family"] for finding in found["findings"]]
    named += [family for family in families if family in ("disagreement", "incomplete")]
    is_named = _is_hidden(selected, groups, scenario.hidden) and not found["tables"]
    z, worst, is_lost = _compare(found["steps"][-1]["theta"], scenario.truth)
    if is_left or "disagreement" in families or "incomplete" in families or abs(z) > MOST:
        return "wrong", ", ".join(named), z, worst
    if is_named and not is_lost:
        return "right", ", ".join(named), z, worst
    if not is_named and (selected or found["tables"]):
        return "wrong", ", ".join(named), z, worst
    return "declined", ", ".join([*named, *(f"no {name}" for name in is_lost)]), z, worst


def _is_hidden(selected: tuple[str, ...], groups: Mapping[str, tuple[str, ...]], hidden: tuple[str, ...]) -> bool:
    """Return whether the hidden effects are selected, in groups of effects that look alike."""
    if len(selected) != len(hidden):
        return False
    for id, true in zip(sorted(selected), sorted(hidden), strict=True):
        if true not in groups.get(id, (id,)) and frozenset({id, true}) not in LOOKS_ALIKE:
            return False
    return True


def _compare(theta: Mapping[str, Any], truth: Mapping[str, float]) -> tuple[float, str, list[str]]:
    """Return the largest deviation [standard errors], its parameter, and parameters without a value."""
    deviations, lost = {}, []
    for name, value in truth.items():
        own = theta.get(name)
        if own is None or own["value"] is None or own.get("biased"):
            lost.append(name)
            continue
        off = own["value"] - value
        if abs(off) < LEAST_ERROR * abs(value):
            deviations[name] = 0.0
        elif own["std"]:
            deviations[name] = off / own["std"]
        else:
            lost.append(name)
    worst = max(deviations, key=lambda name: abs(deviations[name]), default="")
    return deviations.get(worst, np.nan), worst, lost
