"""Every effect of the library is complete; a failure lists the missing parts with the files and lines to extend."""

import re
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import pytest

pytest.importorskip("mujoco")

from benchmarks import independent_plant, mujoco_plant
from benchmarks.independent_plant import Plant, random_case, simulate
from benchmarks.truth import Truth
from estimators.search_hints import SearchHints, find_hints
from pendulum_env.physics import Column, NonlinearParameter, Term, effects, list_nameable
from pendulum_env.physics.effect_texts import find_description
from pendulum_env.physics.library import BUILT_IN, MEASURED
from tests.cases import CASES
from tools.prose import README, ROOT

EXACT = {"seconds": 4.0, "excitation": "two_tone", "counts": None, "torque_noise": 0.0}


def is_described(id: str) -> bool:
    text = find_description(id)
    return all((text.symptom, text.signature, text.resembles, text.informative_experiment, text.omission))


def can_be_searched(id: str) -> bool:
    """Return whether hints, or else the bounds, give starting values of all nonlinear parameters."""
    kind = effects()[id]
    sought = [own for own in kind.nonlinear_parameters if own.nominal is None and not own.follows]
    has_bounds = all(own.instant or np.isfinite([own.low, own.high]).all() for own in sought)
    return has_bounds or find_hints(kind) != SearchHints()


def has_random_size(id: str) -> bool:
    try:
        random_case(np.random.default_rng(1), [id], **EXACT)
    except (NotImplementedError, ValueError):
        return False
    return True


def changes_the_motion(id: str) -> bool:
    if not has_random_size(id):
        return False
    case = random_case(np.random.default_rng(1), [id], **EXACT)
    with_effect, without = simulate([(case.plant, case.train), (Plant(**base(case.plant)), case.train)])
    return not np.array_equal(with_effect.position, without.position)


def base(plant: Plant) -> dict[str, float]:
    return {name: getattr(plant, name) for name in ("inertia", "gravity", "viscous", "coulomb")}


def has_true_parameters(id: str) -> bool:
    """Return whether the parameters of the plant are translated into those of the library."""
    if not has_random_size(id):
        return False
    case, kind = random_case(np.random.default_rng(1), [id], **EXACT), effects()[id]
    (run,) = simulate([(case.plant, case.train)])
    names = {column.name for column in kind().columns} | {f"{id}.{own.name}" for own in kind.nonlinear_parameters}
    return bool(names & Truth.of(id, run.truth).parameters.keys())


def is_in_mujoco(id: str) -> bool:
    machine = mujoco_plant.MACHINES["rig"]
    plant = mujoco_plant.Plant("rig", machine.inertia, machine.gravity, machine.viscous, machine.coulomb)
    try:
        return plant.effect(id) != mujoco_plant.Hidden()
    except ValueError:
        return False


def has_row(id: str) -> bool:
    table = README.read_text(encoding="utf-8").partition("## Effects and schemes")[2].partition("## ")[0]
    return table.count(f"`{id}`") == 1


GALLERY = ROOT / "docs" / "gallery"


@dataclass(frozen=True)
class Part:
    """A part of a complete effect: check of an id, task if it fails, and file with a text of the line to extend."""

    is_there: Callable[[str], bool]
    task: str
    file: str
    beside: str

    @property
    def place(self) -> str:
        lines = (ROOT / self.file).read_text(encoding="utf-8").splitlines()
        return f"{self.file}:{next(k for k, line in enumerate(lines, 1) if self.beside in line)}"


