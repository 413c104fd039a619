"""Free swings: pendulums that are let go, without any torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import add, compare, diagnose, identify
from estimators.diagnosis.suggestion import Aim, Suggestion
from estimators.free_swings import is_torque_needed
from estimators.regression.least_squares import IdentificationError
from pendulum_env.backends import record
from pendulum_env.excitation import STILL
from pendulum_env.physics import Model, ModelError, effects
from pendulum_env.plant import paper_plant
from pendulum_env.recording import Load, Recording, read_recording
from tests import slow
from tests.cases import diagnosed
from tests.once import once

INERTIA = 0.01
TRUTH = {"gravity": 0.5, "viscous": 2e-3, "coulomb": 3e-3}
INERTIA_TOO = {"inertia": INERTIA}
RATIOS = {name: value / INERTIA for name, value in TRUTH.items()}


@once("benchmarks")
def swinging(
    start: float = 2.6,
    hidden: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = (),
    counts: int | None = 4096,
    **base: float,
) -> Recording:
    """A pendulum of a course, let go at rest: 20 s at 200 Hz."""
    plant = Plant(**(INERTIA_TOO | TRUTH | base), effects={id: dict(values) for id, values in hidden})
    experiment = Experiment(rate=200.0, seconds=20.0, start=(start, 0.0), counts=counts, torque_noise=0.0)
    (run,) = simulate([(plant, experiment)], [np.zeros(experiment.samples)])
    return Recording(run.time, run.position, run.torque, name=f"from {start:g} rad")


@once("benchmarks")
def pushed(scale: float = 0.2) -> Recording:
    """The same pendulum under torque."""
    plant = Plant(INERTIA, **TRUTH)
    experiment = Experiment(rate=200.0, seconds=20.0, scale=scale, counts=4096, torque_noise=1e-3, seed=3)
    (run,) = simulate([(plant, experiment)])
    return Recording(run.time, run.position, run.torque, name="pushed")


@once("benchmarks")
def filmed(rate: float, drag: float = 0.0, seed: int = 0) -> list[Recording]:
    """Three swings with a period of 1 s in a video, with angles to half a degree."""
    plant = Plant(0.02, gravity=0.8, viscous=4e-3, coulomb=6e-3, effects={"quadratic_drag": {"drag": drag}})
    runs = [
        Experiment(rate, 25.0, start=(start, 0.0), counts=None, position_noise=8e-3, torque_noise=0.0, seed=seed + k)
        for k, start in enumerate((2.6, 2.0, 1.4))
    ]
    films = simulate([(plant, run) for run in runs], [np.zeros(run.samples) for run in runs])
    return [Recording(film.time, film.position, film.torque, name=f"film {k}") for k, film in enumerate(films)]


def assert_recovered(model: Model, truth: dict[str, float], errors: float = 3.5) -> None:
    for name, value in truth.items():
        estimate = model.estimates[name]
        assert abs(estimate.value - value) < errors * estimate.std and estimate.std < 0.25 * value, name


def test_parameters_relative_to_the_inertia():
    found = identify(swinging())
    assert found.torque_unit == "rad/s^2" and [doubt.withheld for doubt in found.findings] == [()]
    for own in found.schemes.values():
        assert_recovered(own.model, RATIOS, 4.5)
        units = {name: estimate.unit for name, estimate in own.model.estimates.items()}
        assert units == {"inertia": "1", "gravity": "rad/s^2", "viscous": "1/s", "coulomb": "rad/s^2"}
    assert [found[id].unit for id in ("dynamic", "energy", "filtered_power")] == ["rad/s^2", "rad^2/s^2", "rad^2/s^3"]


@pytest.mark.parametrize("name, value", [("inertia", INERTIA), ("gravity", 0.5)])
def test_a_known_parameter_gives_the_others(name, value):
    found = identify(swinging(), fixed={name: value})
    assert found.torque_unit == "N m" and not found.findings
    for model in (*(own.model for own in found.schemes.values()), found.least_squares):
        assert model.estimates[name].value == value and model.estimates[name].std == 0.0
        assert_recovered(model, {own: truth for own, truth in (INERTIA_TOO | TRUTH).items() if own != name}, 4.5)


@pytest.mark.parametrize("counts", [1024, 65_536])
def test_a_small_known_torque_gives_the_inertia_without_attenuation(counts):
    found = identify(swinging(counts=counts), fixed={"coulomb": TRUTH["coulomb"]})
    relative = identify(swinging(counts=counts))
    for id, own in found.schemes.items():
        inertia, ratio = own.model.estimates["inertia"], relative[id].model.estimates["coulomb"]
        assert inertia.value == pytest.approx(TRUTH["coulomb"] / ratio.value)
        assert inertia.std / inertia.value == pytest.approx(ratio.std / ratio.value, rel=1e-6)
    assert_recovered(found.least_squares, INERTIA_TOO | {"gravity": TRUTH["gravity"]}, 4.5)
    loaded = replace(swinging(2.3, counts=65_536, inertia=0.02, gravity=1.1), load=Load(0.01, 0.6))
    known = identify(loaded, fixed={"coulomb": TRUTH["coulomb"]}).model
    assert_recovered(known, INERTIA_TOO | {"gravity": TRUTH["gravity"]}, 4.5)


def test_an_inertia_of_one_is_no_unknown_inertia():
    found = identify(swinging(), fixed={"inertia": 1.0})
    assert found.torque_unit == "N m" and not found.findings
    assert found.least_squares.estimates["gravity"].value == pytest.approx(RATIOS["gravity"], rel=0.01)


def test_a_known_value_that_the_motion_contradicts_is_refused():
    with pytest.raises(IdentificationError, match="contradicts gravity"):
        identify(swinging(), fixed={"gravity": -0.5})
    with pytest.raises(IdentificationError, match="contradicts coulomb"):
        identify(swinging(coulomb=0.0), fixed={"coulomb": -0.5})


def test_torque_of_rounding_and_noise_of_a_sensor_do_not_drive_a_swing():
    run = swinging()
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(run))
    for own in ({"torque": 1e-12 * np.sin(run.time)}, {"load_torque": noise}):
        for known in (None, INERTIA_TOO):
            assert identify(replace(run, **own), fixed=known).json() == identify(run, fixed=known).json()


def test_a_constant_load_torque_drives_a_swing():
    run = swinging(2.6, (("torque_offset", (("offset", 0.1),)),), 65_536)
    found = identify(replace(run, load_torque=np.full(len(run), 0.1)))
    assert found.torque_unit == "N m" and not found.findings
    for name, value in (INERTIA_TOO | TRUTH).items():
        assert found.least_squares.estimates[name].value == pytest.approx(value, rel=5e-3)


def test_a_constant_torque_that_the_motion_does_not_follow_is_refused():
    run = swinging()
    for column in ("torque", "load_torque"):
        with pytest.raises(IdentificationError, match=f"'{column}': 'none'"):
            identify(replace(run, **{column: np.full(len(run), 1e-6)}))


HIDDEN = {  # torque or friction over the inertia, as the plant has it, and as the library does
    "quadratic_drag": ({"drag": 4e-4}, {"quadratic_drag": 0.04}),
    "stribeck": ({"strib_d": 6e-3, "strib_v": 3.0}, {"stribeck": 0.6, "stribeck.stribeck_velocity": 3.0}),
    "cogging": ({"cog_n": 9, "cog_s": 8e-3, "cog_c": -6e-3}, {"cogging.sin": -0.8, "cogging.cos": 0.6}),
    "payload_change": ({"pay_t": 5.0, "pay_I": 1e-3, "pay_mgl": 0.07}, {}),
    "encoder_eccentricity": ({"ecc_e": 0.02, "ecc_ph": 0.7}, {}),
    "gravity_tilt": ({"tilt_cos": 0.02}, {"gravity_tilt": 2.0}),
    "torque_offset": ({"offset": 0.01}, {"torque_offset": -1.0}),
    "viscous_asymmetry": ({"asym_v": 5e-4}, {"viscous_asymmetry": 0.05}),
    "spring": ({"spring_k": 0.03, "spring_q0": 0.2}, {"spring.stiffness": 3.0, "spring.preload": -0.6}),
}


def hiding(id: str) -> Recording:
    return swinging(2.6, ((id, tuple(HIDDEN[id][0].items())),), 65_536 if id == "stribeck" else 4096)


def test_nothing_is_missing():
    found = diagnose(swinging())
    assert found.selected == () and not found.unexplained and found.model.torque_unit == "rad/s^2"
    assert_recovered(found.model, RATIOS)
    assert not any(is_torque_needed(effects()[candidate.effect]) for candidate in found.candidates)


@pytest.mark.parametrize("rate", [30.0, 60.0])
def test_a_video_determines_gravity_and_friction(rate):
    found = diagnose(filmed(rate))
    assert found.selected == () and not found.unexplained
    assert_recovered(found.model, {"gravity": 40.0, "viscous": 0.2}, 4.0)
    dry = found.model.estimates["coulomb"]
    assert abs(dry.value - 0.3) < 3.5 * dry.std
    assert found.model.estimates["gravity"].std < 0.06 and dry.std < 0.12


@pytest.mark.parametrize("rate", [30.0, 60.0])
def test_a_video_shows_quadratic_drag(rate):
    found = diagnose(filmed(rate, 4e-3))
    assert found.selected == ("quadratic_drag",)
    assert_recovered(found.model, {"gravity": 40.0})
    drag = found.model.estimates["quadratic_drag"]
    assert abs(drag.value - 0.2) < 3.5 * drag.std and drag.std < 0.08


@pytest.mark.parametrize("name", ["viscous", "coulomb"])
def test_the_decay_tells_viscous_from_dry_friction(name):
    found = diagnose(swinging(**{name: 0.0}))
    assert found.selected == ()
    none, other = found.model.estimates[name], {"viscous": "coulomb", "coulomb": "viscous"}[name]
    assert abs(none.value) < 3 * none.std
    assert_recovered(found.model, {other: RATIOS[other]})


@pytest.mark.parametrize("id", slow.but(["quadratic_drag", "stribeck", "gravity_tilt"], HIDDEN))
def test_an_effect_is_found(id):
    found = diagnosed(hiding(id))
    assert id in found.effects[0] and len(found.selected) == 1
    if found.selected == (id,):
        for name, value in HIDDEN[id][1].items():
            estimate = found.model.estimates[name]
            assert abs(estimate.value - value) < max(4 * estimate.std, 0.01 * abs(value)), name


def test_verdicts_do_not_depend_on_the_inertia():
    relative, absolute = diagnose(hiding("cogging")), diagnose(hiding("cogging"), fixed={"inertia": INERTIA})
    assert absolute.model.torque_unit == "N m" and absolute.selected == relative.selected
    scores = [{one.effect: one.score for one in found.candidates} for found in (relative, absolute)]
    assert scores[0] == pytest.approx(scores[1], abs=0.02)


def test_effects_of_the_torque_are_refused():
    shown = {id for id, kind in effects().items() if is_torque_needed(kind)}
    assert shown >= {"torque_ripple", "actuator_lag", "dead_time", "torque_saturation", "load_dependent_friction"}
    assert shown >= {"backlash", "joint_flexibility"}
    assert shown.isdisjoint({"torque_offset", "cogging", "presliding", "hard_stop", "payload_change", "stribeck"})
    for id in ("dead_time", "backlash"):
        with pytest.raises(IdentificationError, match=f"{id} shows only under torque"):
            diagnose(swinging(), only=[id])
        with pytest.raises(IdentificationError, match=f"{id} shows only under torque"):
            add(paper_plant(), id, swinging())


def test_a_saved_model_is_relative_to_the_inertia(tmp_path):
    diagnosed(hiding("quadratic_drag")).model.save(tmp_path / "model.json")
    model = Model.load(tmp_path / "model.json")
    assert model.torque_unit == "rad/s^2" and model.estimates["inertia"].value == 1.0
    assert model.estimates["quadratic_drag"].unit == "1/rad"
    other = swinging(1.5, (("quadratic_drag", (("drag", 4e-4),)),))
    assert compare(model, other).joint.errors.torque_rms < 1.3 * compare(model, other).joint.noise_floor
    assert diagnose(other, base=model.terms).selected == ()
    with pytest.raises(ModelError, match="the model is relative to the inertia"):
        compare(model, pushed())
    free = identify(pushed(), model.terms)
    assert free.torque_unit == "N m" and free["dynamic"].model.estimates["inertia"].std > 0


def test_an_effect_is_added():
    for start in (identify(swinging()), identify(pushed())):
        added = add(start, "quadratic_drag", hiding("quadratic_drag"))
        scale = 1.0 if added.after.model.torque_unit == "rad/s^2" else start.model.estimates["inertia"].value
        drag = added.after.model.estimates["quadratic_drag"]
        assert drag.value == pytest.approx(0.04 * scale, rel=0.1) and added.objection is None


@pytest.mark.slow
def test_driven_and_free_recordings_together():
    known = identify(pushed()).model
    assert compare(known, swinging()).joint.errors.torque_rms < 1.3 * compare(known, swinging()).joint.noise_floor
    for together in ([pushed(), swinging()], [swinging(), pushed()]):
        found = diagnose(together)
        assert found.model.torque_unit == "N m" and found.selected == () and not found.disagreements
        assert_recovered(found.model, {"inertia": INERTIA} | TRUTH)
    assert diagnose(pushed(), swinging()).selected == ()
    with pytest.raises(IdentificationError, match="pushed: has torque, but no recording that is fitted has any"):
        diagnose(swinging(), pushed())
    assert diagnose(swinging(), pushed(), fixed={"inertia": INERTIA}).selected == ()


def test_another_pendulum_has_another_inertia():
    heavier = replace(swinging(1.9, inertia=1.2 * INERTIA), name="heavier")
    (found,) = diagnose([swinging(), heavier]).disagreements
    assert found.recording == "heavier"
    assert found.inertia_factor == pytest.approx(1.2, rel=0.01)


def test_a_release_is_suggested():
    plant = paper_plant(INERTIA_TOO | TRUTH | {"coulomb": 3e-4})
    run = record(plant, STILL, 20.0, 200.0, rng=0, release=0.2)
    assert not run.torque.any()
    narrow, wide = diagnose(run), diagnose(run, max_angle=3.0, max_speed=30.0)
    assert narrow.suggestion is None and narrow.no_experiment.aims == (Aim("spring", "gravity"),)
    suggested = wide.suggestion
    assert suggested is not None and suggested.signal is None and 0.2 < abs(suggested.release or 0.0) <= 3.0
    assert Suggestion.from_json(suggested.json()) == suggested


def test_loads_of_known_size_are_beside_the_inertia():
    loaded = replace(swinging(2.3, inertia=0.02, gravity=1.1), load=Load(0.01, 0.6), name="loaded")
    found = identify([swinging(), loaded], fixed={"inertia": INERTIA})
    assert_recovered(found.least_squares, TRUTH)
    with pytest.raises(IdentificationError, match="their known loads differ: fix the inertia"):
        identify([swinging(), loaded])
    assert identify(loaded).torque_unit == "rad/s^2"  # of the joint with its load


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_of_a_camera_is_no_error_of_an_encoder(seed):
    plant = Plant(1.0, gravity=21.4, viscous=0.085, coulomb=0.0)
    experiment = Experiment(
        30.0, 45.0, start=(0.31, 0.0), counts=None, position_noise=2.6e-3, torque_noise=0.0, seed=seed
    )
    (run,) = simulate([(plant, experiment)], [np.zeros(experiment.samples)])
    found = diagnose(
        [Recording(run.time, run.position, name="camera")], only=["encoder_eccentricity", "payload_change"]
    )
    assert found.selected == () and not found.unexplained
    assert found.model.estimates["gravity"].value == pytest.approx(21.4, rel=5e-3)


def test_a_gyroscope_that_has_no_zero_shows_the_drag_and_no_tilt():
    run = swinging(1.2, (("quadratic_drag", (("drag", 1e-3),)),), counts=None)
    speed = np.gradient(run.position, run.time)
    read = read_recording({"time": run.time, "velocity": speed + np.random.default_rng(0).normal(0, 2e-3, len(speed))})
    assert read.has_integrated_position and abs(read.position[-1]) > 1.0  # rad from where it hangs
    found = diagnose([read], only=["quadratic_drag", "gravity_tilt", "spring"])
    assert found.selected == ("quadratic_drag",) and not found.unexplained
    estimate = found.model.estimates["gravity"]
    assert abs(estimate.value - RATIOS["gravity"]) < 5 * estimate.std
