"""Sessions: what each browser tab works on, apart from all others."""

import re
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from threading import RLock
from typing import Any

from pendulum_env.arms.joints import Links
from pendulum_env.errors import ColumnError
from pendulum_env.recording import RecordingError, Source
from workbench.app import uploads
from workbench.app.card import ColumnCard
from workbench.app.jobs import Job, Task, Workers
from workbench.app.state import LoadedRecording, State
from workbench.errors import USER_ERRORS, InputError, format_mistake
from workbench.inputs import read_model
from workbench.robot import RobotFile

UNDONE = 20  # changes that can be taken back
GRACE = 1.0  # [s] that an end waits for an answer that is being made
MOST = 16  # sessions; of more, the one that was used least recently ends
ID = re.compile(r"[0-9a-f]{32}")  # of a session: random, drawn by the page; never part of a path


class Session:
    """Session of one tab: current and past states, and background jobs.

    The state is a value: read it once, and all that is drawn from it fits together. It is replaced under `lock`.
    """

    def __init__(self, folder: Path, workers: Workers | None = None) -> None:
        """Take the folder for files from the page, and who does long work."""
        self.folder, self.workers = folder, workers or Workers()
        self.lock = RLock()
        self.state = State()  # what the session knows now
        self._past: list[tuple[str, State]] = []  # what was done, and the state before
        self.cards: tuple[ColumnCard, ...] = ()  # recordings whose columns a person is asked about, the first one now
        self.notice = ""  # a sentence for the user: what went wrong
        self.version = time.time_ns() // 1_000_000  # grows with all that the page shows; no two sessions share one
        self.job: Job | None = None
        self._fitting: State | None = None  # the state whose base model a job fits
        self._begun = self._over = False

    def begin(self, sources: Sequence[Source], robot: RobotFile | None) -> None:
        """Take in what every session begins with, once; who asks meanwhile waits."""
        if self._begun:
            return
        with self.lock:
            if robot is not None and not self._begun:
                self.act(lambda: self.take_robot(robot))
            if sources and not self._begun:
                self.act(lambda: self.load(sources))
            self._begun = True

    # ---------------------------------------------------------------------------------------------- changes

    def change(self, what: str, state: State) -> None:
        """Become another state; `what` is done, in the words of the button that takes it back."""
        self._past = [*self._past[1 - UNDONE :], (what, self.state)]
        self.state = state

    @property
    def last_change(self) -> str:
        """Describe the change that `undo` reverts; empty without one."""
        return self._past[-1][0] if self._past else ""

    def undo(self) -> None:
        """Take back the last change, whatever it was; raises InputError if there is none."""
        if not self._past:
            raise InputError("there is nothing to undo")
        _, self.state = self._past.pop()
        known = {item.id for item in self.state.loaded}
        self.cards = tuple(card for card in self.cards if not card.known or card.known in known)

    def act(self, do: Callable[[], object]) -> None:
        """Do what a user asked for, then fit what has changed; a mistake becomes the notice.

        Nothing changes while another job than a fit works on the state.
        """
        with self.lock:
            self.notice = ""
            self.version += 1
            try:
                if self._over:
                    raise InputError("this session has ended: load the page again")
                if self.is_busy():
                    raise InputError("wait for what is running, or cancel it first")
                do()
            except USER_ERRORS as mistake:
                self.notice = self.describe_mistake(mistake)
            if not self.is_busy():
                self._fit()

    def describe_mistake(self, mistake: Exception) -> str:
        """Describe a mistake as the command line does, without the folders of files from the page."""
        return re.sub(rf"{re.escape(str(self.folder))}/(tmp\w+/)?", "", format_mistake(mistake))

    # ------------------------------------------------------------------------------------------------- work

    def is_busy(self) -> bool:
        """Return whether a job is running that no change may disturb."""
        return self.job is not None and self.job.running and self._fitting is None

    def work(self, title: str, task: Task, keep: Callable[[Any], None]) -> None:
        """Do a task in the background and keep what comes of it, unless the user lets go of it; called by `act`."""
        self._stop()
        self.run(title, task, lambda job: self.act(lambda: keep(job.result)))

    def run(self, title: str, task: Task, ended: Callable[[Job], None]) -> None:
        """Start the job of the session."""

        def end_job(job: Job) -> None:
            with self.lock:
                if self.job is job:
                    self.job = self._fitting = None
                    ended(job)

        self.job = Job(title, task, self.workers)
        self.job.call_at_end(end_job)

    def _fit(self) -> None:
        """Fit the base model of the present state in the background, if it has none; a fit of another state ends."""
        state = self.state
        if state is self._fitting or self._over:
            return
        self._stop()
        if not state.needs_fit:
            return

        def keep_fit(job: Job) -> None:
            try:
                self.state = state.with_fit(job.result)
            except InputError as mistake:
                self.state = replace(state, failure=str(mistake))
            self.version += 1

        self._fitting = state
        self.run("Fitting the model", state.make_fit_task(), keep_fit)

    def _stop(self) -> None:
        if self.job is not None:
            self.job.cancel()
        self.job = self._fitting = None

    def cancel(self) -> None:
        """Let go of the job; without its fit, a change is taken back."""
        with self.lock:
            is_fit = self._fitting is not None
            self._stop()
            self.version += 1
            if is_fit:
                self.act(self.undo)
            else:
                self._fit()

    # ------------------------------------------------------------------------------------------- recordings

    def place(self) -> Path:
        """Make a folder for files that come together, in which no other has their names."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)  # it may have been deleted
        return Path(tempfile.mkdtemp(dir=self.folder, prefix="tmp"))

    def receive(self, coming: Sequence[tuple[str, str]], unwrap: bool) -> None:
        """Take in uploads, names and data URLs: recordings, read as a study among them asks for, a robot and a model.

        Raises InputError, which names the files that cannot be used.
        """
        came = uploads.sort_files(self.place(), coming, unwrap)
        if came.robots:
            joints = next((source.joints for source in came.sources), None)
            self.take_robot(RobotFile.of_model(came.robots[-1], came.models[-1] if came.models else None, joints))
        refused = [*came.refused, *self._read(came.sources)]
        if came.models:
            try:
                self.begin_from(came.models[-1])
            except USER_ERRORS as mistake:
                refused.append(format_mistake(mistake))
        _refuse(refused)

    def begin_from(self, file: Path) -> None:
        """Take the terms of a model file for the base model; the ladder starts anew.

        Raises ModelError if it is no model, as the command line does.
        """
        model = read_model(str(file), self.state.body)
        terms = tuple(term for term in model.terms if not isinstance(term, Links))
        self.change(f"start from {file.name}", self.state.restart(terms=terms, model_file=file.name))

    def take_robot(self, robot: RobotFile) -> None:
        """Take all recordings, those that wait for an answer included, for those of a robot; see `State.set_robot`."""
        waiting = [card.source for card in self.cards if not card.known]
        self.change(f"take {robot.file.name} for the robot", self.state.set_robot(robot))
        self.cards = ()
        self.load(waiting)

    def load(self, sources: Iterable[Source]) -> None:
        """Read recordings: those that can be read stay, and those whose columns are not clear wait: see `cards`.

        Raises InputError, which names those that cannot be read.
        """
        _refuse(self._read(sources))

    def _read(self, sources: Iterable[Source]) -> list[str]:
        """Read recordings as `load` does; returns what is wrong with those that cannot be read."""
        loaded, refused = list[LoadedRecording](), list[str]()
        for source in sources:
            try:
                loaded.append(LoadedRecording.read(source, [*self.state.loaded, *loaded], read=self.state.read))
            except ColumnError as error:
                try:
                    self.cards = (
                        *self.cards,
                        ColumnCard.from_source(source, why=self.describe_mistake(error), joints=self.state.moving),
                    )
                except RecordingError:
                    refused.append(format_mistake(error))
            except USER_ERRORS as mistake:
                refused.append(format_mistake(mistake))
        if loaded:
            self.keep(*loaded)
        return refused

    def keep(self, *loaded: LoadedRecording) -> None:
        """Add recordings; the ladder starts anew."""
        names = ", ".join(item.recording.name for item in loaded)
        self.change(f"load {names}", self.state.restart(loaded=(*self.state.loaded, *loaded)))

    def remove(self, id: str) -> None:
        """Remove a recording."""
        gone = self.state.find(id)
        self.cards = tuple(card for card in self.cards if card.known != id)
        self.change(f"remove {gone.recording.name}", self.state.swap_recording(gone))

    def hold_out(self, id: str, held_out: bool) -> None:
        """Keep a recording for checking, or fit it."""
        chosen = self.state.find(id)
        if chosen.held_out != held_out:
            source = replace(chosen.source, role="holdout" if held_out else "fit")
            self.change("fit or check", self.state.swap_recording(chosen, replace(chosen, source=source)))

    # ---------------------------------------------------------------------------------------------- columns

    def ask(self, id: str) -> None:
        """Ask about the columns of a recording that is loaded; raises RecordingError if there is nothing to choose."""
        card = ColumnCard.from_source(self.state.find(id).source, known=id, joints=self.state.moving)
        self.cards = (card, *(other for other in self.cards if other.known != id))

    def answer(self, card: ColumnCard) -> None:
        """Read the first card's file as a person says, and waiting ones with the same columns alike.

        What is wrong is told by the card, which stays.
        """
        rest = self.cards[1:]
        self.cards = rest
        others = [item for item in self.state.loaded if item.id != card.known]
        try:
            first = LoadedRecording.read(card.make_source(), others, read=self.state.read)
        except USER_ERRORS as mistake:
            self.cards = (replace(card, why=self.describe_mistake(mistake)), *rest)
            return
        if card.known:
            old = self.state.find(card.known)
            anew = replace(first.recording, name=old.recording.name)
            again = replace(old, source=first.source, recording=anew)
            self.change("read columns anew", self.state.swap_recording(old, again))
            return
        alike = [one for one in rest if not one.known and one.preview.headers == card.preview.headers]
        self.cards = tuple(one for one in rest if one not in alike)
        self.keep(first)
        self.load([replace(one.source, columns=first.source.columns, unwrap=first.source.unwrap) for one in alike])

    def end(self) -> None:
        """Stop what runs; nothing begins any more. No answer that takes long is waited for."""
        self._over = True
        if (job := self.job) is not None:
            job.cancel()
        if self.lock.acquire(timeout=GRACE):
            try:
                self.cancel()
            finally:
                self.lock.release()


def _refuse(refused: Sequence[str]) -> None:
    """Raise InputError if anything was refused."""
    if refused:
        raise InputError("; ".join(refused))


class Sessions:
    """All sessions of a server by the id that each page holds, and the workers that they share."""

    def __init__(self, recordings: Sequence[Source] = (), robot: RobotFile | None = None) -> None:
        """Make a folder for files from their pages; every session begins with the recordings."""
        self._recordings, self._robot = tuple(recordings), robot
        self.workers = Workers()
        self._folder = tempfile.TemporaryDirectory(prefix="pendulum-ident-", ignore_cleanup_errors=True)
        self._all: dict[str, Session] = {}  # the one used last is last
        self._lock = RLock()

    def find_session(self, id: object) -> Session:
        """Return the session of an id, a new one if there is none; raises InputError if it is no id."""
        if not isinstance(id, str) or ID.fullmatch(id) is None:
            raise InputError("this page has no session: load it again")
        with self._lock:
            session = self._all.pop(id, None) or Session(Path(self._folder.name), self.workers)
            ended = [self._all.pop(k) for k in list(self._all)[: max(0, len(self._all) + 1 - MOST)]]
            self._all[id] = session
        session.begin(self._recordings, self._robot)  # no other session waits for it
        for other in ended:
            other.end()
        return session

    def close(self) -> None:
        """End all sessions and the workers, and delete the files from their pages."""
        with self._lock:
            for session in self._all.values():
                session.end()
            self._all.clear()
            self._folder.cleanup()
        self.workers.close()