PLANT = "benchmarks/independent_plant.py"
PARTS = (
    Part(is_described, "add a Description with all texts", "pendulum_env/physics/effect_texts.py", "EFFECTS: "),
    Part(can_be_searched, "add hints, since bounds are infinite", "estimators/search_hints.py", "_HINTS: "),
    Part(lambda id: id in independent_plant.EFFECTS, "add parameters that switch it off", PLANT, "EFFECTS: "),
    Part(has_random_size, "add a random size", PLANT, "def _random_effect("),
    Part(
        changes_the_motion,
        "add the law here, or to _link_load, _friction or _balance",
        PLANT,
        "def _motor_torque(",
    ),
    Part(has_true_parameters, "translate the plant's parameters", "benchmarks/truth.py", "def _effect_parameters("),
    Part(is_in_mujoco, "add another form of the law", "benchmarks/mujoco_plant.py", "def _effect("),
    Part(lambda id: id in CASES and id in CASES[id].hidden, "add a case", "tests/cases.py", "TOLD = {"),
    Part(lambda id: (GALLERY / f"{id}.svg").exists(), "run `python -m tools.pictures`", "tools/pictures.py", "GALLERY"),
    Part(has_row, "add the id to the table of effects", "README.md", "## Effects and schemes"),
)


PAGE, TABLE = "docs/how-to/effect.md", "## Properties that the program asks"


class Plain(Term):
    """Term with the default of each attribute."""

    id, law, kind = "plain", "0", "dissipative"


def read_properties() -> dict[str, tuple[int, frozenset[str]]]:
    """Read the line and the effects of each attribute in the table of properties."""
    lines = (ROOT / PAGE).read_text(encoding="utf-8").splitlines()
    first = lines.index(TABLE)
    end = next(k for k in range(first + 1, len(lines)) if lines[k].startswith("## "))
    properties = {}
    for k in (k for k in range(first, end) if lines[k].startswith("| `")):
        (name,), _, ids = (re.findall("`([^`]+)`", cell) for cell in lines[k].strip("| ").split(" | "))
        properties[name] = k + 1, frozenset(ids)
    return properties


PROPERTIES = read_properties()


def has_property(kind: type[Term], name: str) -> bool:
    """Return whether an effect, or one of its columns or nonlinear parameters, differs from the default."""
    owner, _, part = name.rpartition(".")
    if not owner:
        return getattr(kind(), name) != getattr(Plain(), name)
    parts = kind().columns if owner == "Column" else kind.nonlinear_parameters
    return any(getattr(own, part) for own in parts)


def list_properties() -> set[str]:
    """List the optional attributes that the program asks."""
    described_elsewhere = {"at", "is_prismatic", "mechanism", "nonlinear_parameters", "typical_size", "description"}
    own = {name for name in Term.__annotations__ if name in vars(Term)} - described_elsewhere
    flags = {
        f"{part.__name__}.{own.name}"
        for part in (Column, NonlinearParameter)
        for own in fields(part)
        if own.type == "bool"
    }
    return own | {"delay", "lead", "ends"} | flags - {"NonlinearParameter.integer"} | {"NonlinearParameter.follows"}


@pytest.mark.parametrize("id", [kind.id for kind in BUILT_IN])
def test_effect_is_complete(id):
    missing = [f"{part.place}: {part.task}" for part in PARTS if not part.is_there(id)]
    properties = ", ".join(PROPERTIES)
    assert not missing, f"{id} is incomplete:\n" + "\n".join([*missing, f"{PAGE}: set its properties: {properties}"])


@pytest.mark.parametrize("name", PROPERTIES)
def test_property_lists_its_effects(name):
    line, listed = PROPERTIES[name]
    kinds = {kind.id: kind for kind in (*BUILT_IN, *MEASURED.values())}
    differing = {id for id, kind in kinds.items() if has_property(kind, name)}
    assert listed == differing, f"{PAGE}:{line} should list {sorted(differing)}"


def test_the_page_lists_every_property():
    assert PROPERTIES.keys() == list_properties()


def test_an_effect_without_entries_lacks_every_part_that_has_its_id():
    by_id = [part for part in PARTS if part.is_there is not can_be_searched]
    assert not [part.task for part in by_id if part.is_there("unlisted")]
    assert all(part.place for part in PARTS)


def test_the_readme_counts_the_effects():
    assert f"a library of {len(list_nameable())} effects" in README.read_text(encoding="utf-8")
