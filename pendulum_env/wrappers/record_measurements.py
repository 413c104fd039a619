"""Write the measurements of an environment to a file while it runs."""

import errno
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Any

import gymnasium as gym

from pendulum_env.files import check_output, sync_file

COLUMNS = ("time", "position", "torque")
TIMING = ("jitter", "overruns")  # further columns of a rig; readers of recordings ignore them


class RecordMeasurements(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Append every measurement to a CSV recording; a killed process loses at most the last second.

    Each row holds the torque that acts from its time on. It is therefore written one step after its measurement, and
    the last sample of an episode is omitted. A rig adds the columns jitter [s] and overruns, and its recording ends
    before a fault. The first episode is written to `path`, later ones to `path` with -2, -3, ... before the suffix.
    Episodes without a step have no file.
    """

    interval = 0.5  # [s] of measured time between writes

    def __init__(self, env: gym.Env[Any, Any], path: str | Path, *, overwrite: bool = False) -> None:
        """Wrap an environment with `time`, `position` and `torque` in `info`.

        Raises:
            ValueError: if the path does not end in .csv.
            OSError: if the folder is missing or not writable.
        """
        gym.utils.RecordConstructorArgs.__init__(self, path=str(path), overwrite=overwrite)
        gym.Wrapper.__init__(self, env)
        self.path = check_output(path)
        if self.path.suffix.lower() != ".csv":
            raise ValueError(f"{path}: measurements are appended to a CSV file: let the name end in .csv")
        self._overwrite, self._episode = overwrite, 0
        self._joints: Sequence[str] | None = getattr(env.unwrapped, "joints", None)  # names of several joints
        self._file: FileIO | None = None  # unbuffered: a killed process loses no written rows
        self._rows: list[str] = []
        self._write_error: OSError | None = None  # write error of this episode

    def get_file(self, episode: int) -> Path:
        """Return the file of an episode, counted from 1."""
        return self.path if episode == 1 else self.path.with_stem(f"{self.path.stem}-{episode}")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; the next step opens a new file."""
        self._finish()
        self._write_error = None
        observation, info = self.env.reset(seed=seed, options=options)
        self._last_info, self._written_at = info, info["time"]
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment and record the measurement.

        Raises:
            FileExistsError: at the first step, if the file exists and `overwrite` is False.
            OSError: if the measurements cannot be written; the message has the recorded time [s].
        """
        if self._write_error is not None:
            raise self._write_error
        if self._file is None:
            self._open()
        observation, reward, terminated, truncated, info = self.env.step(action)
        previous, self._last_info = self._last_info, info
        if "fault" not in info:  # a fault has no measurement
            measured = (previous["position"], info["torque"])
            values = measured if self._joints is None else (*measured[0], *measured[1])
            row = (previous["time"], *values, *(previous[name] for name in TIMING if name in previous))
            self._rows.append(",".join(repr(float(value)) for value in row) + "\n")
        is_due = not math.isfinite(info["time"]) or info["time"] >= self._written_at + self.interval
        if terminated or truncated or is_due:
            self._flush()
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Write the remaining rows and close the environment.

        Raises:
            OSError: if the rows cannot be written; the message has the recorded time [s].
        """
        try:
            super().close()
        finally:  # after the motor has stopped
            self._finish()

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a copy, without the open file."""
        return {**self.__dict__, "_file": None, "_rows": []}

    def _open(self) -> None:
        path = self.get_file(self._episode + 1)
        try:
            self._file = FileIO(path, "wb" if self._overwrite else "xb")
        except FileExistsError:
            raise FileExistsError(f"{path}: exists already: choose another name, or pass overwrite=True") from None
        self._episode += 1
        columns: tuple[str, ...] = COLUMNS
        if self._joints is not None:
            columns = ("time", *(f"{quantity}_{joint}" for quantity in COLUMNS[1:] for joint in self._joints))
        self._rows = [",".join((*columns, *(name for name in TIMING if name in self._last_info))) + "\n"]
        self._flush()

    def _flush(self) -> None:
        """Write the rows by one call, so that a killed process leaves no partial row."""
        if self._file is not None and self._rows:
            data, self._rows = "".join(self._rows).encode(), []
            with self._close_on_error():
                if self._file.write(data) != len(data):  # a full disk may write a part
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._written_at = self._last_info["time"]

    def _finish(self) -> None:
        """Write the remaining rows to the disk and close the file."""
        self._flush()
        if self._file is not None:
            with self._close_on_error():
                sync_file(self._file)
            self._file.close()
            self._file = None

    @contextmanager
    def _close_on_error(self) -> Iterator[None]:
        """At an error, close the file; each later step of the episode raises the error again."""
        try:
            yield
        except OSError as error:
            assert self._file is not None
            with suppress(OSError):
                self._file.close()
            self._file = None
            message = f"{error.strerror}: {self._written_at:.3g} s were written: make room, and record again"
            self._write_error = OSError(error.errno, message, str(self.get_file(self._episode)))
            raise self._write_error from error
