"""Recordings of a session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pendulum_env.recording import Recording, Source
from pendulum_env.recording.study import find_duplicate
from workbench.errors import InputError


def read_one(source: Source) -> Recording:
    """Read a recording of a pendulum; raises RecordingError, in the words of the command line."""
    return replace(source.read(), drive=None)  # pages draw it by its torque


@dataclass(frozen=True, eq=False)
class LoadedRecording:
    """A recording of a session."""

    id: str  # by which the page names it: that of its file, with a number where several are of one file
    source: Source  # how its file is read, and whether it is held out
    recording: Recording  # what that gives
    origin: tuple[str, ...] = ()  # arguments of `pendulum-ident record` that made it; empty if it was uploaded

    @classmethod
    def read(
        cls,
        source: Source,
        known: Sequence[LoadedRecording] = (),
        origin: tuple[str, ...] = (),
        read: Callable[[Source], Recording] = read_one,
    ) -> LoadedRecording:
        """Read a recording beside those that are known, of whose files it may be another range.

        Raises InputError if it is known already, and RecordingError if it cannot be read, in the words of the command
        line.
        """
        name, ids = source.file.name, {one.id for one in known}
        alike = [one.source for one in known if one.source.file.name == name]
        if any(one.file != source.file or find_duplicate((one, source)) for one in alike):
            raise InputError(f"{name}: is loaded already: remove it, or give this one another name")
        recording = read(source)
        endings = ("", *(f" ({k})" for k in range(2, len(ids) + 2)))
        more = next(ending for ending in endings if name + ending not in ids)
        return cls(f"{name}{more}", source, replace(recording, name=f"{recording.name}{more}"), origin)

    @property
    def held_out(self) -> bool:
        """Return whether the recording is held out."""
        return self.source.role == "holdout"
