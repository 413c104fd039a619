"""Sessions: one independent state for each browser tab."""

import re
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from threading import RLock
from typing import Any

from pendulum_env.errors import ColumnError
from pendulum_env.physics.joints import Links
from pendulum_env.recording import RecordingError, Source
from pendulum_env.robot_file import RobotFile
from workbench.app import uploads
from workbench.app.card import ColumnCard
from workbench.app.jobs import Job, Task, Workers
from workbench.app.state import LoadedRecording, State
from workbench.errors import USER_ERRORS, InputError, format_mistake
from workbench.inputs import read_model
from workbench.robot import open_robot_file

MAX_UNDO = 20  # largest number of changes to undo
GRACE = 1.0  # longest wait for a running request at the end of a session [s]
MAX_SESSIONS = 16  # largest number of sessions; a further one ends the least recently used
ID = re.compile(r"[0-9a-f]{32}")  # session id, drawn by the page; never part of a path


class Session:
    """Session of one tab: current and past states, and background jobs.

    `state` is immutable and replaced under `lock`. Read it once per request to get consistent values.
    """

    def __init__(self, folder: Path, workers: Workers | None = None) -> None:
        """Set the folder for uploaded files, and the workers for jobs."""
        self.folder, self.workers = folder, workers or Workers()
        self.lock = RLock()
        self.state = State()
        self.past: list[tuple[str, State]] = []  # changes, each with the state before
        self.undone: list[tuple[str, State]] = []  # undone changes, each with the state after
        self.cards: tuple[ColumnCard, ...] = ()  # files that need a column assignment; the page shows the first
        self.notice = ""  # error message on the page
        self.version = time.time_ns() // 1_000_000  # grows with each change; unique among sessions
        self.job: Job | None = None
        self._fitting: State | None = None  # state of the running fit
        self._fitted_checks: set[Path] = set()  # files to hold out, fitted until another recording is
        self._has_begun = self._has_ended = False

    def begin(self, sources: Sequence[Source], robot: RobotFile | None) -> None:
        """Load the initial robot and recordings on the first call; concurrent calls wait."""
        if self._has_begun:
            return
        with self.lock:
            if robot is not None and not self._has_begun:
                self.run_action(lambda: self.set_robot(robot))
            if sources and not self._has_begun:
                self.run_action(lambda: self.load(sources))
            self._has_begun = True

    # ---------------------------------------------------------------------------------------------- changes

    def change(self, description: str, state: State) -> None:
        """Replace the state; `description`: description of the change for the undo button."""
        self.past, self.undone = [*self.past[1 - MAX_UNDO :], (description, self.state)], []
        self.state = state

    @property
    def last_change(self) -> str:
        """Return the description of the change that `undo` reverts; empty without one."""
        return self.past[-1][0] if self.past else ""

    def undo(self, is_redo: bool = False) -> None:
        """Revert the last change, or the last undo; raises InputError without one."""
        source, target = (self.undone, self.past) if is_redo else (self.past, self.undone)
        if not source:
            raise InputError(f"there is nothing to {'redo' if is_redo else 'undo'}")
        target.append((source[-1][0], self.state))
        _, self.state = source.pop()
        loaded_ids = {item.id for item in self.state.loaded}
        self.cards = tuple(card for card in self.cards if not card.loaded_id or card.loaded_id in loaded_ids)

    def run_action(self, action: Callable[[], object]) -> None:
        """Run a user's action, then refit the base model if needed; an error becomes the notice.

        The action is refused while a job other than a fit is running.
        """
        with self.lock:
            self.notice = ""
            self.version += 1
            try:
                if self._has_ended:
                    raise InputError("this session has ended: load the page again")
                if self.is_busy():
                    raise InputError("wait for what is running, or cancel it first")
                action()
            except USER_ERRORS as mistake:
                self.notice = self.describe_mistake(mistake)
            if not self.is_busy():
                self._fit()

    def describe_mistake(self, mistake: Exception) -> str:
        """Format an error as on the command line, without the folders of uploaded files."""
        return re.sub(rf"{re.escape(str(self.folder))}/(tmp\w+/)?", "", format_mistake(mistake))

    # ------------------------------------------------------------------------------------------------- work

    def is_busy(self) -> bool:
        """Return whether a job other than a fit is running."""
        return self.job is not None and self.job.running and self._fitting is None

    def run_task(self, title: str, task: Task, keep_result: Callable[[Any], None]) -> None:
        """Run a task in the background and pass its result to `keep_result`, unless cancelled."""
        self._stop()
        self.run(title, task, lambda job: self.run_action(lambda: keep_result(job.result)))

    def run(self, title: str, task: Task, ended: Callable[[Job], None]) -> None:
        """Start a job, and call `ended` at its end unless another job has replaced it."""

        def end_job(job: Job) -> None:
            with self.lock:
                if self.job is job:
                    self.job = self._fitting = None
                    ended(job)

        self.job = Job(title, task, self.workers)
        self.job.call_at_end(end_job)

    def _fit(self) -> None:
        """Start the fit of the base model if the state needs it; cancel the fit of another state."""
        state = self.state
        if state is self._fitting or self._has_ended:
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
        """Cancel the job; if it is a fit, revert the change that needs it."""
        with self.lock:
            is_fit = self._fitting is not None
            self._stop()
            self.version += 1
            if is_fit:
                self.run_action(self.undo)
            else:
                self._fit()

    # ------------------------------------------------------------------------------------------- recordings

    def make_folder(self) -> Path:
        """Make a new folder for the files of one upload."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)  # it may have been deleted
        return Path(tempfile.mkdtemp(dir=self.folder, prefix="tmp"))

    def load_uploads(self, files: Sequence[tuple[str, str]], unwrap: bool) -> None:
        """Load uploaded recordings, studies, a robot and a model; `files`: pairs of file name and data URL.

        Raises InputError, which names the files that cannot be used.
        """
        upload = uploads.sort_files(self.make_folder(), files, unwrap)
        if upload.robots:
            joints = next((source.joints for source in upload.sources), None)
            model = upload.models[-1] if upload.models else None
            self.set_robot(open_robot_file(upload.robots[-1], model, joints))
        sources = upload.sources
        if not any(source.role == "fit" for source in (*sources, *(item.source for item in self.state.loaded))):
            self._fitted_checks.update(source.file for source in sources)  # something must be fitted
            sources = [replace(source, role="fit") for source in sources]
        refused = [*upload.refused, *self._read(sources)]
        if upload.models:
            try:
                self.start_from_model(upload.models[-1])
            except USER_ERRORS as mistake:
                refused.append(format_mistake(mistake))
        _refuse(refused)

    def start_from_model(self, file: Path) -> None:
        """Use the terms of a model file for the base model, and remove added effects.

        Raises ModelError if the file is not a model.
        """
        model = read_model(str(file), self.state.body)
        terms = tuple(term for term in model.terms if not isinstance(term, Links))
        self.change(f"start from {file.name}", self.state.restart(terms=terms, model_file=file.name))

    def set_robot(self, robot: RobotFile) -> None:
        """Read all recordings again as recordings of a robot, also those with open cards; see `State.set_robot`."""
        waiting = [card.source for card in self.cards if not card.loaded_id]
        self.change(f"take {robot.file.name} for the robot", self.state.set_robot(robot))
        self.cards = ()
        self.load(waiting)

    def load(self, sources: Iterable[Source]) -> None:
        """Read recordings and add them to the state; files with unclear columns get a card.

        Raises InputError, which names the files that cannot be read.
        """
        _refuse(self._read(sources))

    def _read(self, sources: Iterable[Source]) -> list[str]:
        """Read recordings as `load`; return an error message for each file that cannot be read."""
        loaded, refused = list[LoadedRecording](), list[str]()
        for source in sources:
            try:
                loaded.append(LoadedRecording.read(source, [*self.state.loaded, *loaded], read_source=self.state.read))
            except ColumnError as error:
                try:
                    text = self.describe_mistake(error)
                    self.cards += (ColumnCard.from_source(source, error=text, joints=self.state.moving),)
                except RecordingError as mistake:
                    refused.append(format_mistake(mistake))
            except USER_ERRORS as mistake:
                refused.append(format_mistake(mistake))
        if loaded:
            self.add_recordings(*loaded)
        return refused

    def add_recordings(self, *loaded: LoadedRecording) -> None:
        """Add recordings to the state, and remove its fits."""
        names, all_loaded = ", ".join(item.recording.name for item in loaded), (*self.state.loaded, *loaded)
        checks = self._fitted_checks
        if any(not item.held_out and item.source.file not in checks for item in all_loaded):
            all_loaded = tuple(item.hold_out(True) if item.source.file in checks else item for item in all_loaded)
        self.change(f"load {names}", self.state.restart(loaded=all_loaded))

    def remove(self, id: str) -> None:
        """Remove a recording."""
        removed = self.state.find(id)
        self.cards = tuple(card for card in self.cards if card.loaded_id != id)
        self.change(f"remove {removed.recording.name}", self.state.swap_recording(removed))

    def hold_out(self, id: str, held_out: bool) -> None:
        """Hold a recording out, or fit it."""
        chosen = self.state.find(id)
        self._fitted_checks.discard(chosen.source.file)
        if chosen.held_out != held_out:
            self.change("fit or check", self.state.swap_recording(chosen, chosen.hold_out(held_out)))

    # ---------------------------------------------------------------------------------------------- columns

    def open_card(self, id: str) -> None:
        """Open the card of a loaded recording; raises RecordingError as `ColumnCard.from_source`."""
        card = ColumnCard.from_source(self.state.find(id).source, loaded_id=id, joints=self.state.moving)
        self.cards = (card, *(card_of_other for card_of_other in self.cards if card_of_other.loaded_id != id))

    def apply_card(self, card: ColumnCard) -> None:
        """Read the file of the first card with its choices, and other waiting files with the same headers.

        After an error the card stays and shows the message.
        """
        waiting = self.cards[1:]
        self.cards = waiting
        others = [item for item in self.state.loaded if item.id != card.loaded_id]
        try:
            loaded = LoadedRecording.read(card.make_source(), others, read_source=self.state.read)
        except USER_ERRORS as mistake:
            self.cards = (replace(card, error=self.describe_mistake(mistake)), *waiting)
            return
        if card.loaded_id:
            earlier = self.state.find(card.loaded_id)
            recording = replace(loaded.recording, name=earlier.recording.name)
            loaded_again = replace(earlier, source=loaded.source, recording=recording)
            self.change("read columns anew", self.state.swap_recording(earlier, loaded_again))
            return
        headers = card.preview.headers
        same_headers = [other for other in waiting if not other.loaded_id and other.preview.headers == headers]
        self.cards = tuple(other for other in waiting if other not in same_headers)
        self.add_recordings(loaded)
        columns, unwrap = loaded.source.columns, loaded.source.unwrap
        self.load([replace(other.source, columns=columns, unwrap=unwrap) for other in same_headers])

    def end(self) -> None:
        """Cancel the job and refuse further actions; wait at most `GRACE` for a running request."""
        self._has_ended = True
        if (job := self.job) is not None:
            job.cancel()
        if self.lock.acquire(timeout=GRACE):
            try:
                self.cancel()
            finally:
                self.lock.release()


def _refuse(refused: Sequence[str]) -> None:
    """Raise InputError with all messages, unless the list is empty."""
    if refused:
        raise InputError("; ".join(refused))


class Sessions:
    """Sessions of a server by id, and their shared workers."""

    def __init__(self, recordings: Sequence[Source] = (), robot: RobotFile | None = None) -> None:
        """Set the initial recordings and robot of every session, and make the folder for uploaded files."""
        self._recordings, self._robot = tuple(recordings), robot
        self.workers = Workers()
        self._folder = tempfile.TemporaryDirectory(prefix="pendulum-ident-", ignore_cleanup_errors=True)
        self._all: dict[str, Session] = {}  # in order of last use
        self._lock = RLock()

    def find_session(self, id: object) -> Session:
        """Return the session of an id, perhaps a new one; raises InputError if the id is malformed."""
        if not isinstance(id, str) or ID.fullmatch(id) is None:
            raise InputError("this page has no session: load it again")
        with self._lock:
            session = self._all.pop(id, None) or Session(Path(self._folder.name), self.workers)
            ended = [self._all.pop(k) for k in list(self._all)[: max(0, len(self._all) + 1 - MAX_SESSIONS)]]
            self._all[id] = session
        session.begin(self._recordings, self._robot)  # outside the lock: other sessions go on
        for ended_session in ended:
            ended_session.end()
        return session

    def close(self) -> None:
        """End all sessions and workers, and delete the uploaded files."""
        with self._lock:
            for session in self._all.values():
                session.end()
            self._all.clear()
            self._folder.cleanup()
        self.workers.close()
