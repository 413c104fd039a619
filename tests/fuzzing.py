"""Files and requests that nobody meant, for `test_fuzz.py` and `make fuzz`.

Good files of each kind are changed by hypothesis, and what the page may ask for is asked with anything. What was found
is kept in tests/corpus, which the tests read every time; a file there is `READER-DIGEST.ending`.
"""

from __future__ import annotations

import argparse
import functools
import io
import json
import shutil
import struct
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any
from unittest import mock

import numpy as np
from hypothesis import strategies as st
from scipy.io import savemat

from agents.config import Config
from agents.network import SHIPPED, Network
from benchmarks.two_link import TwoLink
from pendulum_env.arms import read_body
from pendulum_env.backends.hardware.config import load as load_rig
from pendulum_env.physics import Model, library, plugin
from pendulum_env.plant import hide, paper_plant
from pendulum_env.reading import read_toml
from pendulum_env.recording import Recording, read_recording, write_recording
from pendulum_env.recording.columns import named_column
from pendulum_env.recording.study import read_sources
from tests.pendulum_env.physics.test_limits import PLUGIN
from tests.workbench.app.plants import recorded, url, written
from workbench.inputs import read_suggestion
from workbench.mistakes import InputError, sentence

if TYPE_CHECKING:
    from workbench.survey import Dataset

CORPUS = Path(__file__).parent / "corpus"

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
BEGAN = datetime(2026, 1, 5, tzinfo=UTC)
DIAGNOSIS = {"schema": "pendulum-ident/diagnosis@1", "suggestion": SUGGESTION, "inseparable": [["a", "b"]]}


def train(path: Path) -> Config:
    return Config.of(read_toml(path))


def read_plugin(path: Path) -> object:
    with mock.patch.dict(library._registered), mock.patch.dict(plugin._loaded, clear=True), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what Python says of a user's own code
        return plugin.load_plugin(path)


def read_expression(path: Path) -> object:
    return named_column("torque", path.read_text(errors="replace"), ["time", "a/b", "i", "i:A", "-x"])


def read_names(path: Path) -> object:
    """The text of a file as what a survey's `--names` says."""
    from workbench.survey.cases import matched

    long = f"arm/{'elbow-' * 30}a_2026-03-01.csv"
    return [matched(PurePosixPath(name), path.read_text(errors="replace")) for name in ("arm/elbow_2026.csv", long)]


def read_cases(path: Path) -> object:
    """A table of a survey's recordings."""
    from workbench.commands.survey import configure
    from workbench.survey import find_cases

    parser = argparse.ArgumentParser()
    configure(parser)
    return find_cases([str(path)], parser.parse_args([str(path), "-o", "-"]))


def read_survey(path: Path) -> object:
    """A file of a survey's dataset, up to the fleet's page, which says so if it is none."""
    with surveyed() as dataset:
        shutil.copy(path, dataset.folder / "cases" / "a.parquet")
        return shown(dataset)


@contextmanager
def surveyed() -> Iterator[Dataset]:
    """A survey's dataset, still empty."""
    from workbench.survey import Dataset

    with tempfile.TemporaryDirectory() as folder:
        dataset = Dataset(Path(folder))
        dataset.create()
        yield dataset


def shown(dataset: Dataset) -> str:
    """The page of all that is in a dataset."""
    from workbench.survey import Fleet
    from workbench.survey.page import write_fleet_report

    assert dataset.rows(["name"])
    write_fleet_report(dataset.folder / "fleet.html", Fleet.of(dataset))
    return (dataset.folder / "fleet.html").read_text()


def open_session(path: Path) -> object:
    from workbench.app.session import Session

    with tempfile.TemporaryDirectory() as folder:
        session = Session(Path(folder) / "session")
        session.open(f"{path.name}.zip", url(path.read_bytes()))
        return session.state


# ------------------------------------------------------------------------------------------------------ good files


def signals() -> dict[str, np.ndarray]:
    at = np.arange(300) / 100.0
    return {"time": at, "position": np.sin(3 * at), "torque": np.cos(3 * at)}


def stored(path: Path) -> bytes:
    write_recording(Recording("run", **signals()), path)
    return path.read_bytes()


