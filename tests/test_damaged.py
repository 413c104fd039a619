"""Damaged files of every format that is read: each is refused in one sentence, or read without what is not there."""

import functools
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from agents.config import Config
from agents.network import POLICY_FOLDER, Network
from benchmarks.two_link import TwoLink
from pendulum_env.backends.hardware.config import load as load_rig
from pendulum_env.errors import FileError, UserError
from pendulum_env.physics import Model
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.joints import place_effect
from pendulum_env.physics.potential import Cogging
from pendulum_env.physics.table import TABLES, Extent
from pendulum_env.reading import read_toml
from pendulum_env.recording import Recording, read_recording, write_recording
from pendulum_env.recording.study import read_sources
from robots.arms import arm_base, read_body
from robots.arms.model import ArmModel
from tests.pendulum_env.recording.test_formats import write_bag, write_xlsx
from tests.two_link import body
from workbench.errors import format_mistake
from workbench.runs import read_suggestion

for module in ("h5py", "pinocchio", "python_calamine", "rosbags"):
    pytest.importorskip(module)

STORED = Path(__file__).parent / "stored"
LOG_FORMAT = {"columns": {"torque_elbow": "i:A*0.4"}, "unwrap": True}
MJCF = (
    '<mujoco model="one"><default><joint armature="0.01"/></default><worldbody><body name="arm" pos="0 0 1">'
    '<joint name="shoulder" axis="0 -1 0" range="-90 90"/>'
    '<inertial pos="0 0 -0.2" mass="1" diaginertia="0.1 0.1 0.01"/></body></worldbody></mujoco>'
)


def signals() -> dict[str, np.ndarray]:
    at = np.arange(300) / 100.0
    return {"time": at, "position": np.sin(3 * at), "torque": np.cos(3 * at)}


def stored(path: Path) -> bytes:
    write_recording(Recording(**signals(), name="run"), path)
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
    columns = signals()
    write_xlsx(path, [list(columns), *np.column_stack(list(columns.values())).tolist()])
    return path.read_bytes()


def bag(path: Path, kind: str = "mcap") -> bytes:
    place = path.with_suffix(".bag" if kind == "ros1" else "")
    write_bag(place, kind)
    inner = place if kind == "ros1" else next(file for file in place.iterdir() if file.suffix in (".mcap", ".db3"))
    return inner.read_bytes()


def read_elbow(path: Path) -> Recording:
    topic = "/joint_states/elbow"
    columns = {"position": f"{topic}/position", "velocity": f"{topic}/velocity", "torque": f"{topic}/effort"}
    return read_recording(path, columns=columns)


def kept(name: str) -> Callable[[Path], bytes]:
    """Return the content of a file of `stored/`, a model with limits."""
    content = (STORED / name).read_bytes()
    if name == "model.json":
        limits = {"viscous": [0.1, 0.6], "coulomb": [None, 2.0], "cogging.order": [4.0, 40.0]}
        content = json.dumps(json.loads(content) | {"limits": limits}).encode()
    return lambda _: content


def arm_model(_: Path) -> bytes:
    """A model of an arm with an effect that has whole numbers, a table and a log's format."""
    terms = [
        *arm_base(body()),
        *(kind() for kind in (place_effect(Cogging, "elbow"), place_effect(Stribeck, "shoulder"))),
    ]
    terms.append(place_effect(TABLES["torque_by_angle"], "elbow").with_extent(Extent(-1.0, 2.0, 4))())
    model = ArmModel.build(terms, 0.5, 0.01)
    return json.dumps(model.json() | {"log_format": LOG_FORMAT}).encode()


def read_training(path: Path) -> Config:
    settings = read_toml(path)
    try:
        return Config.from_settings(settings)
    except ValueError as error:
        raise FileError(f"{path}: {error}") from None  # as `train` does


Format = tuple[str, Callable[[Path], object], Callable[[Path], bytes]]  # a file's ending, its reader, and a good one
FORMATS: dict[str, Format] = {
    "model": (".json", Model.load, kept("model.json")),
    "arm-model": (".json", lambda path: ArmModel.load(path, body()), arm_model),
    "diagnosis": (".json", lambda path: read_suggestion(str(path)), kept("diagnosis.json")),
    "rig": (".toml", load_rig, kept("rig.toml")),
    "study": (".toml", read_sources, kept("study.toml")),
    "training": (".toml", read_training, kept("training.toml")),
    "policy": (".npz", Network.load, lambda _: (POLICY_FOLDER / "peak.npz").read_bytes()),
    **{f"recording{end}": (end, read_recording, stored) for end in (".csv", ".csv.gz", ".npz", ".parquet")},
    "recording.mat": (".mat", read_recording, matlab),
    "recording.h5": (".h5", read_recording, hdf5),
    "recording.xlsx": (".xlsx", read_recording, excel),
    "recording.mcap": (".mcap", read_elbow, bag),
    "recording.bag": (".bag", read_elbow, functools.partial(bag, kind="ros1")),
    "recording.db3": (".db3", read_elbow, functools.partial(bag, kind="sqlite3")),
    "robot.urdf": (".urdf", read_body, lambda _: TwoLink().urdf().encode()),
    "robot.xml": (".xml", read_body, lambda _: MJCF.encode()),
}
DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "cut in half": lambda content: content[: len(content) // 2],
    "without its beginning": lambda content: content[len(content) // 2 :],
    "of another format": lambda content: bytes(range(256)),
    "overwritten in the middle": lambda content: content[: len(content) // 2] + bytes(999) + content[-99:],
}
CUT = ("empty", "cut in half", "without its beginning")
READABLE = {("recording.csv", "cut in half"), *(("training", damage) for damage in CUT)}  # settings are optional


def refusal(read: Callable[[Path], object], path: Path) -> str | None:
    """The sentence that refuses a file; None if it is read, a recording or a model with finite numbers."""
    try:
        found = read(path)
    except UserError as mistake:
        told = format_mistake(mistake)
        assert path.name in told and len(told) <= 500 and told.isprintable()
        return told
    if isinstance(found, Recording):
        assert all(np.isfinite(values).all() for values in found.columns.values())
    if isinstance(found, Model):
        assert np.isfinite(found.theta).all()
    return None


@pytest.fixture(scope="module", params=FORMATS)
def whole(request, tmp_path_factory):
    """Name, ending, reader and content of a whole file."""
    ending, read, make = FORMATS[request.param]
    path = tmp_path_factory.mktemp("whole") / f"run{ending}"
    content = make(path)
    path.write_bytes(content)
    assert refusal(read, path) is None
    return request.param, ending, read, content


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_refused_in_one_sentence(whole, damage, tmp_path):
    name, ending, read, content = whole
    path = tmp_path / f"run{ending}"
    path.write_bytes(DAMAGE[damage](content))
    assert (refusal(read, path) is None) == ((name, damage) in READABLE)


def test_what_is_no_file_or_too_large_is_refused(whole, tmp_path):
    _, ending, read, _ = whole
    folder, large, nowhere = (tmp_path / f"{name}{ending}" for name in ("folder", "large", "nowhere"))
    folder.mkdir()
    with large.open("wb") as file:
        file.truncate(10**12)  # takes no room
    for path, reason in [(folder, "folder"), (large, "at most 500 MB are read: shorten it"), (nowhere, "o such")]:
        assert reason in refusal(read, path)
