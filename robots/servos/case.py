"""Case of servos: effects are found by simulating each servo with its controller in the loop.

Friction at rest, sticking and breaking away show in the distance between a servo and its goal. A regression of torque
on motion omits rest, and torque of a controller is a function of the position itself.

A diagnosis makes these calls, in this order:

    prepare                     case.py                    calibrates the recordings
      decide_conventions        in_loop/conventions.py     decides by fits how drives and goals are simulated
    make_evidence               case.py                    makes `RolloutRows` of fitted and held-out recordings
    search                      selection/search.py        adds and drops effects by these rows, each time:
      RolloutRows.compare       in_loop/rollout_rows.py    simulates the variants of an effect, each by one step
        Rollouts                in_loop/rollouts.py        simulates all recordings at once by `simulate_servos`
      RolloutRows.refine        in_loop/rollout_rows.py    fits the best variants by `fit_rollouts` (in_loop/fit.py)
    reread_goals                goal_reading.py            is tried with the found effects, if goals were left open
    refine                      refit.py                   refits with shorter steps, drops effects not needed
      scan_profile              in_loop/profile.py         fits the gap of a play by its profile likelihood
    find_loop_regions, conclude conclusion.py              find the residual of the motion and the findings
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from estimators.data.fit_data import FitData
from estimators.data.preparation import Prepared, Recordings
from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Step, Terms
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.checks import (
    Subject,
    applies_to,
    check_agreement,
    check_clock,
    check_columns,
    check_completeness,
    check_corrected_timing,
    check_parameters,
    check_small_effect,
    check_timing,
    check_torque_constant,
)
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import Diagnosis
from estimators.findings import Finding
from estimators.regression.least_squares import IdentificationError
from estimators.selection.evidence import Evidence
from estimators.selection.search import SearchResult
from estimators.signals.residual import Region
from estimators.simulation.whole_motion import WholeMotion
from estimators.weak_form.preparation import prepare_windows
from estimators.weak_form.torque_rows import TorqueRows
from pendulum_env.physics import Model, Term
from pendulum_env.recording import Recording
from robots.servos import ServoDrive
from robots.servos.back_emf import add_back_emf, include_back_emf, present
from robots.servos.conclusion import conclude, find_loop_regions, find_speed_rate, find_torque_scale
from robots.servos.goal_reading import decide_drives, reread_goals
from robots.servos.in_loop import complete_drives, decide_conventions, decide_open_torque, list_decisions
from robots.servos.in_loop.motion import simulate_in_loop
from robots.servos.in_loop.rollout_rows import RolloutRows
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.servos import are_driven, choose_parts, make_base
from robots.servos.refit import make_data, refine, refine_rows, refit
from robots.servos.rest import find_rest_band


@applies_to("identify", "diagnose")
def check_conventions(subject: Subject) -> Iterable[Finding]:
    """Report the decided conventions of drives."""
    return list_decisions(subject.data.treatments)


@applies_to("diagnose")
def check_drive(subject: Subject) -> Iterable[Finding]:
    """Find an unknown rate of the speed of a drive, and a scale of the logged torque."""
    recordings, limits, (_, diagnosis) = subject.data.recordings, subject.data.criterion.loop, subject.found
    return filter(None, (find_speed_rate(diagnosis.model, recordings, limits), find_torque_scale(recordings, limits)))


@applies_to("diagnose")
def check_rest(subject: Subject) -> Iterable[Finding]:
    """Find the distance from its goal within which a servo rests."""
    return filter(None, [find_rest_band(subject.found[1].model, subject.data.recordings)])


class Servo(Case):
    """Servos with known controllers, by simulations in the loop."""

    name = "servo"
    treatments = (lambda trial: include_back_emf(trial.data, trial.final.terms), reread_goals)
    checks = (
        check_conventions,
        check_columns,
        check_torque_constant,
        check_timing,
        check_corrected_timing,
        applies_to("identify", "compare")(check_agreement),
        check_completeness,
        applies_to("identify")(check_clock),
        check_parameters,
        check_drive,
        check_rest,
        check_small_effect,
    )
    is_timed = False

    def accepts(self, base: Sequence[Term], recordings: Sequence[Recording]) -> bool:
        """Return whether a recording has a drive."""
        return self.prepares(recordings)

    def prepares(self, recordings: Sequence[Recording]) -> bool:
        """Return whether a recording has a drive."""
        return any(isinstance(recording.drive, ServoDrive) for recording in recordings)

    def declare(self, recordings: Sequence[Recording], settings: Mapping[str, Any]) -> Recordings:
        """Return the recordings with conventions of their drives from a log format."""
        return complete_drives(recordings, settings)

    def complete(
        self, recordings: Sequence[Recording], settings: Mapping[str, Any], criterion: Criterion
    ) -> Recordings:
        """Return the recordings with all conventions: of the drives, of a log format, and decided ones.

        If the joint moves too little for a decision, goals are held.
        """
        declared = complete_drives(recordings, settings)
        try:
            return decide_conventions(declared, criterion=criterion).recordings
        except IdentificationError:
            return complete_drives(declared, {"goal": "held"})

    def decide_torque(
        self, recordings: Recordings, holdout: Recordings, base: Sequence[Term], criterion: Criterion
    ) -> Prepared:
        """Decide conventions if the torque of a recording is that requested by its drive, and depends on them."""
        return decide_open_torque(recordings, holdout, base, criterion)

    def list_decisions(self, findings: Sequence[Finding]) -> Sequence[Finding]:
        """List the last decisions on the conventions of drives."""
        return list_decisions(findings)

    def simulate(self, model: Model, recordings: Sequence[Recording]) -> WholeMotion:
        """Simulate whole recordings with their controllers in the loop."""
        return simulate_in_loop(model, recordings)

    def prepare(
        self, recordings: Sequence[Recording], holdout: Sequence[Recording], options: Options
    ) -> tuple[FitData, Options]:
        """Calibrate the recordings; leave out effects of a sensor, which simulations from goals do not show.

        An effect must explain at least the share `criterion.loop.needed` of the residual.

        Raises:
            RecordingError: if some recordings have no drive, or they cannot be simulated together.
        """
        are_driven((*recordings, *holdout))
        data = FitData.from_recordings(recordings, holdout, options.base, criterion=options.criterion)
        base = make_base(data.recordings, options.base)
        library = {id: kind for id, kind in options.library.items() if kind.kind != "sensor"}
        share = max(options.criterion.explained_share, options.criterion.loop.needed)
        criterion = replace(options.criterion, explained_share=share, needed_share=share)
        data = decide_drives(data, options)
        return data, replace(options, base=base, library=library, criterion=criterion)

    def make_evidence(self, data: FitData, options: Options) -> Evidence:
        """Make the evidence of models on rollouts; parameters of the fitted rows predict the held-out ones.

        Raises:
            IdentificationError: if the recordings have too little motion.
        """
        recordings, held_out = data.recordings, data.holdout or data.recordings
        train_part, check_part = choose_parts(data.holdout)
        rollouts = Rollouts.from_pieces(recordings, shares=train_part)
        windows = TorqueRows(prepare_windows(rollouts.recordings, part=train_part))
        train = RolloutRows(rollouts, windows, criterion=options.criterion, known=options.known)
        rollouts = Rollouts.from_pieces(held_out, shares=check_part)
        windows = TorqueRows(prepare_windows(rollouts.recordings, part=check_part, fewest=0))
        check = RolloutRows(rollouts, windows, train, options.criterion)
        return add_back_emf(data, options).make_evidence((make_data(train), make_data(check)))

    def refit(self, found: SearchResult, start: Model | None) -> SearchResult:
        """Refit with shorter steps of the integrator."""
        return refit(found)

    def refine(self, trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
        """Refit all steps with shorter steps of the integrator, and drop effects that are then not needed."""
        return refine(trial)

    def find_unexplained(self, trial: Trial) -> Sequence[Region]:
        """Return the regions of the residual of the motion in the loop."""
        return find_loop_regions(trial)

    def present(self, trial: Trial, step: Step, is_final: bool) -> Step:
        """Return a step with back-EMF as part of viscous friction, unless the recordings distinguish the two."""
        return present(trial, step)

    def find_floors(self, trial: Trial) -> Mapping[str, float]:
        """Return the mean error of the motion by the encoder alone [rad]."""
        return {"": refine_rows(trial.evidence)[0].rollouts.noise.encoder_error}

    def conclude(self, trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
        """Add findings on the residual and the next step."""
        return conclude(trial, diagnosis)

    def show_effect(self, data: FitData, base: Terms, kind: type[Term]) -> FitData:
        """Return data with back-EMF as a treatment, if the effect distinguishes it from viscous friction."""
        return include_back_emf(data, (*base, kind())) or data


SERVO = Servo()
