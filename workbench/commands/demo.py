"""`demo`: hide an effect in a simulated pendulum, record, diagnose and report."""

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimators import Diagnosis, diagnose
from pendulum_env.backends.simulated import record
from pendulum_env.excitation import excitation
from pendulum_env.formatting import join_words
from pendulum_env.physics import BASE, Model
from pendulum_env.physics.library import BUILT_IN
from pendulum_env.plant import PAPER, draw_effect
from pendulum_env.recording import write_recording
from workbench import options
from workbench.outputs import check_outputs, report_files, write_page
from workbench.printing import print_diagnosis
from workbench.terminal import Terminal

FOLDER = Path("pendulum-ident-demo")  # default folder
SECONDS = 20.0
SPREAD = 0.25  # largest relative change of the paper's parameters


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare seed, level of detail and output."""
    options.declare(parser, "--seed", help="another one hides another effect (default 0)")
    options.add_verbose(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER/report.html",
        help=f"report to write, with the recordings beside it (default {FOLDER / 'report.html'})",
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Hide an effect, record, diagnose, write the report, and print the truth."""
    if arguments.output is None:
        FOLDER.mkdir(exist_ok=True)
    report = Path(arguments.output or FOLDER / "report.html")
    files = [report.with_name(f"{report.stem}.{part}.csv") for part in ("train", "holdout")]
    check_outputs([str(path) for path in (report, *files)])
    rng = np.random.default_rng(arguments.seed)
    plant = draw_plant(rng)
    terminal.print_heading("A pendulum with unknown parameters, with one effect that the paper's model does not know")
    for file in files:
        with terminal.progress(f"recording {file.name}"):
            signal = excitation("paper", rng, SECONDS)
            write_recording(record(plant, signal, SECONDS, rng=rng, name=file.stem), file)
    terminal.print(f"recorded twice for {SECONDS:g} s: once to learn from, once to check on")
    with terminal.progress("diagnosing") as progress:
        diagnosis = diagnose(files[0], files[1], progress=progress)
    print_diagnosis(diagnosis, terminal, arguments.verbose, hint="")
    line = shlex.join(["pendulum-ident", "diagnose", str(files[0]), "--holdout", str(files[1])])
    write_page(str(report), terminal, "workbench.report:render", diagnosis, line)
    print_truth(plant, diagnosis, terminal)
    report_files([report, *files], terminal)
    terminal.print(f"another pendulum: pendulum-ident demo --seed {arguments.seed + 1}")


def draw_plant(rng: np.random.Generator) -> Model:
    """Draw a pendulum like the paper's with one hidden effect of the library."""
    theta = np.array(list(PAPER.values())) * rng.uniform(1 - SPREAD, 1 + SPREAD, len(PAPER))
    kind = BUILT_IN[rng.integers(len(BUILT_IN))]
    parameters = draw_effect(kind, rng)
    nonlinear = {p.name: parameters.pop(p.name) for p in kind.nonlinear_parameters if p.name in parameters}
    return Model.build(BASE, theta).add(kind(**nonlinear), np.array(list(parameters.values())))


def print_truth(plant: Model, diagnosis: Diagnosis, terminal: Terminal) -> None:
    """Print the hidden effect, whether it was found, and true and estimated parameters."""
    hidden = plant.terms[-1]
    terminal.print_heading("The truth")
    terminal.print(f"hidden was {hidden.id}: {type(hidden)().law}")
    terminal.print(judge_diagnosis(hidden.id, diagnosis.selected, diagnosis.ambiguous))
    truth, estimates = plant.estimates, diagnosis.model.estimates
    rows = [
        (
            name,
            f"{truth[name].value:.4g}" if name in truth else "-",
            estimates[name].text if name in estimates else "-",
            (truth.get(name) or estimates[name]).unit,
        )
        for name in dict.fromkeys([*truth, *estimates])
    ]
    terminal.print_table(("parameter", "truth", "estimate", "unit"), rows, left=("unit",))


def judge_diagnosis(hidden: str, selected: Sequence[str], ambiguous: Sequence[Sequence[str]]) -> str:
    """State whether the hidden effect, or an indistinguishable one, was selected."""
    alternatives = sorted({effect for group in ambiguous if hidden in group for effect in group if effect != hidden})
    if list(selected) == [hidden]:
        return "found" + (f", though {join_words(alternatives)} would look the same" if alternatives else "")
    if len(selected) == 1 and selected[0] in alternatives:
        return f"found as one of a group that looks the same: {join_words(sorted([hidden, *alternatives]))}"
    return f"NOT found as it is: the diagnosis says {join_words(list(selected)) or 'nothing'}"
