"""Sessions: what one browser tab works on, kept by the server, apart from all others."""

from __future__ import annotations

import re
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import RLock

from pendulum_env.recording import checks, columns, read_recording
from workbench.app.jobs import Job
from workbench.app.live import Run
from workbench.app.state import Loaded, State
from workbench.app.uploads import MODELS, UNWRAP, refuse_too_much, safe_name, unpack
from workbench.inputs import MISTAKES, InputError, Read, read_model, sentence

ID = re.compile(r"[0-9a-f]{32}")  # random, drawn by the page; never part of a path
MOST_SESSIONS = 16  # the one that was used least recently gives way
MOST_RECORDINGS = 12  # in one session


class Session:
    """One tab's work: a folder of its own, the state, and what runs in the background.

    The state is a value: read it once, and all that is drawn from it fits together. It is replaced under `lock`.
    """

    def __init__(self, folder: Path, rig: Path | None = None) -> None:
        """Take an empty folder, and the configuration of the rig if there is one."""
        self.folder, self.rig = folder, rig
        self.lock = RLock()
        self.state = State()
        self.notice = ""  # a sentence for the user: what went wrong
        self.version = time.time_ns() // 1_000_000  # grows with all that the page shows; no two sessions share one
        self.job: Job | None = None
        self.run: Run | None = None
        self._over = False

    def busy(self) -> bool:
        """Whether a job is on its way."""
        return self.job is not None and self.job.running

    def act(self, do: Callable[[], None]) -> None:
        """Do what a user asked for; a mistake becomes the notice. Nothing changes while a job works on the state."""
        with self.lock:
            self.notice = ""
            self.version += 1
            try:
                if self._over:
                    raise InputError("this session has ended: load the page again")
                if self.busy():
                    raise InputError("wait for what is running, or cancel it first")
                do()
            except MISTAKES as mistake:
                self.notice = self.plain(sentence(mistake))

    def start(self, job: Job) -> None:
        """Begin a job; called under the lock, so that it cannot end before it is known."""
        job.start()
        self.job = job

    def finish(self, job: Job, change: Callable[[], None]) -> None:
        """End a job: the change is made unless the user has let go of it."""
        with self.lock:
            if self.job is job:
                self.job = None
                change()
                self.version += 1

    def fail(self, job: Job, why: str) -> None:
        """End a job that came to nothing."""

        def tell() -> None:
            self.notice = self.plain(why)

        self.finish(job, tell)

    def plain(self, text: str) -> str:
        """A sentence in the page's words: about files without the session's folder, and controls for options."""
        here = {checks.UNWRAP: f"tick '{UNWRAP}' and load it again", columns.CHOOSE: "rename columns in the file"}
        text = text.replace(f"{self.folder}/", "")
        for option, control in here.items():
            text = text.replace(option, control)
        return text

    def cancel(self) -> None:
        """Let go of the job."""
        with self.lock:
            if self.job is not None:
                self.job.cancel()
            self.job = None
            self.version += 1

    # ------------------------------------------------------------------------------------------- recordings

    def place(self, name: str, *coming: Loaded) -> Path:
        """Where a recording of that name goes: always in the session's folder, whatever the name is.

        Args:
            name: as the page has it.
            coming: recordings that are about to be kept.

        Raises:
            InputError: if there is one of that name, or too many.
        """
        file, known = self.folder / safe_name(name), (*self.state.loaded, *coming)
        if any(one.file == file for one in known):
            raise InputError(f"{file.name}: is loaded already: remove it, or give this one another name")
        if len(known) >= MOST_RECORDINGS:
            raise InputError(f"{file.name}: {MOST_RECORDINGS} recordings are enough: remove one first")
        return file

    def receive(self, uploads: Sequence[tuple[str, str]], unwrap: bool) -> None:
        """Take in uploaded recordings, names and data URLs; those that can be read stay.

        Raises:
            InputError: naming those that cannot, in the words of the command line.
        """
        loaded: list[Loaded] = []
        refused = []
        for name, content in uploads:
            try:
                file = self.place(name, *loaded)
                unpack(file, content)
                loaded.append(self.read(file, partial(read_recording, unwrap=unwrap)))
            except MISTAKES as mistake:
                refused.append(sentence(mistake))
        if loaded:
            self.keep(*loaded)
        if refused:
            raise InputError("; ".join(refused))

    def read(self, file: Path, read: Read = read_recording) -> Loaded:
        """Read a file of the folder; one that cannot be read does not stay.

        Raises:
            RecordingError: if it cannot be read, in the words of the command line.
        """
        try:
            refuse_too_much(file)
            return Loaded(file, read(file))
        except MISTAKES:
            file.unlink(missing_ok=True)
            raise

    def copy(self, files: Sequence[Path], read: Read) -> None:
        """Take in copies of recordings that lie elsewhere."""
        loaded: list[Loaded] = []
        for original in files:
            file = self.place(original.name, *loaded)
            shutil.copyfile(original, file)
            loaded.append(self.read(file, read))
        self.keep(*loaded)

    def keep(self, *loaded: Loaded) -> None:
        """Add recordings; the ladder starts anew."""
        self.state = self.state.having((*self.state.loaded, *loaded))

    def find(self, name: str) -> Loaded:
        """The recording in a file of that name.

        Raises:
            InputError: if there is none.
        """
        for one in self.state.loaded:
            if one.file.name == name:
                return one
        raise InputError(f"{safe_name(name)}: is not loaded any more")

    def remove(self, name: str) -> None:
        """Remove a recording."""
        gone = self.find(name)
        gone.file.unlink(missing_ok=True)
        self.state = self.state.having([one for one in self.state.loaded if one is not gone])

    def hold_out(self, name: str, held_out: bool) -> None:
        """Keep a recording for checking, or fit it."""
        chosen = self.find(name)
        if chosen.held_out != held_out:
            swapped = [replace(one, held_out=held_out) if one is chosen else one for one in self.state.loaded]
            self.state = self.state.having(swapped)

    def begin_from(self, name: str, content: str) -> None:
        """Take the terms of an uploaded model as the base model; the ladder starts anew.

        Raises:
            InputError: if the file did not arrive whole.
            ModelError: if it is no model, in the words of the command line.
        """
        file = self.folder / safe_name(name, MODELS)
        unpack(file, content)
        try:
            self.state = State.of(self.state.loaded, read_model(str(file)).terms, file.name)
        finally:
            file.unlink()

    def halt(self) -> None:
        """Stop the live run, whatever else is going on, and one that is just being started."""
        run = self.run
        if run is not None:
            run.stop()  # at once: long work may hold the lock
        with self.lock:
            if self.run is not None:
                self.run.stop()
            self.version += 1

    def end(self) -> None:
        """Stop what runs and delete the folder; nothing begins any more."""
        self._over = True
        self.halt()
        with self.lock:
            self.cancel()
            shutil.rmtree(self.folder, ignore_errors=True)


