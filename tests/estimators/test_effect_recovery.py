"""Every effect of the library, at a known shape: all six schemes find its parameters and those of the pendulum."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from benchmarks.truth import Truth
from estimators.schemes.identification import identify
from estimators.schemes.six import SCHEMES
from pendulum_env.physics import BASE, effects
from tests.cases import told

HIDDEN = {
    "torque_offset": {"offset": 0.2},
    "gravity_tilt": {"tilt_cos": 0.2},
    "coulomb_asymmetry": {"asym_c": 0.15},
    "viscous_asymmetry": {"asym_v": 0.06},
    "stribeck": {"strib_d": 0.45, "strib_v": 0.6},
    "quadratic_drag": {"drag": 0.03},
    "load_dependent_friction": {"load_mu": 0.1, "load_out": 0.3},
    "position_dependent_friction": {"pos_s": 0.2, "pos_c": 0.15},
    "cogging": {"cog_n": 9.0, "cog_s": 0.15, "cog_c": -0.1},
    "torque_ripple": {"rip_n": 5.0, "rip_s": 0.08, "rip_c": 0.05},
    "spring": {"spring_k": 0.25, "spring_q0": 0.4},
    "actuator_lag": {"lag_T": 0.012},
    "dead_time": {"dead_n": 8.0},
    "torque_saturation": {"sat": 7.0},
    "friction_drift": {"drift_a": 0.4, "drift_T": 4.0},
    "payload_change": {"pay_t": 3.0, "pay_I": 0.02, "pay_mgl": 0.4},
    "periodic_disturbance": {"dist_a": 0.2, "dist_w": 20.0, "dist_ph": 0.7},
    "backlash": {"Jm": 0.03, "bl_gap": 0.005, "bl_k": 400.0, "bl_d": 3.0},
    "joint_flexibility": {"Jm": 0.03, "bl_k": 22.0, "bl_d": 0.05},
    "presliding": {"dahl_sigma": 40.0},
    "encoder_eccentricity": {"ecc_e": 0.01, "ecc_ph": 0.7},
    "hard_stop": {"wall_lo": -1.0, "wall_hi": 0.8, "wall_k": 40.0, "wall_c": 0.1},
}
TOLERANCE = 2e-3  # relative, of all estimates
LOOSE = {
    "stribeck": 4e-3,
    "backlash": 0.05,  # the link's motion is not measured but follows from the motor's: chatter forgives no error
    "joint_flexibility": 0.02,
    "presliding": 0.05,  # it acts around reversals, of which the guard leaves little
    "encoder_eccentricity": 0.02,  # the term is of first order
}


def test_every_effect_has_a_case():
    assert HIDDEN.keys() == effects().keys()


@pytest.mark.parametrize("id", HIDDEN)
def test_known_effect_is_recovered_by_all_schemes(id):
    """From 5 s of the paper's experiment, at 1 kHz without noise."""
    exact = Experiment(seconds=5.0, counts=None, torque_noise=0.0, seed=1)
    (run,), kind = simulate([(Plant(effects={id: HIDDEN[id]}), exact)]), effects()[id]
    known = Truth.of(id, run.truth).parameters
    known = {f"{id}.{shape.name}": known[shape.follows] for shape in kind.shapes if shape.follows in known} | dict(
        known
    )
    term = kind(**{shape.name: known.get(f"{id}.{shape.name}", shape.usual) for shape in kind.shapes})
    theta = [known[column.name] for own in (*BASE, term) for column in own.columns]
    found = identify(told(run), (*BASE, term))
    for scheme in SCHEMES:
        np.testing.assert_allclose(
            found[scheme.id].model.theta, theta, rtol=LOOSE.get(id, TOLERANCE), err_msg=scheme.id
        )
