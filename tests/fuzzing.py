"""Files and requests that nobody meant: `python -m tests.fuzzing --minutes 60`, or `make fuzz`.

Good files of each kind are changed by hypothesis, and what the page may ask for is asked with anything. What is found
is kept in tests/corpus, which the tests read every time; a file there is `READER-DIGEST.ending`.
"""

from __future__ import annotations

import argparse
import errno
import functools
import hashlib
import io
import json
import math
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any
from unittest import mock
from xml.sax.saxutils import escape

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from scipy.io import savemat

from agents.config import Config, read_settings
from agents.network import SHIPPED, Network
from benchmarks.two_link import TwoLink
from pendulum_env.arms import read_body
from pendulum_env.backends.hardware.config import load as load_rig
from pendulum_env.physics import Model, library, plugin
from pendulum_env.plant import hide, paper_plant
from pendulum_env.recording import Recording, read_recording, write_recording
from pendulum_env.recording.columns import named_column
from pendulum_env.recording.study import read_sources
from tests.pendulum_env.physics.test_limits import PLUGIN
from tests.workbench.app.plants import recorded, url, written
from workbench import cli
from workbench.inputs import read_suggestion
from workbench.mistakes import InputError, sentence
from workbench.report.fleet import write_fleet_report
from workbench.survey import Dataset, Fleet, find_cases
from workbench.survey.dataset import SCHEMA

CORPUS = Path(__file__).parent / "corpus"
MEMORY = 4_000_000_000  # bytes that a reader may map, libraries included
HANG = 10  # [s] that a reader may take
ROUND = 40  # examples of a target before it is the turn of the next

RIG = 'adapter = "serial"\nrate = 500\n[serial]\nport = "/dev/ttyACM0"\n[limits]\ntorque = 3.5\n[encoder]\nzero = 7\n'
STUDY = (
    '[columns]\ntorque = "i:A*0.09"\n[[recording]]\nfile = "a.csv"\nrange = [1, 2.5]\n'
    'load = {mass = 0.5, length = 0.2}\n[[recording]]\nfile = "b.csv"\nrole = "holdout"\n'
)
TRAINING = 'hidden = 32\nsteps = 1000\nlevels = [-1.0, 0.0, 1.0]\nconstraint = "rms"\n'
SUGGESTION = {
    "reach": [-1.0, 1.5],
    "seconds": 20.0,
    "peak_torque": 3.0,
    "peak_speed": 9.0,
    "settles": [{"effect": "spring", "instead": None}, {"effect": "cogging", "instead": "gravity"}],
    "signal": {"kind": "multisine", "amplitude": 3.0, "base": 0.1, "harmonics": [2, 9], "phases": [0.1, 2.0]},
}
MJCF = (
    '<mujoco model="one"><default><joint armature="0.01"/></default><worldbody><body name="arm" pos="0 0 1">'
    '<joint name="shoulder" axis="0 -1 0" range="-90 90"/>'
    '<inertial pos="0 0 -0.2" mass="1" diaginertia="0.1 0.1 0.01"/></body></worldbody></mujoco>'
)
DIAGNOSIS = {"schema": "pendulum-ident/diagnosis@1", "suggestion": SUGGESTION, "inseparable": [["a", "b"]]}


def train(path: Path) -> Config:
    return Config.of(read_settings(path))


# ---------------------------------------------------------------------------------------------- doors of other kinds


class Leaving(io.RawIOBase):
    """A pipe whose reader leaves after so many bytes."""

    def __init__(self, most: float = math.inf) -> None:
        self.left = most

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        if self.left <= 0:
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")
        taken = int(min(len(data), self.left))
        self.left -= taken
        return taken


def command(*argv: str, until: float = math.inf) -> str:
    """What a command says, whose reader leaves after so many bytes: nothing, or what is wrong, in a line."""
    out, err = io.TextIOWrapper(io.BufferedWriter(Leaving(until), 64), "utf-8", write_through=True), io.StringIO()
    with warnings.catch_warnings(), redirect_stdout(out), redirect_stderr(err):
        warnings.simplefilter("ignore")  # what Python says of a user's own code
        code = cli.main(argv)
    said = err.getvalue()
    assert (code, said) == (0, "") or (code == 2 and said.count("\n") == 1), (code, said)
    if code:
        raise InputError(said.strip())
    return said


