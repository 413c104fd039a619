"""A wrong argument is answered with one sentence that says what to give instead."""

import numpy as np
import pytest

from agents import compare_policies
from estimators import add, compare, diagnose, identify
from estimators.arguments import select_parts, select_recordings
from estimators.schemes.six import Integral, Scheme, scheme
from pendulum_env.backends import record
from pendulum_env.errors import UserError
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, Gravity, Inertia, Model, ModelError
from pendulum_env.plant import hide, make_plant
from pendulum_env.recording import RecordingError, read_recording, write_recording
from workbench.narrator import describe
from workbench.report import write_report

MODEL = Model.build(BASE, [0.09, 2.0, 0.35, 0.9])
NO_RECORDING = (
    ("monday.csv", RecordingError, r"monday\.csv: there is no such file"),
    (3, TypeError, "3 is not a recording"),
    (np.zeros(3), TypeError, "is not a recording"),
    ([], ValueError, "there is no recording to work on"),
)
NO_TERMS = (
    (MODEL, TypeError, r"pass model\.terms"),
    (["inertia", 3], TypeError, "3 is not a term: give its id"),
    ([Inertia], TypeError, "is not a term: give its id"),
    (["stribek"], ValueError, "did you mean stribeck"),
    ([], ValueError, "needs at least one term"),
)
NO_SCHEMES = (
    ([Scheme], TypeError, "is not a scheme: give an id"),
    ("enrgy", ValueError, "did you mean energy"),
    ([], ValueError, "no scheme to use"),
    (["energy", scheme("energy", operator=Integral(0.1))], ValueError, "a scheme is named twice"),
)
ANOTHER_ORDER = (
    (lambda r: compare(r, MODEL), "is not a model"),
    (lambda r: add(MODEL, r, "spring"), "an effect is added by its id"),
    (lambda r: add([r], "spring", MODEL), "is not a model"),
    (lambda r: identify(BASE, r), "is not a term"),
    (lambda r: identify(MODEL, r), "is not a term"),
    (lambda r: diagnose(r, BASE), "is not a recording"),
    (lambda r: diagnose(r, (), [r]), "is not a term"),
    (lambda r: write_report("page.html", compare(MODEL, r)), "no str: compare it first"),
    (lambda r: write_report(MODEL, "page.html"), "no Model: compare it first"),
)

