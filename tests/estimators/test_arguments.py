"""A plain mistake is answered with one sentence that says what to give instead."""

import re
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from estimators import add, align, compare, diagnose, identify
from estimators.schemes.six import Integral, Scheme, scheme
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, Gravity, Inertia, Model, ModelError
from pendulum_env.plant import hide, make_plant
from pendulum_env.recording import RecordingError, Source, read_recording, write_recording, write_study
from workbench.export import export
from workbench.report import write_report

MODEL = Model.build(BASE, [0.09, 2.0, 0.35, 0.9])


@pytest.mark.parametrize("call", [identify, diagnose, lambda r: compare(MODEL, r), lambda r: add(MODEL, "spring", r)])
@pytest.mark.parametrize(
    ("given", "kind", "says"),
    [
        ("monday.csv", RecordingError, r"monday\.csv: there is no such file"),
        (["monday.csv"], RecordingError, r"monday\.csv: there is no such file"),
        (3, TypeError, "3 is not a recording: give the path of a file, a data frame, a mapping of arrays"),
        (None, TypeError, "None is not a recording"),
        (np.zeros(3), TypeError, "is not a recording"),
        ([], ValueError, "there is no recording to work on"),
    ],
)
def test_what_is_no_recording(call, given, kind, says):
    with pytest.raises(kind, match=says) as raised:
        call(given)
    assert len(str(raised.value)) < 200


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda r: compare(r, MODEL), r"compare\(model, recordings\): the first argument is of type Recording"),
        (lambda r: add(MODEL, r, "spring"), r"add\(model, id, recordings\): the second argument is of type Recording"),
        (lambda r: add([r], "spring", MODEL), "the first argument is of type Recording"),
        (lambda r: identify(BASE, r), r"identify\(recordings, terms, .*the first argument is of type Inertia"),
        (lambda r: identify(MODEL, r), "the first argument is of type Model"),
        (lambda r: diagnose(r, BASE), r"diagnose\(recordings, holdout, base\): the second argument is of type Inertia"),
        (lambda r: diagnose(r, (), [r]), "the third argument is of type Recording"),
        (lambda r: align(MODEL), r"align\(recordings, .*the first argument is of type Model"),
        (lambda r: write_recording("run.csv", r), r"write_recording\(recording, path\): the first argument .* str"),
        (lambda r: write_study("study.toml", [Source(Path("run.csv"))]), "the first argument is of type str"),
        (lambda r: write_report("page.html", compare(MODEL, r)), r"write_report\(result, path\): the first argument"),
        (lambda r: export("mjcf", MODEL), r"export\(model, format, request\): the first argument is of type str"),
    ],
)
def test_arguments_in_another_order(swing, call, says):
    with pytest.raises(TypeError, match=says) as raised:
        call(swing)
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 200


def test_a_result_stands_for_its_model(swing):
    found = identify(swing, schemes="dynamic")["dynamic"]
    assert compare(found, swing).errors == compare(found.model, swing).errors


@pytest.mark.parametrize(
    "limits", [{"bounds": {"coulomb": 0.3}}, {"bounds": ["coulomb"]}, {"fixed": {"gravity": "2"}}, {"fixed": 2.0}]
)
def test_limits_that_are_no_numbers(swing, limits):
    with pytest.raises(TypeError, match="give a dictionary, as in"):
        identify(swing, **limits)


def test_none_is_no_limit(swing):
    def coulomb(low, high):
        return identify(swing, schemes="dynamic", bounds={"coulomb": (low, high)})["dynamic"].model["coulomb"]

    free = coulomb(None, None).value
    assert coulomb(None, 0.5 * free).value == pytest.approx(0.5 * free)
    assert coulomb(2 * free, None).value == pytest.approx(2 * free)
    assert coulomb(0.0, None).value == pytest.approx(free)


@pytest.mark.parametrize("columns", [["t", "q", "tau"], "time=t", {"time": 0}])
def test_columns_that_are_no_dictionary_are_not_blamed_on_the_file(swing, tmp_path, columns):
    write_recording(swing, tmp_path / "run.csv")
    with pytest.raises(TypeError, match="give a dictionary of quantities"):
        read_recording(tmp_path / "run.csv", columns=columns)