def read_plugin(path: Path) -> str:
    with mock.patch.dict(library._registered), mock.patch.dict(plugin._loaded, clear=True):
        return command("effects", "--plugin", str(path))


@functools.cache
def swing() -> Recording:
    return recorded("run", 1, 4.0, rate=250.0)


def leave(path: Path) -> Model:
    """Leave a command after as many bytes as are in a file: it writes its model all the same."""
    with tempfile.TemporaryDirectory() as folder:
        source, model = written(swing(), Path(folder)), Path(folder, "model.json")
        command("identify", str(source.file), "-o", str(model), until=path.stat().st_size)
        return Model.load(model)


def read_expression(path: Path) -> object:
    return named_column("torque", path.read_text(errors="replace"), ["time", "a/b", "i", "i:A", "-x"])


def read_cases(path: Path) -> object:
    return find_cases([str(path)], READING)


READING = argparse.Namespace(columns=None, unwrap=False, max_size=500)


def read_names(path: Path) -> object:
    """A pattern of names, then names of files below a folder, and of links with where they lead."""
    pattern, *names = path.read_bytes().split(b"\n")
    with tempfile.TemporaryDirectory() as folder:
        root = os.fsencode(os.path.realpath(folder))
        for name in names[:20]:
            place, _, to = (part.replace(b"..", b"").lstrip(b"/") for part in name[:900].partition(b" -> "))
            place = os.path.join(root, place)
            with suppress(OSError, ValueError):
                if os.path.realpath(place).startswith(root):  # no link leads elsewhere
                    os.makedirs(os.path.dirname(place), exist_ok=True)
                    os.symlink(to, place) if to else open(place, "xb").close()
        return find_cases([folder], READING, pattern.decode(errors="replace") or None)


NAMES = b"{robot}/{joint}_*{date}\narm/elbow_a2026-03-01.csv\narm/wrist_1b.npz\nloop -> .\narm/knee_b1.csv -> elbow"


def read_fleet(path: Path) -> Fleet:
    """The page of a dataset with one file: Parquet, or a row of which each line has a column and its value."""
    with tempfile.TemporaryDirectory() as folder:
        dataset = Dataset(Path(folder))
        dataset.create()
        content = path.read_bytes()
        if path.suffix == ".txt":
            row: dict[str, Any] = {}
            for name, value in (line.partition(" ")[::2] for line in content.decode(errors="replace").split("\n")):
                row[name] = None
                with suppress(ValueError, RecursionError):
                    row[name] = json.loads(value)
            buffer = io.BytesIO()
            with suppress(pa.ArrowException, OverflowError):  # there is no such file then
                pq.write_table(pa.Table.from_pylist([row]), buffer)
            content = buffer.getvalue()
        (dataset.folder / "cases" / "a.parquet").write_bytes(content)
        fleet = Fleet.of(dataset)
        write_fleet_report(Path(folder, "fleet.html"), fleet)
        assert len(fleet.rows) == 1
        return fleet


CASE: dict[str, Any] = {
    "name": "arm/elbow.csv", "robot": "arm", "joint": "elbow", "kind": "elbow", "date": 1_772_000_000_000_000,
    "dated_by": "file", "file": "/data/arm/elbow.csv", "status": "done", "reason": None, "verdict": "missing",
    "headline": "friction falls with speed", "score": 0.98, "selected": ["stribeck"], "ambiguous": [["spring", "a"]],
    "candidates": [{"effect": "stribeck", "verdict": "selected", "score": 0.98, "gain": 99.0, "gain_error": 9.0,
                    "variants": 1}],
    "parameters": [{"name": "inertia", "value": 0.09, "std": 0.001, "unit": "kg m^2"}], "torque_unit": "N m",
    "noise_floor": 0.01, "torque_rms": 0.02, "position_rms": 0.001, "samples": 9000, "duration": 9.0, "seconds": 2.0,
    "diagnosis": "{}", "report": "reports/a.html", "hash": "0a", "version": "1", "settings": "1b",
    "finished": 1_772_000_000_000_000,
}  # fmt: skip


