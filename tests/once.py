"""Results that several tests read: each is made once, by whichever process needs it first, and kept on disk for all."""

import contextlib
import dataclasses
import functools
import hashlib
import io
import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy
import scipy
from filelock import FileLock

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / ".pytest_cache" / "results"
KEPT = 86_400.0  # [s], a day
KERNELS = ("OPENBLAS_CORETYPE", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")

P = ParamSpec("P")
R = TypeVar("R")


def once(*sources: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make a function's result once for all equal arguments; `pickle` has to take these and the result.

    Arguments are equal if their data are, whatever they have memoised. Nobody may change the result. It is made again
    as soon as one of the sources has changed, or the file of the function.

    Args:
        sources: folders of this repository that the result depends on.
    """

    def decorate(make: Callable[P, R]) -> Callable[P, R]:
        digest, known = _digest(Path(make.__code__.co_filename), *sources), dict[str, R]()  # of what is imported now

        @functools.wraps(make)
        def made(*args: P.args, **kwargs: P.kwargs) -> R:
            name = f"{make.__qualname__}-{_hash((digest, args, sorted(kwargs.items())))}"
            if name not in known:
                known[name] = _kept(FOLDER / f"{name}.pickle", functools.partial(make, *args, **kwargs))
            return known[name]

        return made

    return decorate


class _DataPickler(pickle.Pickler):
    """Pickles the fields of data classes without memoised results, and shared objects as equal ones."""

    def reducer_override(self, value: Any) -> Any:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return type(value), tuple(getattr(value, field.name) for field in dataclasses.fields(value))
        return NotImplemented


def _hash(asked: object) -> str:
    """Hash the data of some arguments."""
    file = io.BytesIO()
    pickler = _DataPickler(file)
    pickler.fast = True
    pickler.dump(asked)
    return hashlib.sha256(file.getvalue()).hexdigest()[:16]


def _kept(path: Path, make: Callable[[], R]) -> R:
    """The result in a file, which is made by the first who asks."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{path}.lock"):
        if not path.exists():
            new = path.with_suffix(".new")
            new.write_bytes(pickle.dumps(make()))
            new.rename(path)
        return pickle.loads(path.read_bytes())  # type: ignore[no-any-return]


@functools.cache
def _digest(own: Path, *sources: str) -> str:
    """What tells these sources, and the libraries and kernels that they compute with, from others."""
    computed = [numpy.__version__, scipy.__version__, *(os.environ.get(name, "") for name in KERNELS)]
    digest = hashlib.sha256(own.read_bytes() + " ".join(computed).encode())
    for path in sorted(path for source in sources for path in (ROOT / source).rglob("*.py")):
        digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return digest.hexdigest()


def forget() -> None:
    """Remove what was made long ago."""
    for path in FOLDER.glob("*"):
        with contextlib.suppress(FileNotFoundError):  # another run may do the same
            if time.time() - path.stat().st_mtime > KEPT:
                path.unlink()
