"""Re-exports of a package that are imported at their first use (PEP 562)."""

import ast
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path


def lazy_exports(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package with its imports under `if TYPE_CHECKING:`.

    Type checkers read these imports. At run time, the first use of a name imports its module only.
    """
    module = sys.modules[package]

    @cache
    def find_sources() -> dict[str, str]:
        tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
        imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
        return {alias.name: str(node.module) for node in imports for alias in node.names}

    def get(name: str) -> object:
        if name.startswith("__") or name not in find_sources():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(find_sources()[name]), name)
        setattr(module, name, value)
        return value

    def list_names() -> list[str]:
        return sorted({*vars(module), *module.__all__})

    return get, list_names
