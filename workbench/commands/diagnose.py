"""`diagnose`: which effects does the model lack?"""

import argparse
import math

from estimators.diagnosis.experiment import USUAL
from estimators.diagnosis.run import diagnose
from estimators.selection.criterion import Criterion
from pendulum_env.excitation import MOST_TORQUE
from pendulum_env.files import write_whole
from pendulum_env.reading import LARGE
from workbench.inputs import list_sources, open_sources
from workbench.narrator.diagnosis import write_diagnosis
from workbench.options import LIMITS, READING, ROBOT, add_options, convert_between, convert_number
from workbench.outputs import report_files, write_json, write_model, write_page
from workbench.printing import MORE, print_diagnosis
from workbench.terminal import Terminal

ASKED = "only without fixed bounds max_torque max_angle max_speed horizon".split()  # of a diagnosis, as it is


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, model to start from, and outputs."""
    add_options(
        parser,
        f"""
        recordings --holdout {READING} --drive {ROBOT}
        --model  start from its terms (default: the paper's four; of an arm, friction at each joint)
        --only  look for these effects only; of an arm at every joint, or at one, as stribeck@elbow
        --without {LIMITS} --instruments
        --significance P  largest p-value of the gain of an effect that is added, above 0 and below 1
            (default {Criterion.p_value:g}); a smaller one asks for clearer evidence
        --degrees --verbose
        --all  as --verbose, with every effect, also those that could not be judged
        --max-torque NM  largest torque of a suggested experiment [N m] (default {USUAL:g}, at most ten times the
            largest recorded)
        --max-angle RAD  its largest angle to either side [rad], inf for any (default: as recorded)
        --max-speed RAD/S  its highest speed [rad/s], inf for any (default: as recorded)
        --experiment FILE.csv  write the torque of the suggested experiment
        --horizon S  refit the final model to free motion over S seconds under the recorded torque
        --json FILE  write the diagnosis
        --report
        -o, --output MODEL.json  write the final model
        """,
        pendulums=("max_torque", "max_angle", "max_speed", "experiment", "horizon"),
        significance=(convert_between(0.0, 1.0), Criterion.p_value),
        max_torque=convert_number(0.1, MOST_TORQUE),
        max_angle=convert_number(0.01, math.inf),
        max_speed=convert_number(0.01, math.inf),
        horizon=convert_between(0.0, LARGE),
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Diagnose, print the story, write what is asked for."""
    outputs = [arguments.experiment, arguments.json, arguments.report, arguments.output]
    asked = open_sources(arguments, list_sources(arguments, outputs), terminal)
    given = asked.calibrate(terminal, fixed=arguments.fixed)
    with terminal.progress("diagnosing") as progress:
        found = diagnose(
            given.recordings,
            given.holdout,
            asked.model.terms,
            progress,
            criterion=Criterion(p_value=arguments.significance),
            by_reference=arguments.instruments is not None,
            **{name: getattr(arguments, name) for name in ASKED},
        )
    has_signal = found.suggestion is not None and found.suggestion.signal is not None
    if arguments.experiment is not None and found.suggestion is not None and has_signal:
        write_whole(arguments.experiment, found.suggestion.csv())
    write_json(arguments.json, write_diagnosis(found))
    write_page(arguments.report, terminal, "workbench.report:render", found, arguments.line)
    hint = MORE if arguments.report is None else ""
    print_diagnosis(found, terminal, arguments.verbose or arguments.all, arguments.all, hint)
    if arguments.experiment is not None and not has_signal:
        why = "there is no experiment" if found.suggestion is None else "the experiment has no torque"
        terminal.say(f"{arguments.experiment} is not written: {why}")
        outputs[0] = None
    outputs[-1] = write_model(found.model, arguments.output, terminal)
    report_files(outputs, terminal)
