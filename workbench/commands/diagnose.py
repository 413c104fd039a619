"""`diagnose`: find the effects that a model lacks."""

import argparse
import math

from estimators.decisions.criterion import Criterion
from estimators.diagnosis.experiment import DEFAULT_TORQUE
from estimators.diagnosis.run import diagnose
from pendulum_env.excitation import LARGEST_TORQUE
from pendulum_env.files import write_whole
from workbench import options
from workbench.inputs import list_sources, open_sources
from workbench.narrator.diagnosis import write_diagnosis
from workbench.outputs import report_files, write_json, write_model, write_page
from workbench.printing import MORE, print_diagnosis
from workbench.terminal import Terminal

ASKED = "only without fixed bounds max_torque max_angle max_speed horizon".split()  # options passed on to `diagnose`
PAUSE = 10.0  # [s], least time between two lines of progress in a pipe


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, initial model, options of the search, and outputs."""
    options.declare(parser, "recordings", *options.READING, "--holdout", "--drive", *options.SEARCH, *options.LIMITS)
    parser.add_argument(
        "--significance",
        metavar="P",
        type=options.convert_number(1e-9, 0.5),
        default=Criterion().p_value,
        help="largest p-value of the gain of an effect that is added "
        f"(default {Criterion().p_value:g}); a smaller one asks for clearer evidence",
    )
    parser.add_argument(
        "--block",
        metavar="SECONDS",
        type=options.convert_number(0.1, 60.0),
        default=Criterion().block,
        help="length of the blocks of time by which models are scored (default %(default)g); longer blocks suit "
        "residuals that are correlated for longer",
    )
    parser.add_argument(
        "--horizon",
        type=options.convert_number(1e-3),
        help="refit the final model to free motion over so many seconds under the recorded torque",
    )
    options.declare(parser, "--degrees")
    options.add_verbose(parser)
    options.add_json(parser, "write the diagnosis")
    options.declare(parser, "--report")
    parser.add_argument("-o", "--output", metavar="MODEL.json", help="write the final model")
    group = parser.add_argument_group("the next experiment")
    group.add_argument(
        "--max-torque",
        type=options.convert_number(0.1, LARGEST_TORQUE),
        help=f"its largest torque [N m] (default {DEFAULT_TORQUE:g}, at most ten times the largest recorded)",
    )
    group.add_argument(
        "--max-angle",
        type=options.convert_number(0.01, math.inf),
        help="its largest angle to either side [rad], inf for any (default: as recorded)",
    )
    group.add_argument(
        "--max-speed",
        type=options.convert_number(0.01, math.inf),
        help="its highest speed [rad/s], inf for any (default: as recorded)",
    )
    group.add_argument("--experiment", metavar="FILE.csv", help="write its torque, for a controller of your own")
    options.add_robot(parser, pendulums=["max_torque", "max_angle", "max_speed", "experiment", "horizon"])


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Diagnose, print the result, and write the requested files."""
    outputs = [arguments.experiment, arguments.json, arguments.report, arguments.output]
    inputs = open_sources(arguments, list_sources(arguments, outputs), terminal)
    criterion = Criterion(p_value=arguments.significance, block=arguments.block)
    data = inputs.calibrate(terminal, fixed=arguments.fixed, criterion=criterion)
    with terminal.progress("diagnosing", lines=True, pause=PAUSE) as progress:
        diagnosis = diagnose(
            data.recordings,
            data.holdout,
            inputs.model.terms,
            progress,
            criterion=criterion,
            **{name: getattr(arguments, name) for name in ASKED},
        )
    has_signal = diagnosis.suggestion is not None and diagnosis.suggestion.signal is not None
    if arguments.experiment is not None and diagnosis.suggestion is not None and has_signal:
        write_whole(arguments.experiment, diagnosis.suggestion.csv())
    write_json(arguments.json, write_diagnosis(diagnosis))
    write_page(arguments.report, terminal, "workbench.report:render", diagnosis, arguments.line)
    hint = MORE if arguments.report is None else ""
    print_diagnosis(diagnosis, terminal, arguments.verbose, hint)
    if arguments.experiment is not None and not has_signal:
        reason = "there is no experiment" if diagnosis.suggestion is None else "the experiment has no torque"
        terminal.print(f"{arguments.experiment} is not written: {reason}")
        outputs[0] = None
    causes = [region.cause for region in diagnosis.unexplained if region.cause is not None]
    outputs[-1] = None
    try:
        outputs[-1] = write_model(diagnosis.model, arguments.output, [*diagnosis.findings, *causes])
    finally:
        report_files(outputs, terminal)
