"""Sessions: what each browser tab works on, apart from all others, in a folder of its own."""

from __future__ import annotations

import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from secrets import token_hex
from threading import RLock
from typing import Any

from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.mistake import Mistake
from pendulum_env.reading import amount, read_archive
from pendulum_env.recording import RecordingError, Source
from pendulum_env.recording.record import ColumnError
from pendulum_env.recording.study import read_sources
from pendulum_env.words import listing
from workbench.app import saved, uploads
from workbench.app.card import Card
from workbench.app.live import Run
from workbench.app.state import Loaded, State
from workbench.app.uploads import safe_name, unpack
from workbench.inputs import read_model
from workbench.mistakes import MISTAKES, InputError, sentence
from workbench.processes import Done, Failed, Job, Task, Workers
from workbench.robot import FORMATS, RobotFile

GRACE = 1.0  # [s] that an end waits for an answer that is being made
ID = re.compile(r"[0-9a-f]{32}")  # of a session: random, drawn by the page; never part of a path


class Session:
    """One tab's work: a folder of its own, the state and those before it, and what runs in the background.

    The state is a value: read it once, and all that is drawn from it fits together. It is replaced under `lock`.
    Files of the folder that no state and no card speaks of are deleted after each change.
    """

    def __init__(self, folder: Path, workers: Workers | None = None, rig: Path | None = None) -> None:
        """Take a folder of its own, who does long work, and the configuration of the rig if there is one."""
        self.folder, self.workers, self.rig = folder, workers or Workers(), rig
        self.lock = RLock()
        self.state = State()  # what the session knows now
        self._past = list[tuple[str, State]]()  # what was done, and the state before
        self.cards: tuple[Card, ...] = ()  # recordings whose columns a person is asked about, the first one now
        self.notice = ""  # a sentence for the user: what went wrong
        self.version = time.time_ns() // 1_000_000  # grows with all that the page shows; no two sessions share one
        self.asked = time.monotonic()  # when somebody asked for the session last
        self.job: Job | None = None
        self.run: Run | None = None
        self._begun = self._over = False

    def begin(self, sources: Sequence[Source], robot: RobotFile | None) -> None:
        """Take in what every session begins with, once; who asks meanwhile waits."""
        if self._begun:
            return
        with self.lock:
            if not self._begun and robot is not None:
                self.act(lambda: self.take_robot(robot))
            if not self._begun and sources:
                self.act(lambda: self.load(sources))
            self._begun = True

    # ---------------------------------------------------------------------------------------------- changes

    def change(self, what: str, state: State) -> None:
        """Become another state; `what` is done, in the words of the button that takes it back."""
        self._past.append((what, self.state))
        self.state = state
        most = uploads.LIMITS
        while len(self._past) > most.undone or sum(past.samples for _, past in self._past) > most.samples:
            del self._past[0]

    @property
    def last_change(self) -> str:
        """What `undo` would take back, in words; empty if there is nothing."""
        return self._past[-1][0] if self._past else ""

    def undo(self) -> None:
        """Take back the last change, whatever it was; raises InputError if there is none."""
        if not self._past:
            raise InputError("there is nothing to undo")
        _, self.state = self._past.pop()
        known = {one.id for one in self.state.loaded}
        self.cards = tuple(card for card in self.cards if not card.known or card.known in known)

    def act(self, do: Callable[[], object]) -> None:
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
                self.notice = self.told(mistake)
            finally:
                self._sweep()

    def told(self, mistake: Exception) -> str:
        """A mistake in the words of the command line, files without the session's folders."""
        return re.sub(rf"{re.escape(str(self.folder))}/(tmp\w+/)?", "", sentence(mistake))

    def _sweep(self) -> None:
        """Delete files that no state and no card speaks of any more."""
        if self.busy() or not self.folder.is_dir():
            return
        kept = {file for state in (*(past for _, past in self._past), self.state) for file in state.files}
        kept |= {card.source.file for card in self.cards}
        for file in self.folder.rglob("*"):
            if file.is_file() and file not in kept:
                file.unlink()

    # ------------------------------------------------------------------------------------------------- work

    def busy(self) -> bool:
        """Whether a job is on its way."""
        return self.job is not None and self.job.running

    def work(self, title: str, task: Task, keep: Callable[[Any], None]) -> None:
        """Do a task in the background and keep what comes of it, unless the user lets go of it; called by `act`."""

        def ended(job: Job, word: Done | Failed) -> None:
            with self.lock:
                if self.job is job:
                    self.job = None
                    self.act(lambda: keep(word.result))

        self.job = Job(title, task, self.workers, ended)

    def cancel(self) -> None:
        """Let go of the job."""
        with self.lock:
            if self.job is not None:
                self.job.cancel()
            self.job = None
            self.version += 1
            self._sweep()

    # ------------------------------------------------------------------------------------------- recordings

    def place(self, size: float = 0.0) -> Path:
        """A new folder within the session's for files of a size [bytes].

        Raises:
            InputError: if there is no room for them in this session.
        """
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)  # somebody may have cleaned up
        if self._held() + size > uploads.LIMITS.space:
            self._past.clear()
            self._sweep()
        if self._held() + size > uploads.LIMITS.space:
            raise InputError(f"{amount(uploads.LIMITS.space)} of files are enough: remove a recording first")
        return Path(tempfile.mkdtemp(dir=self.folder, prefix="tmp"))

    def _held(self) -> int:
        """Bytes of the files in the folder."""
        return sum(file.stat().st_size for file in self.folder.rglob("*") if file.is_file())

    def receive(self, coming: Sequence[tuple[str, str]], unwrap: bool) -> None:
        """Take in uploads, names and data URLs: recordings, read as a study among them asks for; see `load`.

        Raises:
            InputError: naming those that cannot be read, in the words of the command line.
        """
        place = self.place(sum(len(content) * 3 // 4 for _, content in coming))
        files, told, refused = list[Path](), list[Source](), list[str]()
        for name, content in coming:
            try:
                file = unpack(place, name, content)
                if file.suffix == ".toml":
                    told += [replace(one, file=place / safe_name(one.file.name)) for one in read_sources(file)]
                else:
                    files.append(file)
            except MISTAKES as mistake:
                refused.append(sentence(mistake))
        for name in {one.file.name for one in told if one.file not in files}:
            refused.append(f"{saved.STUDY}: names {name}: drop both here together")
        robots = [file for file in files if file.suffix.lower() in FORMATS]
        recordings = [file for file in files if file not in robots]
        named = {file: [one for one in told if one.file == file] for file in recordings}
        sources = [one for file in recordings for one in named[file] or [Source(file, unwrap=unwrap)]]
        if robots:
            joints = next((source.joints for source in sources), None)
            self.take_robot(RobotFile(robots[-1], joints, bolted=True))
        self.load(sources, refused)

    def take_robot(self, robot: RobotFile) -> None:
        """Take all recordings, those that wait for an answer included, for those of a robot from now on.

        Raises:
            BodyError: if the robot cannot be read.
            InputError: if recordings are not of it.
        """
        robot.body()
        waiting = [card.source for card in self.cards if not card.known]
        state = State(robot=robot)
        try:
            old = tuple(replace(one, recording=state.read(one.source)) for one in self.state.loaded)
        except Mistake as error:
            raise InputError(f"what is loaded is not of this robot: {self.told(error)}") from None
        self.change(f"take {robot.file.name} for the robot", replace(state, loaded=old))
        self.cards = ()
        self.load(waiting)

    def leave_robot(self) -> None:
        """Begin without a robot, and without its recordings."""
        self.change("leave the robot", State())

    def turn_gravity(self) -> None:
        """Take the robot's torques for those without gravity, or again for those with it; the ladder starts anew."""
        if (robot := self.state.robot) is not None:
            robot = replace(robot, weightless=not robot.weightless)
            self.change("take gravity off, or back", self.state.anew(robot=robot))

    def load(self, sources: Iterable[Source], refused: Sequence[str] = ()) -> None:
        """Read recordings: those that can be read stay, and those whose columns are not clear wait: see `cards`.

        Raises:
            InputError: naming those that cannot be read, and what was refused before.
        """
        loaded, refused = list[Loaded](), list(refused)
        for source in sources:
            try:
                loaded.append(Loaded.of(source, [*self.state.loaded, *loaded], read=self.state.read))
            except ColumnError as error:
                try:
                    self.cards = (*self.cards, Card.of(source, why=self.told(error), joints=self.state.moving))
                except RecordingError:
                    refused.append(sentence(error))
            except MISTAKES as mistake:
                refused.append(sentence(mistake))
        if loaded:
            self.keep(*loaded)
        if refused:
            raise InputError("; ".join(refused))

    def keep(self, *loaded: Loaded) -> None:
        """Add recordings; the ladder starts anew.

        Raises:
            InputError: if they are too many or too long together, or of a pendulum beside those of an arm.
        """
        if self.state.robot is not None and not all(isinstance(one.recording, ArmRecording) for one in loaded):
            raise InputError("this session is of an arm: leave the robot first, in the stage Data")
        every = (*self.state.loaded, *loaded)
        if sum(len(one.recording) for one in every) > uploads.LIMITS.samples:
            raise InputError(f"{uploads.LIMITS.samples:,} samples are enough: remove a recording first")
        self.change(f"load {listing([one.recording.name for one in loaded])}", self.state.anew(loaded=every))

    def remove(self, id: str) -> None:
        """Remove a recording."""
        gone = self.state.find(id)
        self.cards = tuple(card for card in self.cards if card.known != id)
        rest = tuple(one for one in self.state.loaded if one is not gone)
        self.change(f"remove {gone.recording.name}", self.state.anew(loaded=rest))

    def hold_out(self, id: str, held_out: bool) -> None:
        """Keep a recording for checking, or fit it."""
        chosen = self.state.find(id)
        if chosen.held_out != held_out:
            source = replace(chosen.source, role="holdout" if held_out else "fit")
            self._swap("fit or check", chosen, replace(chosen, source=source))

    def _swap(self, what: str, old: Loaded, new: Loaded) -> None:
        loaded = tuple(new if one is old else one for one in self.state.loaded)
        self.change(what, self.state.anew(loaded=loaded))

    # ---------------------------------------------------------------------------------------------- columns

    def ask(self, id: str) -> None:
        """Ask about the columns of a recording that is loaded; raises RecordingError if there is nothing to choose."""
        card = Card.of(self.state.find(id).source, known=id, joints=self.state.moving)
        self.cards = (card, *(other for other in self.cards if other.known != id))

    def answer(self, card: Card) -> None:
        """Read the first card's file as a person says, and waiting ones with the same columns alike.

        What is wrong is told by the card, which stays.
        """
        rest = self.cards[1:]
        self.cards = rest
        others = [one for one in self.state.loaded if one.id != card.known]
        try:
            first = Loaded.of(card.asked(), others, read=self.state.read)
        except MISTAKES as mistake:
            self.cards = (replace(card, why=self.told(mistake)), *rest)
            return
        if card.known:
            old = self.state.find(card.known)
            anew = replace(first.recording, name=old.recording.name)
            self._swap("read columns anew", old, replace(old, source=first.source, recording=anew))
            return
        alike = [one for one in rest if not one.known and one.preview.headers == card.preview.headers]
        self.cards = tuple(one for one in rest if one not in alike)
        self.keep(first)
        self.load([replace(one.source, columns=first.source.columns, unwrap=first.source.unwrap) for one in alike])

    # ------------------------------------------------------------------------------------------------ whole

    def begin_from(self, name: str, content: str) -> None:
        """Take the terms of an uploaded model as the base model; the ladder starts anew.

        Raises:
            InputError: if the file did not arrive whole.
            ModelError: if it is no model, in the words of the command line.
        """
        file = unpack(self.place(), name, content)
        if self.state.body is not None:
            terms = ArmModel.load(file, self.state.body).terms[1:]
        else:
            terms = read_model(str(file)).terms
        self.change(f"start from {file.name}", self.state.anew(terms=terms, model_file=file.name))

    def open(self, name: str, content: str) -> None:
        """Take in an uploaded session in the place of this one, whole or not at all; nothing before it can be undone.

        Raises:
            InputError: if it is none, or too large.
        """
        packed = unpack(self.place(len(content) * 3 // 4), name, content)
        contents = read_archive(packed, saved.HINT, uploads.LIMITS.space)
        place = self.place(sum(map(len, contents.values())))
        for member, text in contents.items():
            (place / safe_name(member)).write_bytes(text)
        try:
            state = saved.opened(place)
        except (ValueError, OSError) as mistake:
            raise InputError(f"{packed.name}: {self.told(mistake)}") from None
        self._past, self.state, self.cards = [], state, ()

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
        """Stop what runs and delete the folder; nothing begins any more. No answer that takes long is waited for."""
        self._over = True
        run, job = self.run, self.job
        if run is not None:
            run.stop()
        if job is not None:
            job.cancel()
        if self.lock.acquire(timeout=GRACE):
            try:
                self.halt()  # a run that was just being started
                self.cancel()
            finally:
                self.lock.release()
        shutil.rmtree(self.folder, ignore_errors=True)


class Sessions:
    """All sessions of a server by the id that each page holds, and the workers that they share."""

    def __init__(
        self, recordings: Sequence[Source] = (), rig: Path | None = None, robot: RobotFile | None = None
    ) -> None:
        """Make a folder for their folders; every session begins with the recordings, and may run the rig."""
        self._recordings, self._rig, self._robot = tuple(recordings), rig, robot
        self.workers = Workers()
        self._root = tempfile.TemporaryDirectory(prefix="pendulum-ident-", ignore_cleanup_errors=True)
        self._all: dict[str, Session] = {}  # the one used last is last
        self._lock = RLock()

    def of(self, id: object) -> Session:
        """Session of an id, a new one if there is none; raises InputError if it is no id."""
        if not isinstance(id, str) or ID.fullmatch(id) is None:
            raise InputError("this page has no session: load it again")
        now = time.monotonic()
        with self._lock:
            session = self._all.pop(id, None) or Session(Path(self._root.name) / token_hex(8), self.workers, self._rig)
            late = [k for k, other in self._all.items() if now - other.asked > uploads.LIMITS.idle and not other.busy()]
            late += list(self._all)[: max(0, len(self._all) + 1 - uploads.LIMITS.sessions)]
            ended = [self._all.pop(k) for k in dict.fromkeys(late)]
            session.asked = now
            self._all[id] = session
        session.begin(self._recordings, self._robot)  # no other session waits for it
        for other in ended:
            other.end()
        return session

    def close(self) -> None:
        """End all sessions, motors first, and the workers."""
        with self._lock:
            for session in self._all.values():
                if session.run is not None:
                    session.run.stop()
            for session in self._all.values():
                session.end()
            self._all.clear()
            self._root.cleanup()
        self.workers.close()
