"""`demo`: a hidden effect found end to end, in a pendulum or in an arm with lengths from a file."""

import argparse
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimators.arms.excitation import design_excitation
from estimators.arms.following import follow
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.run import diagnose
from estimators.progress import Progress
from pendulum_env.arms.body import read_body
from pendulum_env.arms.env import PlanarArm
from pendulum_env.arms.joints import arm_base, joint_effects, parse_effect
from pendulum_env.arms.planar import TWO_LINK, Link, name_joints, write_urdf
from pendulum_env.backends.simulated import TORQUE_NOISE, record
from pendulum_env.excitation import MOST_TORQUE, excitation
from pendulum_env.files import write_whole
from pendulum_env.formatting import join_words
from pendulum_env.physics import BASE, Estimate, Model, Term, effect
from pendulum_env.physics.library import BUILT_IN
from pendulum_env.plant import PAPER, draw_effect
from pendulum_env.recording import Recording, write_recording
from pendulum_env.spaces import MAX_TORQUE
from workbench import options
from workbench.outputs import check_outputs, report_files, write_page
from workbench.printing import print_diagnosis
from workbench.terminal import Terminal

FOLDER = Path("pendulum-ident-demo")  # made where the command runs, unless another place is named
SECONDS = 20.0
SPREAD = 0.25  # of the unknown parameters, to either side
JOINTS = name_joints(len(TWO_LINK))


class HiddenPlant(NamedTuple):
    """A simulated plant with an effect hidden in it."""

    title: str
    effect: str  # what is hidden
    law: str  # of the effect
    truth: Mapping[str, Estimate]  # parameters by name
    terms: Sequence[Term]  # of the model that knows nothing of the effect
    record: Callable[[str, Progress], Recording]  # of a name


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare seed and output."""
    parser.add_argument("--robot", choices=("two-link",), help="an arm instead of a pendulum (needs the extra arms)")
    options.add_seed(parser, "another one hides another effect")
    options.add_verbose(parser)
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
    rng = np.random.default_rng(arguments.seed)
    hidden = make_arm(robots[0], robots[1], rng) if robots else make_pendulum(rng)
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
    print_diagnosis(found, terminal, arguments.verbose, more="")
    options = ["--robot", str(robots[0])] if robots else []
    line = shlex.join(["pendulum-ident", "diagnose", str(files[0]), "--holdout", str(files[1]), *options])
    write_page(str(report), terminal, "workbench.report:render", found, line)
    print_truth(hidden, found, terminal)
    report_files([report, *robots, *files], terminal)
    kind, how = ("pendulum", "") if arguments.robot is None else ("arm", f" --robot {arguments.robot}")
    terminal.say(f"another {kind}: pendulum-ident demo{how} --seed {arguments.seed + 1}")


def make_pendulum(rng: np.random.Generator) -> HiddenPlant:
    """Make a pendulum like the paper's, with one effect of the library hidden in it."""
    theta = np.array(list(PAPER.values())) * rng.uniform(1 - SPREAD, 1 + SPREAD, len(PAPER))
    kind = BUILT_IN[rng.integers(len(BUILT_IN))]
    parameters = draw_effect(kind, rng)
    nonlinear = {
        parameter.name: parameters.pop(parameter.name)
        for parameter in kind.nonlinear_parameters
        if parameter.name in parameters
    }
    plant = Model.build(BASE, theta).add(kind(**nonlinear), np.array(list(parameters.values())))
    return HiddenPlant(
        "A pendulum with unknown parameters, with one effect that the paper's model does not know",
        kind.id,
        effect(kind.id).law,
        plant.estimates,
        BASE,
        lambda name, _: record(plant, excitation("paper", rng, SECONDS), SECONDS, rng=rng, name=name),
    )


def make_arm(robot: Path, truth: Path, rng: np.random.Generator) -> HiddenPlant:
    """Make an arm with a hidden effect; write a file of about that arm, and a file of the true arm."""
    links, hidden = tuple(draw_link(link, rng) for link in TWO_LINK), hide_somewhere(rng)
    write_whole(robot, write_urdf(TWO_LINK, JOINTS))  # right lengths, nominal masses and inertias
    write_whole(truth, write_urdf(links, JOINTS))
    body, true = read_body(robot), read_body(truth)
    arm = PlanarArm(links, effects=hidden, max_torque=MOST_TORQUE, torque_noise=TORQUE_NOISE, velocity="ideal")

    def record(name: str, progress: Progress) -> Recording:
        motion = design_excitation(body, max_torque=MAX_TORQUE, rng=rng)  # less than may be asked for, as of a motor
        return follow(arm, motion, round(SECONDS * arm.rate), MAX_TORQUE, rng=rng, name=name, progress=progress)

    at, title = hidden.partition(":")[0], "An arm of two links, of which a file tells the lengths"
    parameters = {
        one.name: Estimate(value, 0.0, one.unit) for one, value in zip(true.base, true.values.tolist(), strict=True)
    }
    for joint, model in zip(JOINTS, arm.models, strict=True):
        parameters |= {f"{name}@{joint}": own for name, own in model.estimates.items()}
    title = f"{title}, with one unknown effect at a joint"
    return HiddenPlant(title, at, parse_effect(at, JOINTS)[0].law, parameters, arm_base(body), record)


def draw_link(link: Link, rng: np.random.Generator) -> Link:
    """Draw a link of the length in the file, and about its other values."""
    names = ("mass", "center", "inertia", "viscous", "coulomb")
    factors = rng.uniform(1 - SPREAD, 1 + SPREAD, len(names)).tolist()
    return replace(link, **{name: getattr(link, name) * factor for name, factor in zip(names, factors, strict=True)})


def hide_somewhere(rng: np.random.Generator) -> str:
    """Draw an effect at one of the joints, as text: `stribeck@elbow:stribeck=0.4,stribeck_velocity=0.3`."""
    known = [kind for kind in BUILT_IN if kind.id in joint_effects()]
    kind, joint = known[rng.integers(len(known))], JOINTS[int(rng.integers(len(JOINTS)))]
    parameters = ",".join(f"{name}={value:.4g}" for name, value in draw_effect(kind, rng).items())
    return f"{kind.id}@{joint}:{parameters}"


def print_truth(hidden: HiddenPlant, found: Diagnosis, terminal: Terminal) -> None:
    """Print what was hidden, whether it was found, and the true parameters beside the estimates."""
    terminal.heading("The truth")
    terminal.say(f"hidden was {hidden.effect}: {hidden.law}")
    terminal.say(judge_diagnosis([hidden.effect], found))
    truth, estimates = hidden.truth, found.model.estimates
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


def judge_diagnosis(hidden: Sequence[str], found: Diagnosis) -> str:
    """Return whether the diagnosis was right as a sentence."""
    true, named = set(hidden), set(found.selected)
    alike = {effect for group in found.ambiguous if true & set(group) for effect in group} - true
    if true == named:
        return "found" + (f", though {join_words(sorted(alike))} would look the same" if alike else "")
    if len(named) == len(true) and named <= true | alike:
        return f"found as one of a group that looks the same: {join_words(sorted(true | alike))}"
    return f"NOT found as it is: the diagnosis says {join_words(found.selected) or 'nothing'}"
