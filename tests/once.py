"""Results that several tests read: each is made once, by whichever process needs it first, and kept on disk for all."""

import contextlib
import functools
import hashlib
import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

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
    """Make a function's result once for all the same arguments; `pickle` has to take these and the result.

    Nobody may change the result. It is made again as soon as one of the sources has changed, or the file of the
    function.

    Args:
        sources: folders of this repository that the result depends on.
    """

    def decorate(make: Callable[P, R]) -> Callable[P, R]:
        digest, known = _digest(Path(make.__code__.co_filename), *sources), dict[str, R]()  # of what is imported now

        @functools.wraps(make)
        def made(*args: P.args, **kwargs: P.kwargs) -> R:
            asked = pickle.dumps((digest, args, sorted(kwargs.items())))
            name = f"{make.__qualname__}-{hashlib.sha256(asked).hexdigest()[:16]}"
            if name not in known:
                known[name] = _kept(FOLDER / f"{name}.pickle", functools.partial(make, *args, **kwargs))
            return known[name]

        return made

    return decorate


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
