"""Putting an arm's report together: of a diagnosis, or of a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from estimators.arms.diagnosis import ArmDiagnosis, gather_arm, parted
from estimators.arms.identification import JointError
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.files import write_whole
from workbench.report.arm import sections
from workbench.report.arm.case import ArmCase, Drawn
from workbench.report.page import assemble
from workbench.report.sections.candidates import ranked
from workbench.report.words import listing, percent


def write_arm_report(
    path: str | Path, recordings: Sequence[ArmRecording], holdout: Sequence[ArmRecording], diagnosis: ArmDiagnosis
) -> None:
    """Write a diagnosis of an arm as one self-contained HTML file, like that of a pendulum.

    Args:
        path: of the file, written whole or not at all.
        recordings: what the diagnosis was made from.
        holdout: what was held out; empty if the end of each recording was.
        diagnosis: what was found.

    Raises:
        OSError: if the file cannot be written.
    """
    base = Drawn("base model", "--base", diagnosis.base, diagnosis.before)
    final = Drawn("final model", "--final", diagnosis.model, diagnosis.after)
    case = ArmCase(
        gather_arm(parted(recordings, holdout)[0], diagnosis.model.terms),
        (base, final) if diagnosis.selected else (base,),
        "held-out data",
        diagnosis.selected,
        diagnosis.candidates,
        diagnosis.unexplained,
        diagnosis.next_step,
    )
    _write(path, case, diagnosis.headline, f"diagnosis of {listing([recording.name for recording in recordings])}")


def write_arm_comparison_report(
    path: str | Path, recordings: Sequence[ArmRecording], model: ArmModel, errors: tuple[JointError, ...]
) -> None:
    """Write how far a model's torque is from recordings, and where, as one self-contained HTML file.

    Args:
        path: of the file, written whole or not at all.
        recordings: what it was compared with.
        model: of the arm.
        errors: that `compare_arm` found.

    Raises:
        OSError: if the file cannot be written.
    """
    case = ArmCase(
        gather_arm(recordings, model.terms),
        (Drawn("model", "--base", model, errors),),
        "the recordings compared with",
    )
    worst = max(errors, key=lambda error: error.share or 0.0)
    headline = f"The torque of {worst.joint} is {percent(worst.share or 0.0)} off, the most of {len(errors)} joints"
    _write(path, case, headline, f"comparison with {listing([recording.name for recording in recordings])}")


def _write(path: str | Path, case: ArmCase, headline: str, subject: str) -> None:
    judged = [ranked(case.judged)] if case.judged else []
    shown = [sections.joints(case, headline), sections.strips(case), *judged, sections.parameters(case)]
    write_whole(path, assemble(shown, subject))