class Sessions:
    """All sessions of a server by the id that each page holds."""

    def __init__(self, recordings: Sequence[Path] = (), read: Read = read_recording, rig: Path | None = None) -> None:
        """Make a folder for their folders; every session begins with a copy of the recordings, and may run the rig."""
        self._initial, self._read, self._rig = tuple(recordings), read, rig
        self._root = tempfile.TemporaryDirectory(prefix="pendulum-ident-")
        self._all: dict[str, Session] = {}
        self._lock = RLock()

    def of(self, id: object) -> Session:
        """Session of an id, a new one if there is none.

        Raises:
            InputError: if it is no id.
        """
        if not isinstance(id, str) or ID.fullmatch(id) is None:
            raise InputError("this page has no session: load it again")
        with self._lock:
            known = self._all.pop(id, None)
            session = known or Session(Path(tempfile.mkdtemp(dir=self._root.name)), self._rig)
            if known is None:
                session.lock.acquire()  # who asks for it next waits for its recordings, who asks for another does not
            self._all[id] = session  # the one used last is last
            oldest = next(iter(self._all))
            gone = self._all.pop(oldest) if len(self._all) > MOST_SESSIONS else None
        if known is None:
            try:
                if self._initial:
                    session.act(lambda: session.copy(self._initial, self._read))
            finally:
                session.lock.release()
        if gone is not None:
            gone.end()
        return session

    def close(self) -> None:
        """End all sessions, motors first."""
        with self._lock:
            for session in self._all.values():
                if session.run is not None:
                    session.run.stop()
            for session in self._all.values():
                session.end()
            self._all.clear()
            self._root.cleanup()
