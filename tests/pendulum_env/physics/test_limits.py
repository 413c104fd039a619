"""Parameters that are known or bounded, and effects from a file."""

import pickle

import numpy as np
import pytest

from estimators.search_hints import make_grid
from pendulum_env import plugins
from pendulum_env.errors import UserError
from pendulum_env.physics import BASE, Model, PluginError, Samples, effects, library, load_plugin, plugin
from pendulum_env.physics.limits import check_names, collect_limits, limit_kind, limit_term, make_limits

PLUGIN = '''
from dataclasses import dataclass
from pendulum_env.physics import Column, Term, register


@register
@dataclass(frozen=True)
class Cubic(Term):
    """Damping that grows with the cube of the speed."""

    id = "cubic_of_a_plugin"
    law = "c q'^3"
    kind = "dissipative"

    @property
    def columns(self):
        return (Column("cubic_of_a_plugin", "N m s^3/rad^3", force=lambda x: x.velocity**3),)
'''


@pytest.fixture
def own_library(monkeypatch):
    monkeypatch.setattr(library, "_registered", dict(library._registered))
    monkeypatch.setattr(plugin, "_loaded", {})


def test_a_limited_kind_is_the_same_law_whose_parameters_and_search_stay_within_limits():
    limits = {"stribeck": (0.1, 0.2), "stribeck.stribeck_velocity": (0.3, 0.4)}
    kind = limit_kind(effects()["stribeck"], limits)
    term = kind(stribeck_velocity=0.35)
    (column,) = term.columns
    assert (column.least, column.most) == (0.1, 0.2) and term.id == "stribeck"
    assert (term.nonlinear_parameters[0].low, term.nonlinear_parameters[0].high) == (0.3, 0.4)
    assert limit_kind(effects()["stribeck"], {"gravity": (1, 2)}) is effects()["stribeck"]
    assert limit_kind(effects()["stribeck"], limits) is kind
    x = Samples(np.zeros(9), np.zeros(9), np.linspace(-5, 5, 9), np.zeros(9))
    velocities = [variant.stribeck_velocity for variant in make_grid(kind, x, np.zeros(9))]
    assert velocities and min(velocities) >= 0.3 and max(velocities) <= 0.4


def test_limits_of_a_body_hold_within_those_of_a_user_and_a_base_term_can_be_known():
    assert limit_kind(effects()["joint_flexibility"], {"joint_flexibility": (-1.0, 1.0)})().columns[0].least == 0.0
    gravity = limit_term(BASE[1], {"gravity": (2.0, 2.0)})
    assert gravity.columns[0].is_known and gravity.id == "gravity"
    assert gravity == limit_term(BASE[1], {"gravity": (2.0, 2.0)}) != BASE[1]


def test_limits_go_along_to_another_process():
    kind = limit_kind(effects()["cogging"], {"cogging.order": (10, 14)})
    for term in (kind(order=12.0), limit_term(BASE[1], {"gravity": (2.0, 2.0)})):
        there = pickle.loads(pickle.dumps(term))
        assert there == limit_term(term, {"gravity": (2.0, 2.0)}) == term
        assert there.columns[0].least == term.columns[0].least
        assert there.nonlinear_parameters == term.nonlinear_parameters


def test_bounds_of_a_whole_number_act_on_whole_numbers():
    terms = [effects()["cogging"](order=n) for n in (2.0, 7.0, 12.0)]
    assert [limit_term(term, {"cogging.order": (5.5, 8.5)}).order for term in terms] == [6.0, 7.0, 8.0]
    with pytest.raises(UserError, match=r"cogging\.order is a whole number"):
        check_names({"cogging.order": (6.2, 6.5)}, (effects()["cogging"],))


@pytest.mark.parametrize(
    ("fixed", "bounds", "what"),
    [
        ({"gravity": 2.0}, {"gravity": (1.0, 2.0)}, "fixed and bounded"),
        ({}, {"viscous": (1.0, 0.0)}, "smaller bound first"),
        ({"inertia": -1.0}, {}, "positive"),
        ({"gravity": np.nan}, {}, "give a number"),
        ({"gravty": 1.0}, {}, "did you mean gravity"),
        ({"stribeck.stribeck_velocity": 1.0}, {}, "give it bounds"),
    ],
)
def test_limits_that_make_no_sense_are_refused(fixed, bounds, what):
    with pytest.raises(UserError, match=what):
        check_names(make_limits(fixed, bounds), (*map(type, BASE), *effects().values()))


def test_a_file_of_effects_is_known_and_may_be_loaded_twice(tmp_path, own_library):
    path = tmp_path / "cubic.py"
    path.write_text(PLUGIN)
    (kind,) = load_plugin(path)
    assert effects()["cubic_of_a_plugin"] is kind
    library._registered.clear()
    assert load_plugin(path) == (kind,) and effects()["cubic_of_a_plugin"] is kind


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ("x = 1\n", "registers no effect"),
        ("x = 1\nx = nothing\n", "line 2: NameError"),
        ("import sys\nsys.exit(0)\n", "line 2: SystemExit: 0"),
        (PLUGIN.replace('"c q\'^3"', "None"), "law of Cubic is None: it has to be a text"),
        (PLUGIN.replace("    law =", "    shapes = ()\n    law ="), "shapes of Cubic is a name of release 1.0.0"),
        (PLUGIN.replace("x.velocity**3", "None + 1"), "line 17: force of column 'cubic_.*' of Cubic: TypeError"),
        (PLUGIN.replace("x.velocity**3", "x.velocity[:3]"), "force of .* of Cubic: ValueError: operands could not be"),
    ],
)
def test_a_file_that_is_of_no_use_is_refused(tmp_path, own_library, content, what):
    path = tmp_path / "bad_plugin.py"
    path.write_text(content)
    with pytest.raises(PluginError, match=what):
        load_plugin(path)
    with pytest.raises(PluginError, match="no Python file"):
        load_plugin(tmp_path / "absent.py")
    assert not plugin.list_plugins()  # or each process that is started would stumble over it


class OfAPackage:
    name, value = "effects", "package.effects"

    def load(self):
        raise ImportError("no module")


def test_a_package_whose_effects_cannot_be_loaded_ends_nothing(monkeypatch):
    monkeypatch.setattr(plugins, "entry_points", lambda group: [OfAPackage()])
    monkeypatch.setattr(library, "load_plugins", plugins.load_plugins.__wrapped__)
    with pytest.warns(UserWarning, match="'package.effects' of .* cannot be loaded: ImportError: no module"):
        assert library.load_installed.__wrapped__() == ()


def test_a_saved_model_keeps_its_limits(tmp_path):
    terms = [limit_term(term, {"gravity": (2.1, 2.1), "viscous": (0.0, np.inf)}) for term in BASE]
    Model.build(terms, [0.09, 2.1, 0.3, 0.9]).save(tmp_path / "model.json")
    read = Model.load(tmp_path / "model.json")
    assert collect_limits(read.terms) == {"gravity": (2.1, 2.1), "viscous": (0.0, np.inf)}
    assert read.terms == tuple(terms)