def case(_: Path) -> bytes:
    return "\n".join(f"{name} {json.dumps(value)}" for name, value in CASE.items()).encode()


def dataset(path: Path) -> bytes:
    pq.write_table(pa.Table.from_pylist([CASE], schema=SCHEMA), path)
    return path.read_bytes()


@functools.cache
def worked() -> bytes:
    """A session with a recording and an effect that was added."""
    from estimators import add
    from workbench.app.saved import pack
    from workbench.app.session import Session

    with tempfile.TemporaryDirectory() as folder:
        session = Session(Path(folder) / "session")
        session.load([written(swing(), Path(folder))])
        session.state = session.state.with_step(add(session.state.model, "stribeck", session.state.train))
        return pack(session.state)


def contents() -> bytes:
    with zipfile.ZipFile(io.BytesIO(worked())) as archive:
        return archive.read("session.json")


def open_session(path: Path) -> object:
    """A session in a ZIP archive, or what one of JSON says beside a good study and recording."""
    from workbench.app.session import Session

    content = path.read_bytes()
    if path.suffix == ".json":
        packed = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(worked())) as good, zipfile.ZipFile(packed, "w") as archive:
            for name in good.namelist():
                archive.writestr(name, content if name == "session.json" else good.read(name))
        content = packed.getvalue()
    with tempfile.TemporaryDirectory() as folder:
        session = Session(Path(folder) / "session")
        session.open(f"{path.name}.zip", url(content))
        return session.state


def read_chain(path: Path) -> object:
    """A robot in a row: its format, how many joints, and what stands in each."""
    kind, count, *words = [*path.read_text(errors="replace").split(), *CHAIN.split()][: len(CHAIN.split())]
    many = range(min(int(count), 20_000) if count.isdecimal() else 3)
    numbers = dict(zip(("axis", "x", "mass", "inertia", "type"), map(escape, words), strict=True))
    one = MJCF_JOINT if kind == "mjcf" else URDF_JOINT
    body = "".join(one.format(k=k, next=k + 1, **numbers) for k in many)
    whole = (
        f"<mujoco><worldbody>{body}{'</body>' * len(many)}</worldbody></mujoco>"
        if kind == "mjcf"
        else (f'<robot name="chain"><link name="l0"/>{body}</robot>')
    )
    robot = path.with_name(f"{path.name}.{'xml' if kind == 'mjcf' else 'urdf'}")
    robot.write_text(whole)
    return read_body(robot)


CHAIN = "urdf 5 1 -0.2 1.5 0.01 revolute"
URDF_JOINT = (
    '<link name="l{next}"><inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/>'
    '<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="j{k}" type="{type}"><parent link="l{k}"/><child link="l{next}"/><origin xyz="{x} 0 0"/>'
    '<axis xyz="0 {axis} 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
)
MJCF_JOINT = (
    '<body name="l{k}" pos="{x} 0 0"><joint name="j{k}" axis="0 {axis} 0"/>'
    '<inertial pos="{x} 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>'
)


# ------------------------------------------------------------------------------------------------------ good files


def signals() -> dict[str, np.ndarray]:
    at = np.arange(300) / 100.0
    return {"time": at, "position": np.sin(3 * at), "torque": np.cos(3 * at)}


def stored(path: Path) -> bytes:
    write_recording(Recording("run", **signals()), path)
    return path.read_bytes()


def matlab(path: Path) -> bytes:
    packed = io.BytesIO()
    savemat(packed, signals())
    return packed.getvalue()


def hdf5(path: Path) -> bytes:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in signals().items():
            file.create_dataset(name, data=values, compression="gzip" if name == "torque" else None)
    return path.read_bytes()


