"""A session: what one browser tab works on, in a folder of its own."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from threading import RLock

from pendulum_env.reading import amount, read_archive
from pendulum_env.recording import RecordingError, Source, checks, columns, write_study
from pendulum_env.recording.record import ColumnError, by_torque
from pendulum_env.recording.study import read_sources
from workbench.app import saved, uploads
from workbench.app.asked import NOTHING, Asked
from workbench.app.history import MOST_SAMPLES, History
from workbench.app.jobs import Job
from workbench.app.live import Run
from workbench.app.mapping import Card
from workbench.app.state import Loaded, State
from workbench.app.uploads import MODELS, SESSIONS, STUDIES, UNWRAP, is_study, safe_name, unpack
from workbench.inputs import read_model
from workbench.mistakes import MISTAKES, InputError, sentence

STUDY = "study.toml"
MOST_RECORDINGS = 12  # in one session
SPACE = 300_000_000  # bytes of its files
SPARE = 100_000_000  # bytes that are left to the disk


class Session:
    """One tab's work: a folder of its own, the state, and what runs in the background.

    The state is a value: read it once, and all that is drawn from it fits together. It is replaced under `lock`.
    """

    def __init__(self, folder: Path, rig: Path | None = None) -> None:
        """Take an empty folder, and the configuration of the rig if there is one."""
        self.folder, self.rig = folder, rig
        self.lock = RLock()
        self._history = History()
        self.cards: tuple[Card, ...] = ()  # recordings whose columns a person is asked about, the first one now
        self.tried = NOTHING  # what a person would have looked for, or says is known, right or wrong
        self.notice = ""  # a sentence for the user: what went wrong
        self.version = time.time_ns() // 1_000_000  # grows with all that the page shows; no two sessions share one
        self.job: Job | None = None
        self.run: Run | None = None
        self._over = False

    @property
    def state(self) -> State:
        """What the session knows now."""
        return self._history.now

    @state.setter
    def state(self, state: State) -> None:
        self._history.change(state, self.version)

    @property
    def last_change(self) -> str:
        """What `undo` would take back, in words; empty if there is nothing."""
        return self._history.last

    def undo(self) -> None:
        """Take back the last change, whatever it was.

        Raises:
            InputError: if there is none.
        """
        self._history.undo()
        self.tried = self.state.asked
        self.cards = tuple(card for card in self.cards if card.file.exists())

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
                self.version += 1
                change()

    def fail(self, job: Job, why: str) -> None:
        """End a job that came to nothing."""

        def tell() -> None:
            self.notice = self.plain(why)

        self.finish(job, tell)

    def plain(self, text: str) -> str:
        """A sentence in the page's words: about files without the session's folder, and controls for options."""
        here = {
            checks.UNWRAP: f"tick '{UNWRAP}' and load it again",
            columns.LINKS: "",
            columns.CHOOSE: "choose one",
            "--columns ": "",
            "name fewer in `without`, or more in `only`": "leave out fewer, or look for more",
            "`effects` lists those of effects, by ID or ID.NAME": "an effect's are called ID or ID.NAME",
        }
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
        waiting = [card for card in self.cards if card.file != file]
        if any(one.file == file for one in known):
            raise InputError(f"{file.name}: is loaded already: remove it, or give this one another name")
        if len(known) + len(waiting) >= MOST_RECORDINGS:
            raise InputError(f"{file.name}: {MOST_RECORDINGS} recordings are enough: remove one first")
        if self._history.keeps(file):
            self._history.forget()  # another file of that name takes its place
        return file

    def receive(self, uploads: Sequence[tuple[str, str]], unwrap: bool) -> None:
        """Take in uploads, names and data URLs: recordings that can be read stay, read as a study among them asks for.

        Those whose columns are not clear wait for a person to name them: see `cards`.

        Raises:
            InputError: naming those that cannot be read, in the words of the command line.
        """
        loaded: list[Loaded] = []
        refused = []
        asked: dict[str, list[Source]] = {}  # by name of file
        for name, content in sorted(uploads, key=lambda one: not is_study(one[0])):
            try:
                if is_study(name):
                    for source in self._study(name, content):
                        asked.setdefault(source.file.name, []).append(source)
                    continue
                known = safe_name(name)
                sources = asked.pop(known, [Source(self.folder / known, unwrap=unwrap)])
                self._try_apart(known, content, sources)
                self._refuse_lack(known, len(content) * 3 // 4)
                file = self.place(name, *loaded)
                unpack(file, content)
                copies = [self._copy(file, k, *loaded) for k in range(2, len(sources) + 1)]  # one for each range
                for place, source in zip((file, *copies), sources, strict=True):
                    loaded += self.take(place, source)
            except MISTAKES as mistake:
                refused.append(sentence(mistake))
        refused += [f"{STUDY}: names {name}: drop both here together" for name in asked]
        if loaded:
            self.keep(*loaded)
        if refused:
            raise InputError("; ".join(refused))

    def _try_apart(self, name: str, content: str, sources: Sequence[Source]) -> None:
        """Read an upload elsewhere first, if it would take the place of a file that undoing a change brings back.

        Raises:
            InputError: if it cannot be read: then that change can be undone all the same.
        """
        if not self._history.keeps(self.folder / name) or any(one.file.name == name for one in self.state.loaded):
            return
        with tempfile.TemporaryDirectory(dir=self.folder.parent) as folder:
            other = Session(Path(folder))
            try:
                for source in sources:
                    unpack(other.folder / name, content)
                    other.take(other.folder / name, source)
            except MISTAKES as mistake:
                raise InputError(sentence(mistake).replace(f"{folder}/", "")) from None

    def _refuse_lack(self, name: str, size: int) -> None:
        """Refuse a file for which there is no room.

        Raises:
            InputError: if there is none in this session, or on the disk.
        """
        for folder in (self.folder.parent, self.folder):
            folder.mkdir(mode=0o700, exist_ok=True)  # somebody may have cleaned up
        if self._held() + size > SPACE:
            self._history.forget()
        if self._held() + size > SPACE:
            raise InputError(f"{name}: {amount(SPACE)} of files are enough: remove one first")
        if shutil.disk_usage(self.folder).free < size + SPARE:
            raise InputError(f"{name}: there is no room left on the disk that {self.folder.parent} is on: make some")

    def _held(self) -> int:
        """Bytes of the files in the folder."""
        return sum(file.stat().st_size for file in self.folder.iterdir() if file.is_file())

    def _study(self, name: str, content: str) -> list[Source]:
        """Recordings that an uploaded study names, as if they lay in the folder."""
        file = self.folder / safe_name(name, STUDIES)
        unpack(file, content)
        try:
            return [replace(one, file=self.folder / safe_name(one.file.name)) for one in read_sources(file)]
        finally:
            file.unlink()

    def _copy(self, file: Path, number: int, *coming: Loaded) -> Path:
        """A copy of a file that is read several times, over other ranges."""
        stem, dot, ending = file.name.partition(".")
        copy = self.place(f"{stem} ({number}){dot}{ending}", *coming)
        shutil.copyfile(file, copy)
        return copy

    def take(self, file: Path, source: Source) -> list[Loaded]:
        """Read a file of the folder; none if its columns have to be named first. One that cannot be read does not stay.

        Raises:
            RecordingError: if it cannot be read, in the words of the command line.
        """
        try:
            try:
                recording = by_torque(replace(source, largest=uploads.UNPACKED).read(file))
                return [Loaded(file, recording, source.role == "holdout", told=source)]
            except ColumnError as error:
                try:
                    card = Card.of(file, source, sentence(error))
                except RecordingError:
                    raise error from None
                self.cards = (*(one for one in self.cards if one.file != file), card)
                return []
        except MISTAKES:
            file.unlink(missing_ok=True)
            raise

    def copy(self, sources: Sequence[Source]) -> None:
        """Take in copies of recordings that lie elsewhere."""
        loaded: list[Loaded] = []
        for source in sources:
            file = self.place(source.file.name, *loaded)
            shutil.copyfile(source.file, file)
            loaded += self.take(file, replace(source, file=file))
        if loaded:
            self.keep(*loaded)

    # ---------------------------------------------------------------------------------------------- columns

    def ask(self, name: str) -> None:
        """Ask about the columns of a recording that is loaded.

        Raises:
            RecordingError: if there is nothing to choose.
        """
        one = self.find(name)
        self.cards = (Card.of(one.file, one.source), *(card for card in self.cards if card.file != one.file))

    def consider(self, card: Card) -> None:
        """Keep what a person has chosen so far."""
        self.cards = (card, *self.cards[1:])

    def answer(self, card: Card) -> None:
        """Read the first card's file as a person says, and waiting ones with the same columns alike.

        What is wrong is told by the card, which stays.
        """
        try:
            source = card.asked()
            recording = by_torque(source.read(card.file))
        except MISTAKES as mistake:
            self.cards = (replace(card, why=sentence(mistake)), *self.cards[1:])
            return
        alike = [other for other in self.cards[1:] if other.preview.headers == card.preview.headers and other.why]
        self.cards = tuple(other for other in self.cards[1:] if other not in alike)
        known = [one for one in self.state.loaded if one.file == card.file]
        if known:
            self._swap(known[0], replace(known[0], recording=recording, told=source, measured=None))
        else:
            self.keep(Loaded(card.file, recording, source.role == "holdout", told=source))
        for other in alike:
            self.keep(*self.take(other.file, replace(other.source, columns=source.columns, unwrap=source.unwrap)))

    def let_go(self) -> None:
        """Close the first card; a recording that was not loaded does not stay."""
        for card in self.cards[:1]:
            if all(one.file != card.file for one in self.state.loaded):
                card.file.unlink(missing_ok=True)
        self.cards = self.cards[1:]

    def study(self) -> str:
        """A study that names the recordings as they are read, for a folder in which they lie."""
        file = self.folder / STUDY
        write_study(file, [replace(one.source, file=self.folder / one.source.file.name) for one in self.state.loaded])
        try:
            return file.read_text(encoding="utf-8")
        finally:
            file.unlink()

    def keep(self, *loaded: Loaded) -> None:
        """Add recordings; the ladder starts anew.

        Raises:
            InputError: if they are too long together.
        """
        if sum(len(one.recording) for one in (*self.state.loaded, *loaded)) > MOST_SAMPLES:
            for one in loaded:
                one.file.unlink(missing_ok=True)
            raise InputError(f"{MOST_SAMPLES:,} samples are enough: remove a recording first")
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
        self.cards = tuple(card for card in self.cards if card.file != gone.file)
        self.state = self.state.having([one for one in self.state.loaded if one is not gone])

    def hold_out(self, name: str, held_out: bool) -> None:
        """Keep a recording for checking, or fit it."""
        chosen = self.find(name)
        if chosen.held_out != held_out:
            self._swap(chosen, replace(chosen, held_out=held_out))

    def _swap(self, old: Loaded, new: Loaded) -> None:
        self.state = self.state.having([new if one is old else one for one in self.state.loaded])

    def align(self, is_aligned: bool) -> None:
        """Correct torque that was logged late or filtered for all that follows, or leave it; the ladder starts anew."""
        self.state = self.state.aligned(is_aligned)

    def look_for(self, asked: Asked) -> bool:
        """Look for some effects, or with some values known, from now on; whether that makes sense."""
        self.tried = asked
        if asked.faults(self.state.terms):
            return False
        self.state = self.state.asking(asked)
        return True

    def begin_from(self, name: str, content: str) -> None:
        """Take the terms of an uploaded model as the base model; the ladder starts anew.

        Raises:
            InputError: if the file did not arrive whole.
            ModelError: if it is no model, in the words of the command line.
        """
        file = self.folder / safe_name(name, MODELS)
        unpack(file, content)
        try:
            self.state = self.state.fitting(read_model(str(file)).terms, file.name)
        finally:
            file.unlink()

    # ------------------------------------------------------------------------------------------------ whole

    def save(self) -> bytes:
        """The whole session in one file, for `open`.

        Raises:
            InputError: if it would be too large to be opened again.
        """
        packed = saved.pack(self.state, self.study(), STUDY)
        if len(packed) > uploads.UPLOAD:
            raise InputError(
                f"a session is opened up to {amount(uploads.UPLOAD)}, and this one takes {amount(len(packed))}: "
                f"remove a recording first, or save {STUDY} and the model"
            )
        return packed

    def open(self, name: str, content: str) -> None:
        """Take in an uploaded session in the place of this one, whole or not at all; nothing before it can be undone.

        Raises:
            InputError: if it is none, or too large.
        """
        folder = Path(tempfile.mkdtemp(dir=self.folder.parent))
        other = Session(folder)
        try:
            other._restore(folder / safe_name(name, SESSIONS), content)
        except (ValueError, OSError) as mistake:
            shutil.rmtree(folder)
            what = f"{safe_name(name, SESSIONS)}: "
            raise InputError(what + sentence(mistake).replace(f"{folder}/", "").removeprefix(what)) from None
        old, self.folder = self.folder, folder
        self._history.begin(other.state)
        self.cards, self.tried = (), other.state.asked
        shutil.rmtree(old, ignore_errors=True)  # somebody may have cleaned up

    def _restore(self, file: Path, content: str) -> None:
        """Become what an uploaded file holds, in an empty folder."""
        self._refuse_lack(file.name, len(content) * 3 // 4)
        unpack(file, content)
        contents = read_archive(file, saved.HINT, SPACE)
        file.unlink()
        self._refuse_lack(file.name, sum(map(len, contents.values())))
        for name in (saved.CONTENTS, STUDY):
            (self.folder / name).write_bytes(saved.member(contents, name))
        known = saved.Saved.read(self.folder / saved.CONTENTS)
        sources = read_sources(self.folder / STUDY)
        for name in (saved.CONTENTS, STUDY):
            (self.folder / name).unlink()
        if len(known.origins) != len(sources):
            raise InputError(f"{STUDY} and {saved.CONTENTS} tell of different recordings; {saved.HINT}")
        loaded: list[Loaded] = []
        for source, origin in zip(sources, known.origins, strict=True):
            place = self.place(source.file.name, *loaded)
            place.write_bytes(saved.member(contents, source.file.name))
            loaded += [replace(one, origin=origin) for one in self.take(place, replace(source, file=place))]
        if self.cards:
            raise InputError(self.cards[0].why)
        self._history.begin(known.begin())
        if loaded:
            self.keep(*loaded)
        self._history.begin(known.restore(self.state))

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
