"""Load effects from Python files."""

from __future__ import annotations

import importlib.util
import inspect
import sys
import traceback
from pathlib import Path

from pendulum_env.errors import UserError, format_error
from pendulum_env.physics import library
from pendulum_env.physics.term import Term

_loaded: dict[Path, tuple[type[Term], ...]] = {}


class PluginError(UserError):
    """Invalid file of effects; the message has the place and the reason."""


def load_plugin(path: str | Path) -> tuple[type[Term], ...]:
    """Run a Python file that registers effects, and return them.

    The file runs once; later calls return the same effects.

    Raises:
        PluginError: if the file is missing, fails, or registers no effect.
    """
    file = Path(path).resolve()
    if file not in _loaded:
        before = set(library.effects().values())
        try:
            _run_file(file, path)
        except (KeyboardInterrupt, PluginError):
            raise
        except BaseException as error:  # sys.exit included
            raise _make_plugin_error(error, file, path) from None
        kinds = tuple(kind for kind in library.effects().values() if kind not in before)
        if not kinds:
            raise PluginError(f"{path}: registers no effect: put @register from pendulum_env.physics above its class")
        _loaded[file] = kinds
    return tuple(library.register(kind) for kind in _loaded[file])


def list_plugins() -> tuple[Path, ...]:
    """List the loaded files, which a child process must load too."""
    return tuple(_loaded)


def describe_fault(error: BaseException) -> PluginError | None:
    """Return the PluginError of an error in the code of a loaded effect, or None for other errors."""
    files = (*_loaded, *(Path(inspect.getfile(kind)) for kind in library.load_installed()))
    return next((_make_plugin_error(error, file, file) for file in files if _find_lines(error, file)), None)


def _run_file(file: Path, path: str | Path) -> None:
    if file.suffix != ".py" or not file.is_file():
        raise PluginError(f"{path}: is no Python file: name one that registers effects")
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None, "a .py file has a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(file.stem, module)  # dataclasses find the module of a class here
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        location = f", line {error.lineno}" if error.lineno else ""
        raise PluginError(f"{path}{location}: {error.msg}") from None


def _make_plugin_error(error: BaseException, file: Path, path: str | Path) -> PluginError:
    location = f", line {lines[-1]}" if (lines := _find_lines(error, file)) else ""
    return PluginError(f"{path}{location}: {format_error(error)}")


def _find_lines(error: BaseException, file: Path) -> list[int | None]:
    """Return the lines of a file in the traceback of an error and of its cause."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
    return lines + (_find_lines(error.__cause__, file) if error.__cause__ is not None else [])
