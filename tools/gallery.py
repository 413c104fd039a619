"""What a model leaves that lacks an effect, in pictures: of every effect of the library, and of two real machines."""

from collections.abc import Sequence
from pathlib import Path

from estimators.checks.residual import AXES, Profile, profiles
from estimators.preprocessing import gather
from estimators.selection.data import fit_terms
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, Coulomb, Inertia, Term, Viscous, effects
from pendulum_env.plant import make_plant
from pendulum_env.recording import Recording, read_recording
from pendulum_env.words import along
from workbench.report.gallery import picture

SECONDS = 20.0  # of motion, under the paper's excitation


def gallery(folder: Path) -> None:
    """Draw every effect of the library into a folder, one picture each."""
    folder.mkdir(exist_ok=True)
    for id in effects():
        recording = record(make_plant(effects=id), excitation("paper", 1, SECONDS), SECONDS, rng=1)
        _write(folder / f"{id}.svg", picture(f"What {id} leaves of the base model", left(recording)))


def machines(folder: Path, data: Path) -> None:
    """Draw what rigid models leave of two real recordings, see `docs/machines.md`."""
    folder.mkdir(exist_ok=True)
    emps = read_recording(data / "emps" / "emps.csv.gz", columns={"position": "position:m", "torque": "torque:N"})
    shown = picture(
        "What friction that is the same in both directions leaves", left(emps, (Inertia(), Viscous(), Coulomb()))
    )
    _write(folder / "emps.svg", along(shown))
    motor = read_recording(data / "odrive" / "accel_5_nocomp_first22.csv.gz")
    _write(folder / "odrive.svg", picture("What a rotor without cogging leaves", left(motor)))


def left(recording: Recording, terms: Sequence[Term] = BASE) -> list[Profile]:
    """Residual of a model, fitted to a recording, over angle (within a turn), velocity, torque and time."""
    prepared, _ = gather([recording], [recording])
    model, fit = fit_terms(prepared, terms)
    noise = prepared.data.noise(model.estimates["inertia"].value)
    return profiles(prepared.samples, fit.residual, noise, tuple(AXES))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
