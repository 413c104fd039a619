"""Effects in a file of the user's own, without a package around it."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from pathlib import Path

from pendulum_env.mistake import Mistake
from pendulum_env.physics import library
from pendulum_env.physics.term import Term

_loaded: dict[Path, tuple[type[Term], ...]] = {}


class PluginError(Mistake):
    """A file of effects that cannot be used; the message says where and why."""


def load_plugin(path: str | Path) -> tuple[type[Term], ...]:
    """Run a Python file whose effects register themselves, see `register`; returns them.

    It runs once: what is loaded again is what it was.

    Raises:
        PluginError: if there is no such file, it fails, or it registers nothing.
    """
    file = Path(path).resolve()
    if file not in _loaded:
        before = set(library.effects().values())
        _run(file, path)
        kinds = tuple(kind for kind in library.effects().values() if kind not in before)
        if not kinds:
            raise PluginError(f"{path}: registers no effect: put @register from pendulum_env.physics above its class")
        _loaded[file] = kinds
    return tuple(library.register(kind) for kind in _loaded[file])


def plugins() -> tuple[Path, ...]:
    """Files whose effects this process knows: what a process that it starts has to load, too."""
    return tuple(_loaded)


def _run(file: Path, path: str | Path) -> None:
    if file.suffix != ".py" or not file.is_file():
        raise PluginError(f"{path}: is no Python file: name one that registers effects")
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None, "a .py file has a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(file.stem, module)  # dataclasses look there for the module of a class
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise PluginError(f"{path}, line {error.lineno}: {error.msg}") from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's file does wrong is told in a sentence, sys.exit as well
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
        where = f", line {lines[-1]}" if lines else ""
        told = "".join(traceback.format_exception_only(error)).strip()  # of any exception, even if it cannot say it
        raise PluginError(f"{path}{where}: {told}") from None