ROW = {
    **dict(name="arm/a.csv", robot="arm", joint="elbow", kind="elbow", date=BEGAN, dated_by="name", status="done"),
    **dict(
        verdict="missing", headline="Something is missing", score=0.9, selected=["stribeck"], ambiguous=[["a", "b"]]
    ),
    "candidates": [
        dict(effect="stribeck", verdict="selected", score=0.9, gain=30.0, gain_error=2.0, variants=2),
        dict(effect="cogging", verdict="rejected", score=0.1, gain=-1.0, gain_error=2.0, variants=1),
    ],
    "parameters": [dict(name="inertia", value=0.09, std=1e-4, unit="kg m^2")],
    **dict(torque_rms=0.01, report="reports/a.html", seconds=2.0, finished=BEGAN),
}


def survey(path: Path) -> bytes:
    with surveyed() as dataset:
        dataset.append(ROW | {"name": f"arm/{k}.csv", "date": BEGAN + timedelta(weeks=k)} for k in range(9))
        return dataset.parts[0].read_bytes()


@st.composite
def rows(draw: Any) -> list[dict[str, Any]]:
    """Rows of a dataset that a stranger wrote: of the right types, and with anything in them."""
    from workbench.survey.dataset import SCHEMA

    words = st.sampled_from(["", "done", "failed", "missing", "selected", "inertia", "../../x", "<b>", "a\0b", "{x}"])
    kinds = {"string": words | st.text(max_size=9), "double": st.floats(), "int64": st.integers(-3, 2**62)}
    moments = st.datetimes(timezones=st.just(UTC))

    def any_of(kind: Any) -> st.SearchStrategy[Any]:
        if str(kind) in kinds:
            return st.none() | kinds[str(kind)]
        if str(kind).startswith("timestamp"):
            return st.none() | moments
        if str(kind).startswith("list"):
            return st.none() | st.lists(any_of(kind.value_type), max_size=3)
        return st.none() | st.fixed_dictionaries({field.name: any_of(field.type) for field in kind})

    made = []
    for k in range(draw(st.integers(1, 6))):
        names = draw(st.sets(st.sampled_from(SCHEMA.names), max_size=3)) - {"name"}
        week = {"name": f"arm/{k}.csv", "date": BEGAN + timedelta(weeks=k)}
        made.append(ROW | week | {name: draw(any_of(SCHEMA.field(name).type)) for name in sorted(names)})
    return made


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


def read_elbow(path: Path) -> Recording:
    topic = "/joint_states/elbow"
    columns = {"position": f"{topic}/position", "velocity": f"{topic}/velocity", "torque": f"{topic}/effort"}
    return read_recording(path, columns=columns)


@functools.cache
def worked() -> bytes:
    """A session with a recording and an effect that was added."""
    from estimators import add
    from workbench.app.saved import pack
    from workbench.app.session import Session

    with tempfile.TemporaryDirectory() as folder:
        session = Session(Path(folder) / "session")
        session.load([written(recorded("run", 1, 4.0, rate=250.0), Path(folder))])
        session.state = session.state.with_step(add(session.state.model, "stribeck", session.state.train))
        return pack(session.state)


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
ALL: dict[str, Door] = FILES | {
    "dataset": (".parquet", read_survey, survey),
    "cases": (".csv", read_cases, lambda _: b"robot,joint,date,file,kind\nr1,j1,2026-03-01,a.csv,XL330\n,,,b/c.npz,\n"),
    "names": (".txt", read_names, lambda _: b"{robot}/*{joint}_{date}"),
    "plugin": (".py", read_plugin, lambda _: PLUGIN.encode()),
    "expression": (".txt", read_expression, lambda _: b"-i:A*0.091/6+0.1:Nm"),
    "session": (".zip", open_session, lambda _: worked()),
}
# What is wrong there may be told of another file, or of none
NAMELESS = (train, read_cases, read_expression, read_names, read_plugin)


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


NUMBERS = ["0", "-1", "1e200", "nan", "inf", "0 0 0", "0 0 1", "1e-320 0 0", "0 -1 1e9", "1 2", "", "x", "9" * 400]
NAMES = ["j0", "j1", "l0", "l1", "world", "", "a,b", "-j0", "j\u00e9", "/j"]


