"""The gallery: what each effect leaves of a model that lacks it, as pictures for the page of effects."""

from pathlib import Path

import numpy as np

from estimators.checks.residual import AXES, Profile, profile
from estimators.diagnosis.run import gather
from estimators.selection.data import fit_terms
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, effects
from pendulum_env.plant import make_plant
from workbench.report.gallery import picture

SECONDS = 20.0  # of motion, under the paper's excitation


def gallery(folder: Path) -> None:
    """Draw every effect of the library into a folder, one picture each."""
    folder.mkdir(exist_ok=True)
    for id in effects():
        (folder / f"{id}.svg").write_text(
            picture(f"What {id} leaves of the base model", signature(id)), encoding="utf-8"
        )


def signature(id: str) -> list[Profile]:
    """Residual of the base model, fitted to a recording that hides one effect, over angle, velocity, torque, time."""
    recording = record(make_plant(effects=id), excitation("paper", 1, SECONDS), SECONDS, rng=1)
    evidence, _ = gather([recording], [recording])
    model, fit = fit_terms(evidence, BASE)
    noise, x = evidence.data.noise(model.estimates["inertia"].value), evidence.samples
    return [profile(axis, np.asarray(getattr(x, axis)), fit.residual, noise) for axis in AXES]
