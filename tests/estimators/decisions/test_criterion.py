"""What counts as noise, and one criterion for all decisions."""

import ast
from dataclasses import fields, is_dataclass

import pytest

from estimators.decisions.criterion import Criterion, ResidualStructure, has_structure, is_noise
from tools.prose import ROOT


@pytest.mark.parametrize(
    ("residual", "noise"),
    [
        (ResidualStructure(0.0, 0.0, 2.0), True),  # white, of a size that the sensors may have
        (ResidualStructure(0.0, -9.0, 3.0), False),  # white, and far too much
        (ResidualStructure(0.6, 4.0, 1.0), True),  # shared perhaps
        (ResidualStructure(0.6, 6.0, 1.0), False),  # shared surely
        (ResidualStructure(0.4, 60.0, 1.0), True),  # surely, and too little to matter
        (ResidualStructure(0.4, 60.0, 3.0), False),
    ],
)
def test_noise_is_white_or_too_little_to_matter_and_never_far_above_the_floor(residual, noise):
    scaled = ResidualStructure(1e-3 * residual.correlated_rms, residual.z_score, 1e-3 * residual.rms)
    assert is_noise(residual, 1.0, Criterion()) is is_noise(scaled, 1e-3, Criterion()) is noise


def test_from_white_noise_nothing_can_be_learnt():
    assert not has_structure(ResidualStructure(0.4, 4.9, 2.0), 1.0, Criterion())
    assert has_structure(ResidualStructure(0.4, 5.1, 2.0), 1.0, Criterion())
    assert has_structure(ResidualStructure(0.0, 0.0, 2.6), 1.0, Criterion())


FOLDERS = ("estimators", "robots")
PATHS = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
FILES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in PATHS}


def walk(*kinds):
    """Nodes of some kinds in all files of estimators and robots, with their files."""
    return [(path, node) for path, tree in FILES.items() for node in ast.walk(tree) if isinstance(node, kinds)]


def find_functions():
    """Return the functions with a default criterion, by class and name; a class stands for its constructor."""
    functions = {}
    for _, owner in walk(ast.Module, ast.ClassDef):
        for node in owner.body:
            if isinstance(node, ast.FunctionDef):
                arguments = node.args.args[len(node.args.args) - len(node.args.defaults) :]
                defaults = [*zip(arguments, node.args.defaults, strict=True)]
                defaults += zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
                found = [default for argument, default in defaults if argument.arg == "criterion" and default]
                functions |= {(getattr(owner, "name", ""), node.name): found[0] for _ in found[:1]}
            elif isinstance(node, ast.AnnAssign) and getattr(node.target, "id", "") == "criterion" and node.value:
                functions["", owner.name] = node.value
    return functions


def is_criterion(node):
    """Whether an argument is the criterion, or one of its records."""
    return getattr(node, "id", getattr(node, "attr", "")) == "criterion"


def test_nothing_reads_a_limit_of_the_class_or_makes_a_criterion_but_as_a_default():
    read = [(path, node.lineno) for path, node in walk(ast.Attribute) if getattr(node.value, "id", "") == "Criterion"]
    made = [(path, node) for path, node in walk(ast.Call) if getattr(node.func, "id", "") == "Criterion"]
    defaults = {id(part) for default in find_functions().values() for part in ast.walk(default)}
    assert read == []
    assert [(path, node.lineno) for path, node in made if id(node) not in defaults] == []
    assert all(not name.startswith("_") for _, name in find_functions() if name != "__init__")


def test_callers_pass_the_criterion_on():
    functions = find_functions()
    known = {(path, alias.name) for path, node in walk(ast.ImportFrom) for alias in node.names}
    known |= {(path, node.name) for path, tree in walk(ast.Module) for node in tree.body if hasattr(node, "name")}
    for path, function in walk(ast.FunctionDef):
        for call in (node for node in ast.walk(function) if isinstance(node, ast.Call)):
            owner, _, name = ast.unparse(call.func).rpartition(".")
            if (owner, name) in functions and (path, owner or name) in known:
                values = [*call.args, *(keyword.value for keyword in call.keywords)]
                assert any(map(is_criterion, values)), f"{path}:{call.lineno}: {name} has the default criterion"


def test_each_limit_is_read():
    read = {(getattr(node.value, "attr", getattr(node.value, "id", "")), node.attr) for _, node in walk(ast.Attribute)}
    for field in fields(Criterion):
        assert ("criterion", field.name) in read
        limits = getattr(Criterion(), field.name)
        for own in fields(limits) if is_dataclass(limits) else ():
            assert {(field.name, own.name), ("limits", own.name)} & read, f"{field.name}.{own.name} is not read"
