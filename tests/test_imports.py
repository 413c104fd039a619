"""Imports between the modules of the packages, those for type hints and those inside functions included."""

import ast
import subprocess
import sys
from collections.abc import Set
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("pendulum_env", "estimators", "agents", "robots", "workbench")  # each may import those before it
ROOT = Path(__file__).parents[1]


@cache
def find_imports() -> dict[str, set[str]]:
    """Find the modules of the four packages that each of their modules imports."""
    files = {_name(file): file for package in PACKAGES for file in (ROOT / package).rglob("*.py")}
    return {module: _imported(file, files.keys()) - {module} for module, file in files.items()}


def _name(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def _imported(file: Path, known: Set[str]) -> set[str]:
    """Known modules that a file imports: `from package import name` imports a module of the package or the package.

    The imports of a stub beside it are relative, and happen at the first use of a name.
    """
    imported: set[str] = set()
    stub = file.with_suffix(".pyi")
    if stub.exists():
        nodes = ast.walk(ast.parse(stub.read_text(encoding="utf-8")))
        imported = {f"{_name(file)}.{node.module}" for node in nodes if isinstance(node, ast.ImportFrom)}
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module is not None and node.level == 0, f"{file} has a relative import"
            modules = {f"{node.module}.{alias.name}" for alias in node.names}
            imported |= modules if modules <= known else (modules & known) | {node.module}
    return imported & known


def test_modules_import_each_other_in_no_circle():
    TopologicalSorter(find_imports()).prepare()  # a CycleError names the modules of a circle


def test_folders_of_estimators_import_each_other_in_no_circle():
    folders: dict[str, set[str]] = {}
    for module, imported in find_imports().items():
        if module.startswith("estimators."):
            own = folders.setdefault(_folder(module), set())
            own |= {_folder(other) for other in imported if other.startswith("estimators.")} - {_folder(module)}
    TopologicalSorter(folders).prepare()


def _folder(module: str) -> str:
    """Folder or top module of the package."""
    return module.split(".")[1]


def test_packages_depend_one_way():
    order = {package: k for k, package in enumerate(PACKAGES)}
    upward = [
        (module, other)
        for module, imported in find_imports().items()
        for other in imported
        if order[other.partition(".")[0]] > order[module.partition(".")[0]]
    ]
    assert not upward


def test_the_workbench_meets_robots_by_entry_points_alone():
    importing = [
        (module, other)
        for module, imported in find_imports().items()
        for other in imported
        if module.startswith("workbench") and other.partition(".")[0] == "robots"
    ]
    assert not importing


def test_help_waits_for_no_library_but_gymnasium_s_own():
    code = (
        "import sys; from workbench.cli import main; main(['--help']); "
        "print({name.partition('.')[0] for name in sys.modules}, 'pendulum_env.physics' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded, is_physics_loaded = done.stdout.splitlines()[-1].rsplit(" ", 1)
    assert is_physics_loaded == "False"
    assert not {"scipy", "pyarrow", "h5py", "msgspec", "estimators", "agents", "torch"} & ast.literal_eval(loaded)


def test_identify_loads_no_library_before_it_is_used():
    code = "import sys, workbench.commands.identify; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    unused = {"scipy.optimize", "matplotlib", "torch", "pinocchio", "mujoco", "pymunk", "llvmlite"}
    assert not unused & set(done.stdout.split())


def test_every_export_is_found():
    for package in {_name(file) for top in PACKAGES for file in (ROOT / top).rglob("__init__.py")}:
        module = import_module(package)
        for name in getattr(module, "__all__", ()):
            assert name in dir(module) and hasattr(module, name), f"{package}.{name}"
            assert find_spec(f"{package}.{name}") is None, f"a submodule would take the place of {package}.{name}"
