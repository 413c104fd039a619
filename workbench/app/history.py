"""What a session knows, and what it knew before each change: every change can be taken back."""

from __future__ import annotations

from collections import deque
from pathlib import Path

from workbench.app.state import State, change
from workbench.mistakes import InputError

MOST_UNDONE = 20  # changes
MOST_SAMPLES = 20_000_000  # of all recordings of a state, and of all past states: either takes less than a gigabyte


class History:
    """The state of a session and those before it; files of recordings that none of them has any more are deleted."""

    def __init__(self) -> None:
        """Nothing is known, and nothing was."""
        self.now = State()
        self._past = deque[State]()
        self._changed: int | None = None  # version of the last change

    def change(self, state: State, version: int) -> None:
        """Become another state; all changes of one version of the page, as one click makes them, are undone at once."""
        if state is self.now:
            return
        if self._changed != version:
            self._past.append(self.now)
            self._changed = version
        self.now = state
        while len(self._past) > MOST_UNDONE or sum(past.samples for past in self._past) > MOST_SAMPLES:
            self._sweep(self._past.popleft())  # each state has made something of its own of its samples

    @property
    def last(self) -> str:
        """What `undo` would take back, in words; empty if there is nothing."""
        return change(self._past[-1], self.now) if self._past else ""

    def undo(self) -> None:
        """Take back the last change, whatever it was.

        Raises:
            InputError: if there is none.
        """
        if not self._past:
            raise InputError("there is nothing to undo")
        gone, self.now = self.now, self._past.pop()
        self._sweep(gone)

    def keeps(self, file: Path) -> bool:
        """Whether undoing a change would bring back the recording in a file."""
        return any(one.file == file for past in self._past for one in past.loaded)

    def forget(self) -> None:
        """Nothing can be undone any more, and files that were kept for it go."""
        while self._past:
            self._sweep(self._past.popleft())

    def begin(self, state: State) -> None:
        """Start from a state whose files lie elsewhere: those of all others are left alone."""
        self.now = state
        self._past.clear()

    def _sweep(self, gone: State) -> None:
        """Delete recordings of a state that has gone, if no other has them."""
        kept = {one.file for state in (*self._past, self.now) for one in state.loaded}
        for one in gone.loaded:
            if one.file not in kept:
                one.file.unlink(missing_ok=True)