WRONG = [
    *((call, TypeError, says) for call, says in ANOTHER_ORDER),
    *((lambda r, own=own: identify(own[0]), *own[1:]) for own in NO_RECORDING),
    *((lambda r, own=own: diagnose(own[0]), *own[1:]) for own in NO_RECORDING),
    *((lambda r, own=own: compare(MODEL, own[0]), *own[1:]) for own in NO_RECORDING),
    *((lambda r, own=own: add(MODEL, "spring", own[0]), *own[1:]) for own in NO_RECORDING),
    *((lambda r, own=own: identify(r, own[0]), *own[1:]) for own in NO_TERMS),
    *((lambda r, own=own: diagnose(r, base=own[0]), *own[1:]) for own in NO_TERMS),
    *((lambda r, own=own: identify(r, schemes=own[0]), *own[1:]) for own in NO_SCHEMES),
    (lambda r: identify([r, r]), ValueError, "a recording is given twice"),
    (lambda r: identify(r, bounds={"coulomb": 0.3}), TypeError, "coulomb=0.3: give a pair of numbers"),
    (lambda r: identify(r, bounds=["coulomb"]), TypeError, "give a dictionary, as in"),
    (lambda r: identify(r, fixed={"gravity": "2"}), TypeError, "gravity='2': give a number in SI units"),
    (lambda r: identify(r, fixed={"mass": 2.0}), ValueError, "unknown parameter 'mass'.* gravity or cogging"),
    (lambda r: identify(r, criterion=0.01), TypeError, r"give limits by name, as in Criterion\(p_value=0.01\)"),
    (lambda r: diagnose(r, progress=True), TypeError, "progress=True: give a function"),
    (lambda r: diagnose(r, horizon="1 s"), TypeError, "horizon='1 s': give a number of seconds"),
    (lambda r: diagnose(r, max_torque="6 Nm"), ValueError, "max_torque='6 Nm': give a number"),
    (lambda r: diagnose(r, max_angle=-1.0), ValueError, "max_angle=-1.0: give a number of at least zero"),
    (lambda r: identify(r, fix={"gravity": 2.0}), ValueError, "unknown argument 'fix': did you mean fixed"),
    (lambda r: identify(r, scheme="energy"), ValueError, "did you mean schemes"),
    (lambda r: diagnose(r, only=3), TypeError, "3 names no effects"),
    (lambda r: identify(np.zeros((100, 3))), TypeError, "<ndarray> is not a recording.* a mapping of arrays"),
    (lambda r: add(MODEL, "coulomb", r), ModelError, "coulomb"),
    (lambda r: compare_policies([MODEL]), TypeError, "give a mapping"),
    (lambda r: describe(compare(MODEL, r)), TypeError, "one finding, not Comparison"),
    (lambda r: read_recording({}, columns={"torqe": "x"}), RecordingError, "did you mean torque"),
    (lambda r: identify(r, fixed={"stribeck": 1.0}), UserError, "the model has no parameter 'stribeck'"),
    (lambda r: diagnose(r, "tuesday.csv"), RecordingError, r"tuesday\.csv: there is no such file"),
    (lambda r: add(MODEL, "spring", r, [3]), TypeError, "is not a recording"),
    (lambda r: identify(identify(r, schemes="energy")), TypeError, "is not a recording"),
    (lambda r: add(MODEL, Gravity, r), TypeError, "an effect is added by its id"),
    (lambda r: add(MODEL, "stribek", r), ValueError, "did you mean stribeck"),
    (lambda r: add(hide(make_plant(), "dead_time=0"), "stribeck", r), UserError, "leave dead_time out of the model"),
    (
        lambda r: add(hide(make_plant(), "stribeck"), "stribeck", r),
        ModelError,
        "the model has 'stribeck' already",
    ),
    (lambda r: compare("absent.json", r), ModelError, r"absent\.json: cannot be read"),
    (lambda r: add(3, "spring", r), TypeError, "3 is not a model: give a model, the path of its file"),
    (lambda r: diagnose(r, r), ValueError, "a recording is both fitted and held out"),
    (lambda r: diagnose("a.csv", iter(["./a.csv"])), ValueError, "a recording is both fitted and held out"),
    (lambda r: add(MODEL, "spring", [r], r), ValueError, "a recording is both fitted and held out"),
    (lambda r: compare(Model.build([Gravity()], [2.0]), r), ModelError, "lacks the term inertia"),
    (lambda r: identify(r, schemes="energy")["dynamic"], ValueError, "unknown scheme 'dynamic'; known: energy"),
]


@pytest.mark.parametrize(("call", "kind", "says"), WRONG)
def test_a_wrong_argument_is_one_sentence(swing, call, kind, says):
    with pytest.raises(kind, match=says) as raised:
        call(swing)
    assert "\n" not in str(raised.value)


def test_a_result_stands_for_its_model(swing):
    found = identify(swing, schemes="dynamic")["dynamic"]
    assert compare(found, swing).errors == compare(found.model, swing).errors


def test_the_path_of_a_model_stands_for_it(swing, tmp_path):
    found = identify(swing, schemes="dynamic")
    found.model.save(tmp_path / "model.json")
    assert compare(tmp_path / "model.json", swing).errors == compare(found.model, swing).errors
    assert compare(str(tmp_path / "model.json"), swing).model.theta == pytest.approx(found.model.theta)


def test_none_is_no_limit(swing):
    def coulomb(low, high):
        return identify(swing, schemes="dynamic", bounds={"coulomb": (low, high)})["dynamic"].model["coulomb"]

    free = coulomb(None, None).value
    assert coulomb(None, 0.5 * free).value == pytest.approx(0.5 * free)
    assert coulomb(2 * free, None).value == pytest.approx(2 * free)


@pytest.mark.parametrize("columns", [["t", "q", "tau"], "time=t", {"time": 0}])
def test_columns_that_are_no_dictionary_are_not_blamed_on_the_file(swing, tmp_path, columns):
    write_recording(swing, tmp_path / "run.csv")
    with pytest.raises(TypeError, match="give a dictionary of quantities"):
        read_recording(tmp_path / "run.csv", columns=columns)


def test_a_seed_is_a_generator():
    first, second = (
        record(None, excitation("paper", rng(3), 1.0), 1.0, rng=rng(4)) for rng in (int, np.random.default_rng)
    )
    np.testing.assert_array_equal(first.torque, second.torque)


def test_an_iterator_of_recordings_is_read_once(swing):
    assert select_recordings(iter([swing])) == (swing,)
    (fitted,), held_out = select_parts(iter([swing]), iter([]))
    assert fitted is swing and held_out == ()