def test_held_out_recordings_are_checked_too(swing):
    with pytest.raises(RecordingError, match=r"tuesday\.csv: there is no such file"):
        diagnose(swing, "tuesday.csv")
    with pytest.raises(TypeError, match="is not a recording"):
        add(MODEL, "spring", swing, [swing, 3])


def test_a_result_is_no_recording_and_has_a_hash(swing):
    found, again = (identify(swing, schemes="energy") for _ in range(2))
    assert {found: 1}[found] == 1 and found == found and found != again
    assert list(found) == list(found.keys()) == ["energy"] and dict(found) == dict(found.items())
    for call in (identify, lambda given: compare(MODEL, given)):
        with pytest.raises(TypeError, match="is not a recording"):
            call(found)


def test_what_is_no_effect(swing):
    with pytest.raises(TypeError, match="an effect is added by its id, such as 'stribeck', got "):
        add(MODEL, Gravity, swing)
    with pytest.raises(ValueError, match="did you mean stribeck"):
        add(MODEL, "stribek", swing)
    with pytest.raises(ModelError, match="the model has 'stribeck' already"):
        add(hide(make_plant(), "stribeck"), "stribeck", swing)


@pytest.mark.parametrize("call", [lambda m, r: compare(m, r), lambda m, r: add(m, "spring", r)])
def test_what_is_no_model(call, swing):
    with pytest.raises(TypeError, match=r"'model\.json' is not a model: read a file with Model\.load"):
        call("model.json", swing)
    with pytest.raises(ModelError, match="lacks the term inertia"):
        call(Model.build([Gravity()], [2.0]), swing)


@pytest.mark.parametrize(
    ("terms", "kind", "says"),
    [
        (MODEL, TypeError, r"pass model\.terms"),
        (["inertia", 3], TypeError, "3 is not a term: give its id"),
        ([Inertia], TypeError, "is not a term: give its id, such as 'stribeck', or Stribeck"),
        (["stribek"], ValueError, "did you mean stribeck"),
        ([], ValueError, "needs at least one term"),
    ],
)
def test_what_is_no_term(swing, terms, kind, says):
    with pytest.raises(kind, match=says):
        identify(swing, terms)
    with pytest.raises(kind, match=says):
        diagnose(swing, base=terms)


@pytest.mark.parametrize(
    ("schemes", "kind", "says"),
    [
        ([Scheme], TypeError, "is not a scheme: give an id, such as 'energy', or scheme"),
        ("enrgy", ValueError, "did you mean energy"),
        ([3], TypeError, "3 is not a scheme"),
        ([], ValueError, "no scheme to use"),
        (["energy", scheme("energy", operator=Integral(0.1))], ValueError, "a scheme is named twice in energy, energy"),
    ],
)
def test_what_is_no_scheme(swing, schemes, kind, says):
    with pytest.raises(kind, match=says):
        identify(swing, schemes=schemes)


def test_one_recording_and_names_will_do(swing):
    by_name = identify(swing, ["inertia", "gravity", "viscous", "coulomb"], "energy")
    in_full = identify([swing], BASE, [scheme("energy")])
    np.testing.assert_array_equal(by_name["energy"].model.theta, in_full["energy"].model.theta)
    with pytest.raises(ValueError, match=re.escape("unknown scheme 'dynamic'; known: energy")):
        by_name["dynamic"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"effects": [0.4]}, "an effect is 0.4: give a text such as 'stribeck=0.4'"),
        ({"theta": 0.1}, "theta is given by name or as 4 numbers"),
        ({"theta": "inertia"}, "theta is given by name or as 4 numbers"),
    ],
)
def test_what_is_no_plant(arguments, says):
    with pytest.raises(TypeError, match=says):
        make_plant(**arguments)


def test_a_seed_is_a_generator_and_no_effects_may_be_said_as_none():
    first, second = (
        record(None, excitation("paper", rng(3), 1.0), 1.0, rng=rng(4)) for rng in (int, np.random.default_rng)
    )
    np.testing.assert_array_equal(first.torque, second.torque)
    assert make_plant(effects=None) == make_plant()
    gym.make("pendulum_env/DirectDrivePendulum-v0", effects=None).close()


def test_a_clock_that_counts_from_1970_changes_no_estimate(swing):
    late = replace(swing, time=swing.time + 1_772_000_000.0)
    found, expected = (identify(recording).windows.theta for recording in (late, swing))
    assert found == pytest.approx(expected, rel=1e-6)
