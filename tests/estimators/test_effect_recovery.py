"""Every effect of the library, at a known shape: all six schemes find its parameters and those of the pendulum."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from benchmarks.independent_plant import Plant
from estimators.schemes.identification import identify
from estimators.schemes.six import SCHEMES
from pendulum_env.physics import BASE, effects
from pendulum_env.recording import Recording

PLANT = Plant()
LINK = PLANT.inertia - 0.03  # kg m^2, behind an elastic transmission with 0.03 at the motor


@dataclass(frozen=True)
class Case:
    """What the plant does, the term's shape and its linear parameters, and how close all estimates come (relative)."""

    plant: dict[str, float]
    theta: list[float]
    shape: dict[str, float] = field(default_factory=dict)
    tolerance: float = 2e-3


CASES = {
    "torque_offset": Case({"offset": 0.2}, [-0.2]),
    "gravity_tilt": Case({"tilt_cos": 0.2}, [0.2]),
    "coulomb_asymmetry": Case({"asym_c": 0.15}, [0.15]),
    "viscous_asymmetry": Case({"asym_v": 0.06}, [0.06]),
    "stribeck": Case({"strib_d": 0.45, "strib_v": 0.6}, [0.45], {"stribeck_velocity": 0.6}, 4e-3),
    "quadratic_drag": Case({"drag": 0.03}, [0.03]),
    "load_dependent_friction": Case({"load_mu": 0.1, "load_out": 0.3}, [0.1, 0.15], {"weight": 2.0}),
    "position_dependent_friction": Case({"pos_s": 0.2, "pos_c": 0.15}, [0.2, 0.15]),
    "cogging": Case({"cog_n": 9.0, "cog_s": 0.15, "cog_c": -0.1}, [-0.15, 0.1], {"order": 9.0}),
    "torque_ripple": Case({"rip_n": 5.0, "rip_s": 0.08, "rip_c": 0.05}, [-0.08, -0.05], {"order": 5.0}),
    "spring": Case({"spring_k": 0.25, "spring_q0": 0.4}, [0.25, -0.1]),
    "actuator_lag": Case({"lag_T": 0.012}, [], {"time_constant": 0.012}),
    "dead_time": Case({"dead_n": 8.0}, [], {"dead_time": 0.008}),
    "torque_saturation": Case({"sat": 7.0}, [], {"limit": 7.0}),
    "friction_drift": Case(
        {"drift_a": 0.4, "drift_T": 4.0}, [0.4 * PLANT.viscous, 0.4 * PLANT.coulomb], {"warm_up": 4.0}
    ),
    "payload_change": Case({"pay_t": 3.0, "pay_I": 0.02, "pay_mgl": 0.4}, [0.02, 0.4], {"moment": 3.0}),
    "periodic_disturbance": Case(
        {"dist_a": 0.2, "dist_w": 20.0, "dist_ph": 0.7}, [-0.2 * np.cos(0.7), -0.2 * np.sin(0.7)], {"frequency": 20.0}
    ),
    # The link's motion is not measured but follows from the motor's: chattering play forgives no error.
    "backlash": Case(
        {"Jm": 0.03, "bl_gap": 0.005, "bl_k": 400.0, "bl_d": 3.0},
        [LINK],
        {"gap": 0.005, "resonance": np.sqrt(400 / LINK), "damping": 3.0 / LINK, "gravity": PLANT.gravity / LINK},
        0.05,
    ),
    "joint_flexibility": Case(
        {"Jm": 0.03, "bl_k": 22.0, "bl_d": 0.05},
        [LINK],
        {"resonance": np.sqrt(22 / LINK), "damping": 0.05 / LINK, "gravity": PLANT.gravity / LINK},
        0.02,
    ),
    # Friction is uncertain around reversals, where presliding acts and the guard leaves little of it.
    "presliding": Case({"dahl_sigma": 40.0}, [PLANT.coulomb], {"displacement": PLANT.coulomb / 40}, 0.05),
    # The term is of first order in the eccentricity.
    "encoder_eccentricity": Case(
        {"ecc_e": 0.01, "ecc_ph": 0.7},
        [0.01 * np.cos(0.7), 0.01 * np.sin(0.7)],
        {"inertia": PLANT.inertia, "gravity": PLANT.gravity, "viscous": PLANT.viscous},
        0.02,
    ),
    "hard_stop": Case(
        {"wall_lo": -1.0, "wall_hi": 0.8, "wall_k": 40.0, "wall_c": 0.1},
        [40.0],
        {"lower": -1.0, "upper": 0.8, "hysteresis": 0.1},
    ),
}


@pytest.fixture(scope="module")
def recordings(record) -> dict[str, Recording]:
    """5 s of the paper's experiment for each effect, at 1 kHz without noise."""
    plants = [Plant(effects={effect: case.plant}) for effect, case in CASES.items()]
    runs = record(plants, seconds=5.0, counts=None, torque_noise=0.0, seed=1)
    return {effect: run.recording for effect, run in zip(CASES, runs, strict=True)}


def test_every_effect_has_a_case():
    assert CASES.keys() == effects().keys()


@pytest.mark.parametrize("effect", CASES)
def test_known_effect_is_recovered_by_all_schemes(effect, recordings):
    case = CASES[effect]
    truth = [PLANT.inertia, PLANT.gravity, PLANT.viscous, PLANT.coulomb, *case.theta]
    found = identify([recordings[effect]], (*BASE, effects()[effect](**case.shape)))
    for scheme in SCHEMES:
        np.testing.assert_allclose(found[scheme.id].model.theta, truth, rtol=case.tolerance, err_msg=scheme.id)
