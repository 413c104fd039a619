"""`demo`: a hidden effect found end to end."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.run import diagnose
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, Model, effect
from pendulum_env.physics.library import BUILT_IN
from pendulum_env.plant import PAPER, draw_effect
from pendulum_env.recording import Recording, write_recording
from pendulum_env.words import listing
from workbench.inputs import check_outputs, take, whole, wrote
from workbench.runs import Hidden
from workbench.story import story
from workbench.terminal import Terminal

FOLDER = Path("pendulum-ident-demo")  # made where the command runs, unless another place is named
SECONDS = 20.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare seed and output."""
    parser.add_argument("--robot", choices=("two-link",), help="an arm instead of a pendulum (needs the extra arms)")
    parser.add_argument("--seed", type=whole(0), default=0, help="another seed hides another effect (default 0)")
    take(parser, "--verbose")
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER/report.html",
        help=f"report to write, with the recordings beside it (default {FOLDER / 'report.html'})",
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Hide an effect, record, diagnose, report, reveal."""
    if arguments.output is None:
        FOLDER.mkdir(exist_ok=True)
    report = Path(arguments.output or FOLDER / "report.html")
    files = [report.with_name(f"{report.stem}.{part}.csv") for part in ("train", "holdout")]
    robots = [report.with_name(f"{report.stem}.{part}.urdf") for part in ("robot", "truth")] if arguments.robot else []
    check_outputs([str(path) for path in (report, *files, *robots)])
    from workbench.report import write_report  # plotly takes a while to import

    rng = np.random.default_rng(arguments.seed)
    if arguments.robot is not None:
        from workbench.arm_demo import hidden_arm  # Pinocchio is imported by who needs it

        hidden = hidden_arm(robots[0], robots[1], rng, SECONDS)
    else:
        hidden = hidden_pendulum(rng)
    terminal.heading(hidden.title)
    recordings = []
    for file in files:
        with terminal.progress(f"recording {file.name}") as progress:
            recordings.append(hidden.record(file.stem, progress))
        write_recording(recordings[-1], file)
    train, holdout = recordings
    terminal.say(f"recorded twice for {SECONDS:g} s: once to learn from, once to check on")
    with terminal.progress("diagnosing") as progress:
        found = diagnose(train, holdout, hidden.terms, progress)
    story(found).tell(terminal, arguments.verbose, more=False)
    with terminal.progress("writing the report"):
        write_report(report, found)
    reveal(hidden, found, terminal)
    wrote([report, *robots, *files], terminal)
    kind, how = ("pendulum", "") if arguments.robot is None else ("arm", f" --robot {arguments.robot}")
    terminal.say(f"another {kind}: pendulum-ident demo{how} --seed {arguments.seed + 1}")


def hidden_pendulum(rng: np.random.Generator) -> Hidden:
    """A pendulum whose parameters nobody told, with one effect hidden in it."""
    plant = draw_plant(rng)
    (hidden,) = plant.effects
    return Hidden(
        "A pendulum whose parameters nobody told, with one effect that the paper's model does not know",
        hidden,
        effect(hidden).law,
        plant.estimates,
        BASE,
        lambda name, _: run_once(plant, rng, name),
    )


def draw_plant(rng: np.random.Generator) -> Model:
    """A pendulum like the paper's, with one effect of the library hidden in it."""
    theta = np.array(list(PAPER.values())) * rng.uniform(0.75, 1.25, len(PAPER))
    kind = BUILT_IN[rng.integers(len(BUILT_IN))]
    parameters = draw_effect(kind, rng)
    shapes = {shape.name: parameters.pop(shape.name) for shape in kind.shapes if shape.name in parameters}
    return Model.build(BASE, theta).add(kind(**shapes), np.array(list(parameters.values())))


def run_once(plant: Model, rng: np.random.Generator, name: str) -> Recording:
    """One recording under the paper's excitation, with new phases each time."""
    return record(plant, excitation("paper", rng, SECONDS), SECONDS, rng=rng, name=name)


def reveal(hidden: Hidden, found: Diagnosis, terminal: Terminal) -> None:
    """Print what was hidden, whether it was found, and the true parameters beside the estimates."""
    terminal.heading("The truth")
    terminal.say(f"hidden was {hidden.effect}: {hidden.law}")
    terminal.say(verdict([hidden.effect], found))
    truth = hidden.truth
    estimates = found.model.estimates
    rows = [
        (
            name,
            f"{truth[name].value:.4g}" if name in truth else "-",
            estimates[name].text if name in estimates else "-",
            (truth.get(name) or estimates[name]).unit,
        )
        for name in dict.fromkeys([*truth, *estimates])
    ]
    terminal.table(("parameter", "truth", "estimate", "unit"), rows, left=("unit",))


def verdict(hidden: Sequence[str], found: Diagnosis) -> str:
    """Whether the diagnosis was right, in a sentence."""
    true, named = set(hidden), set(found.selected)
    alike = {effect for group in found.ambiguous if true & set(group) for effect in group} - true
    if true == named:
        return "found" + (f", though {listing(sorted(alike))} would look the same" if alike else "")
    if len(named) == len(true) and named <= true | alike:
        return f"found as one of a group that looks the same: {listing(sorted(true | alike))}"
    return f"NOT found as it is: the diagnosis says {listing(found.selected) or 'nothing'}"