@st.composite
def chains(draw: Any) -> tuple[str, bytes]:
    """A robot of some joints, each in its attributes as it may be or not, as URDF or MJCF: its ending and its text."""
    number, name = st.sampled_from(NUMBERS), st.sampled_from(NAMES)

    def maybe(usual: str, other: st.SearchStrategy[str]) -> str:
        return draw(other) if draw(st.integers(0, 59)) == 37 else usual

    count = draw(st.integers(1, 6) | st.sampled_from([64, 65, 300]))
    kinds = st.sampled_from(["prismatic", "continuous", "fixed", "floating", "planar", "spherical", "free", "slide"])
    if draw(st.booleans()):
        parts = ['<link name="l0"/>']
        for k in range(count):
            inertia = f'<inertia ixx="{maybe("0.1", number)}" iyy="0.1" izz="0.1" ixy="{maybe("0", number)}" ixz="0"'
            place = f'<origin xyz="{maybe("0 0 0.3", number)}" rpy="{maybe("0 0 0", number)}"/>'
            mimic = f'<mimic joint="{draw(name)}" multiplier="{draw(number)}"/>' if maybe("", st.just("yes")) else ""
            parts.append(
                f'<joint name="{maybe(f"j{k}", name)}" type="{maybe("revolute", kinds)}">{place}'
                f'<parent link="{maybe(f"l{k}", name)}"/><child link="{maybe(f"l{k + 1}", name)}"/>'
                f'<axis xyz="{maybe("0 1 0", number)}"/>{mimic}'
                f'<limit lower="{maybe("-1", number)}" upper="1" effort="{maybe("9", number)}" velocity="9"/></joint>'
                f'<link name="{maybe(f"l{k + 1}", name)}"><inertial><mass value="{maybe("1", number)}"/>{place}'
                f'{inertia} iyz="0"/></inertial></link>'
            )
        return ".urdf", f'<robot name="{maybe("r", name)}">{"".join(parts)}</robot>'.encode()
    text = ""
    for k in reversed(range(count)):
        joint = f'<joint name="{maybe(f"j{k}", name)}" type="{maybe("hinge", kinds)}" axis="{maybe("0 1 0", number)}"/>'
        inertia = f'mass="{maybe("1", number)}" diaginertia="{maybe("0.1 0.1 0.1", number)}"'
        text = (
            f'<body name="{maybe(f"l{k}", name)}" pos="{maybe("0 0 0.3", number)}">{maybe(joint, st.just(""))}'
            f'<inertial pos="{maybe("0 0 0.1", number)}" {inertia}/>{text}</body>'
        )
    tie = f'<equality><joint joint1="{draw(name)}" joint2="{draw(name)}" polycoef="{draw(number)}"/></equality>'
    text = f'<option gravity="{maybe("0 0 -9.81", number)}"/><worldbody>{text}</worldbody>{maybe("", st.just(tie))}'
    return ".xml", f'<mujoco model="{maybe("r", name)}">{text}</mujoco>'.encode()


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
        from workbench.app.page.server import make_app
        from workbench.app.session import Session

        def idle(*_: object) -> None:
            raise InputError("nothing is started here")

        self._before = Session.work
        Session.work = idle  # type: ignore[assignment, method-assign]
        app, self.sessions = make_app()
        self.client = app.server.test_client()
        self.client.get("/_dash-layout")
        self.callbacks = self.client.get("/_dash-dependencies").get_json()
        self.session = self.sessions.of(self.ID)

    def close(self) -> None:
        from workbench.app.session import Session

        Session.work = self._before  # type: ignore[method-assign]
        self.sessions.close()

    def ask(self, callback: dict[str, Any], values: list[Any]) -> int:
        """Ask a callback with values for what it depends on; returns the status."""

        def named(id: str) -> Any:
            return json.loads(id) if id.startswith("{") else id

        def part(of: dict[str, Any]) -> Any:
            id, value = named(of["id"]), values.pop() if values and of["id"] != "session" else None
            many = isinstance(id, dict) and ["ALL"] in id.values()
            if isinstance(id, dict):
                id = {key: "run.csv" if isinstance(value, list) else value for key, value in id.items()}
            one = {"id": id, "property": of["property"], "value": self.ID if id == "session" else value}
            return [one] if many else one

        def output(text: str) -> dict[str, Any]:
            id, _, name = text.rpartition(".")
            return {"id": named(id), "property": name.partition("@")[0]}

        told, inputs = callback["output"], [part(one) for one in callback["inputs"]]
        first = inputs[0][0] if isinstance(inputs[0], list) else inputs[0]
        name = first["id"] if isinstance(first["id"], str) else json.dumps(first["id"], separators=(",", ":"))
        ask = {
            "output": told,
            "outputs": [output(one) for one in told[2:-2].split("...")] if told.startswith("..") else output(told),
            "inputs": inputs,
            "state": [part(one) for one in callback.get("state", [])],
            "changedPropIds": [f"{name}.{first['property']}"],
        }
        return self.client.post("/_dash-update-component", json=ask).status_code


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