def excel(path: Path) -> bytes:
    from tests.pendulum_env.recording.test_formats import write_xlsx

    columns = signals()
    write_xlsx(path, [list(columns), *np.column_stack(list(columns.values())).tolist()])
    return path.read_bytes()


def bag(path: Path, kind: str = "mcap") -> bytes:
    from tests.pendulum_env.recording.test_formats import write_bag

    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / ("run.bag" if kind == "ros1" else "run")
        write_bag(place, kind)
        inner = place if kind == "ros1" else next(file for file in place.iterdir() if file.suffix in (".mcap", ".db3"))
        return inner.read_bytes()


def described(path: Path) -> bytes:
    from tests.pendulum_env.recording.test_formats import write_bag

    write_bag(path.parent / "run", "sqlite3")
    return (path.parent / "run" / "metadata.yaml").read_bytes()


def read_described(path: Path) -> Recording:
    """A bag of ROS 2 that a file describes."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, path.name)
        place.mkdir()
        (place / "run.db3").write_bytes(good("recording.db3"))
        (place / "metadata.yaml").write_bytes(path.read_bytes())
        return read_elbow(place)


def read_elbow(path: Path) -> Recording:
    topic = "/joint_states/elbow"
    columns = {"position": f"{topic}/position", "velocity": f"{topic}/velocity", "torque": f"{topic}/effort"}
    return read_recording(path, columns=columns)


Reader = Callable[[Path], object]
Door = tuple[str, Reader, Callable[[Path], bytes]]  # a file's ending, its reader, and a good one
FILES: dict[str, Door] = {
    "model": (".json", Model.load, lambda _: json.dumps(hide(paper_plant(), "stribeck").json()).encode()),
    "diagnosis": (".json", lambda path: read_suggestion(str(path)), lambda _: json.dumps(DIAGNOSIS).encode()),
    "rig": (".toml", load_rig, lambda _: RIG.encode()),
    "study": (".toml", read_sources, lambda _: STUDY.encode()),
    "training": (".toml", train, lambda _: TRAINING.encode()),
    "policy": (".npz", Network.load, lambda _: (SHIPPED / "peak.npz").read_bytes()),
    **{f"recording{end}": (end, read_recording, stored) for end in (".csv", ".csv.gz", ".npz", ".parquet")},
    # what a helper reads with the libraries of others
    "recording.mat": (".mat", read_recording, matlab),
    "recording.h5": (".h5", read_recording, hdf5),
    "recording.xlsx": (".xlsx", read_recording, excel),
    "recording.mcap": (".mcap", read_elbow, bag),
    "recording.bag": (".bag", read_elbow, functools.partial(bag, kind="ros1")),
    "recording.db3": (".db3", read_elbow, functools.partial(bag, kind="sqlite3")),
    "robot.urdf": (".urdf", read_body, lambda _: TwoLink().urdf().encode()),
    "robot.xml": (".xml", read_body, lambda _: MJCF.encode()),
}
ALL: dict[str, Door] = FILES | {  # and what is no file of its own, or of several
    "chain": (".txt", read_chain, lambda _: CHAIN.encode()),
    "plugin": (".py", read_plugin, lambda _: PLUGIN.encode()),
    "pipe": (".txt", leave, lambda _: b"x" * 500),
    "expression": (".txt", read_expression, lambda _: b"-i:A*0.091/6+0.1:Nm"),
    "table": (".csv", read_cases, lambda _: b"file,robot,joint,date\na.csv,one,elbow,2026-03-01\nb.npz,two,,\n"),
    "names": (".txt", read_names, lambda _: NAMES),
    "dataset.parquet": (".parquet", read_fleet, dataset),
    "dataset.txt": (".txt", read_fleet, case),
    "described": (".yaml", read_described, described),
    "session.zip": (".zip", open_session, lambda _: worked()),
    "session.json": (".json", open_session, lambda _: contents()),
}
NAMELESS = (
    train,
    read_expression,
    read_cases,
    read_names,
)  # what is wrong there may be told of another file, or of none


@functools.cache
def good(name: str) -> bytes:
    """A good file of a kind."""
    ending, _, make = ALL[name]
    with tempfile.TemporaryDirectory() as folder:
        return make(Path(folder) / f"run{ending}")


def check(read: Reader, path: Path) -> None:
    """Read a file, or be told in one sentence that names it why not."""
    try:
        read(path)
    except ValueError as error:
        told = sentence(error)
        assert len(told) <= 500 and told.isprintable()
        if read not in NAMELESS:
            assert path.name in str(error)
        assert type(error) is not ValueError or read is train


# --------------------------------------------------------------------------------------------------------- changes

TOKENS = [b"null", b"-1", b"1e999", b"[", b"{", b'"', b"\\u0000", b"9" * 30, b"inf", b"nan", b"\x00", b"\xff" * 4]
LIES = [0, 1, 0x7F, 0xFF, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1]  # of sizes


@st.composite
def changed(draw: Any, content: bytes) -> bytes:
    """Bytes replaced, cut out, put in and said twice, sizes that lie, and mere bytes."""
    for _ in range(draw(st.integers(0, 4))):
        place = draw(st.integers(0, len(content)))
        match draw(st.sampled_from(["bytes", "size", "end", "again"])):
            case "bytes":
                end = place + draw(st.integers(0, 8))
                content = content[:place] + draw(st.sampled_from(TOKENS) | st.binary(max_size=8)) + content[end:]
            case "size":
                kind, lie = draw(st.sampled_from("BHIQ")), draw(st.sampled_from(LIES))
                told = struct.pack(f"{draw(st.sampled_from('<>'))}{kind}", lie % 2 ** (8 * struct.calcsize(kind)))
                content = content[:place] + told + content[place + len(told) :]
            case "end":
                content = content[:place] if draw(st.booleans()) else content[place:]
            case "again":
                times = draw(st.integers(2, 50) | st.just(3000))
                content = content[:place] + content[place : place + 64] * times + content[place:]
    return content if draw(st.integers(0, 19)) else draw(st.binary(max_size=40))


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(10**400) | st.just(1e308),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


# ---------------------------------------------------------------------------------------------------------- the app


class Page:
    """The app without a browser, and without work that goes on by itself."""

    ID = "f" * 32

    def __init__(self) -> None:
        from workbench.app import live
        from workbench.app.server import make_app
        from workbench.app.session import Session
        from workbench.mistakes import InputError

        def idle(*_: object) -> None:
            raise InputError("nothing is started here")

        self._before = Session.work, live.Run.__init__
        Session.work = live.Run.__init__ = idle  # type: ignore[assignment, method-assign]
        app, self.sessions = make_app()
        self.client = app.server.test_client()
        self.client.get("/_dash-layout")
        self.callbacks = self.client.get("/_dash-dependencies").get_json()
        self.session = self.sessions.of(self.ID)

    def close(self) -> None:
        from workbench.app import live
        from workbench.app.session import Session

        Session.work, live.Run.__init__ = self._before  # type: ignore[method-assign]
        self.sessions.close()

    def ask(self, callback: dict[str, Any], values: list[Any]) -> int:
        """Ask a callback with values for what it depends on; returns the status."""

        def part(of: dict[str, Any]) -> Any:
            id = of["id"]
            if id.startswith("{"):
                known = json.loads(id)
                many = any(value == ["ALL"] for value in known.values())
                id = {key: "run.csv" if isinstance(value, list) else value for key, value in known.items()}
                one = {"id": id, "property": of["property"], "value": values.pop() if values else None}
                return [one] if many else one
            value = self.ID if id == "session" else values.pop() if values else None
            return {"id": id, "property": of["property"], "value": value}

        def output(text: str) -> dict[str, Any]:
            id, _, name = text.rpartition(".")
            return {"id": json.loads(id) if id.startswith("{") else id, "property": name.partition("@")[0]}

        told = callback["output"]
        outputs: Any = [output(one) for one in told[2:-2].split("...")] if told.startswith("..") else output(told)
        inputs = [part(one) for one in callback["inputs"]]
        first = inputs[0][0] if inputs and isinstance(inputs[0], list) else inputs[0] if inputs else None
        name = first["id"] if first else None
        name = json.dumps(name, separators=(",", ":")) if isinstance(name, dict) else name
        ask = {
            "output": told,
            "outputs": outputs,
            "inputs": inputs,
            "state": [part(one) for one in callback.get("state", [])],
            "changedPropIds": [f"{name}.{first['property']}"] if first else [],
        }
        return self.client.post(
            "/_dash-update-component", data=json.dumps(ask), content_type="application/json"
        ).status_code


VALUES = (
    ANYTHING
    | st.sampled_from(["#data", "#compare", "run.csv", "../../x", "-1", "<script>alert(1)</script>", "paper", 1, 0, -5])
    | st.just(["run.csv"])
    | st.builds(lambda body: [f"data:text/csv;base64,{body}"], st.sampled_from(["AAAA", "dGltZSxhLGIKMCwxLDIK", "%%%"]))
)


def ask_anything(page: Page, data: st.DataObject) -> None:
    """One request with anything in it: an answer, or a refusal, but no failure of the server."""
    callback = data.draw(st.sampled_from([one for one in page.callbacks if not one.get("clientside_function")]))
    count = len(callback["inputs"]) + len(callback.get("state", []))
    values = data.draw(st.lists(VALUES, min_size=count, max_size=count))
    status = page.ask(callback, values)
    assert status in (200, 204, 400), (callback["output"], values, status)


# ----------------------------------------------------------------------------------------------------- an hour of it


def fuzz(name: str, number: int, folder: Path) -> None:
    """One round of a target; raises what was found, the file that did it being in the folder."""
    chance = settings(
        deadline=None, max_examples=ROUND, database=None, suppress_health_check=list(HealthCheck),
        phases=[Phase.generate, Phase.shrink],
    )  # fmt: skip
    if name == "app":
        page = Page()
        try:
            seed(number)(chance(given(data=st.data())(lambda data: ask_anything(page, data))))()
        finally:
            page.close()
        return
    ending, read, _ = ALL[name]
    path = folder / f"input{ending}"

    def one(content: bytes) -> None:
        path.write_bytes(content)
        signal.alarm(HANG)
        try:
            check(read, path)
        finally:
            signal.alarm(0)

    seed(number)(chance(given(content=changed(good(name)))(one)))()


def keep(name: str, folder: Path) -> Path | None:
    """Put what was found into the corpus."""
    for path in folder.glob("input*"):
        content = path.read_bytes()
        kept = CORPUS / f"{name.partition('.')[0]}-{hashlib.sha256(content).hexdigest()[:12]}{path.name[5:]}"
        CORPUS.mkdir(exist_ok=True)
        kept.write_bytes(content)
        return kept
    return None


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--target", choices=["app", *ALL], action="append", help="only this one (may be repeated)")
    parser.add_argument("--round", help=argparse.SUPPRESS)  # SEED:FOLDER, one round in a process of its own
    arguments = parser.parse_args(sys.argv[1:] if argv is None else argv)
    targets = arguments.target or ["app", *ALL]
    if arguments.round is not None:
        number, _, folder = arguments.round.partition(":")
        import resource  # unknown to Windows

        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        fuzz(targets[0], int(number), Path(folder))
        return 0
    until, rounds, found = time.monotonic() + 60 * arguments.minutes, 0, 0
    while time.monotonic() < until:
        name, number = targets[rounds % len(targets)], random.randrange(2**32)
        rounds += 1
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "tests.fuzzing", "--target", name, "--round", f"{number}:{folder}"]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                found += 1
                print(f"{name}, seed {number}: {keep(name, Path(folder)) or ''}\n{done.stderr[-3000:]}", flush=True)
    print(f"{rounds} rounds of {ROUND} inputs: {found} found something")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
