"""Count what the house is made of: python -m tools.house.

Lines by package, the largest class and function, scalar constants of modules, words that are our own where the field
has one, circles of imports between folders, and how often a reader of `diagnose` comes back to a file.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("pendulum_env", "estimators", "agents", "workbench")
OTHERS = ("tests", "benchmarks", "tools", "examples")
WALKED = re.compile(r"estimators\.(diagnosis|selection|simulation)\.(?!arm|in_loop)")  # modules where effects are found
# Word here: the field's
OWN_WORDS = {
    "evidence": "prepared data",
    "flight": "segment",
    "fly": "simulate",
    "shot": "segment",
    "hop": "horizon",
    "astray": "simulation misfit",
    "foil": "nonparametric alternative",
    "wandering": "random-walk disturbance",
    "wander": "random-walk disturbance",
    "knock": "impact",
    "bristle": "friction state",
    "muffled": "absorbed noise",
    "rival": "competing model",
    "rugged": "multimodal",
    "stretch": "block",
    "likeliest": "maximum likelihood",
    "sharpen": "maximum-likelihood refit",
    "relink": "reselection of the transmission",
    "settle": "refit",
    "nudge": "perturbation",
    "shaken": "perturbation",
    "trifle": "tolerance",
    "chance": "p-value",
    "sure": "significant",
    "told": "reported",
    "said": "reported",
}


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def lines(package: str) -> int:
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in modules(package))


def largest(kind: type[ast.ClassDef] | type[ast.FunctionDef]) -> tuple[int, str]:
    found = [
        ((node.end_lineno or 0) - node.lineno + 1, f"{node.name}, {path.relative_to(ROOT)}")
        for package in PACKAGES
        for path in modules(package)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, kind)
    ]
    return max(found)


def scalars(path: Path) -> Iterator[str]:
    """Names of module constants that are one number."""
    known: dict[str, float] = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            try:
                value = eval(compile(ast.Expression(node.value), str(path), "eval"), {"__builtins__": {}}, dict(known))
            except Exception:  # of no number alone
                continue
            if isinstance(target, ast.Name) and isinstance(value, int | float) and not isinstance(value, bool):
                known[target.id] = value
                yield target.id


def own_words() -> Counter[str]:
    """How often identifiers use each word that the field has another for."""
    found: Counter[str] = Counter()
    for package in PACKAGES:
        for path in modules(package):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                name = {ast.Name: "id", ast.Attribute: "attr", ast.arg: "arg", ast.keyword: "arg"}.get(
                    type(node), "name"
                )
                for part in re.findall(r"[A-Z]?[a-z]+", str(getattr(node, name, ""))):
                    word = part.lower()
                    found[word if word in OWN_WORDS else word.removesuffix("s")] += 1
    return Counter({word: found[word] for word in OWN_WORDS if found[word]})


def room(path: Path) -> str:
    """The folder of a module, or the module itself if it lies directly in its package."""
    *folders, name = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(folders if len(folders) > 1 else [*folders, name])


def running(tree: ast.AST) -> Iterator[ast.AST]:
    """What is in a node, and then the node, much as it runs: arguments before calls, and nothing for types alone."""
    parts = list(ast.iter_child_nodes(tree))
    for part in [*parts[1:], *parts[:1]] if isinstance(tree, ast.Call | ast.Assign) else parts:
        if not (isinstance(part, ast.If) and ast.unparse(part.test) == "TYPE_CHECKING"):
            yield from running(part)
    yield tree


def circle() -> list[str]:
    """Folders that import each other in a circle, if any; what lies in no folder of its package stands for itself.

    What a folder's table of contents takes from folders in it is no import of its own.
    """
    graph: dict[str, set[str]] = {}
    for package in PACKAGES:
        for path in modules(package):
            here, lists = room(path), path.name == "__init__.py"
            for node in running(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in PACKAGES:
                    there = ROOT / node.module.replace(".", "/")
                    place = room(there / "__init__.py" if there.is_dir() else there.with_suffix(".py"))
                    if place != here and not (lists and place.startswith(f"{here}.")):
                        graph.setdefault(here, set()).add(place)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def walk(first: tuple[str, str] = ("estimators.diagnosis.run", "diagnose")) -> list[str]:
    """Stays of a reader who follows the calls of a function: modules of `WALKED`, each as often as it is come back to.

    A function is read once, where it is first named, before what follows there. Methods are found by their class, or
    by name where one class alone has it. What is of arms, or of servos in the loop, is left out.
    """
    functions: dict[tuple[str, str], ast.FunctionDef] = {}
    meant: dict[tuple[str, str], tuple[str, str]] = {}  # by a name in a module
    owners: dict[str, list[tuple[str, str]]] = {}  # of methods by name
    for path in (path for package in PACKAGES for path in modules(package)):
        here = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in running(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                meant |= {(here, one.asname or one.name): (node.module, one.name) for one in node.names}
        for node in tree.body:
            if isinstance(node, ast.FunctionDef):
                meant[here, node.name], functions[here, node.name] = (here, node.name), node
            elif isinstance(node, ast.ClassDef) and "Protocol" not in map(ast.unparse, node.bases):
                meant[here, node.name] = here, node.name
                for own in (own for own in node.body if isinstance(own, ast.FunctionDef)):
                    begins = own.name in ("__init__", "__post_init__")
                    name = node.name if begins else f"{node.name}.{own.name}"
                    functions[here, name] = own
                    owners.setdefault(own.name, []).append((here, name))
    stays: list[str] = []
    read: set[tuple[str, str]] = set()

    def follow(here: str, name: str) -> None:
        if (here, name) in read or (here, name) not in functions or not WALKED.match(here):
            return
        read.add((here, name))
        stays.extend([here] if stays[-1:] != [here] else [])
        nodes = [node for statement in functions[here, name].body for node in running(statement)]
        own = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        own |= {node.arg for node in ast.walk(functions[here, name]) if isinstance(node, ast.arg)}
        for node in nodes:
            if isinstance(node, ast.Name) and node.id not in own:
                follow(*meant.get((here, node.id), ("", "")))
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                of, called = ast.unparse(node.func.value), node.func.attr
                module, kind = (here, name.split(".")[0]) if of == "self" else meant.get((here, of), ("", ""))
                known = owners.get(called, [])
                for one in ((module, f"{kind}.{called}"), (f"{module}.{kind}", called), *known[: len(known) == 1]):
                    follow(*one)

    follow(*first)
    return stays


if __name__ == "__main__":
    counts = {package: lines(package) for package in (*PACKAGES, *OTHERS)}
    for package, count in counts.items():
        print(f"{count:7,d} lines  {package}")
    print(f"{sum(counts[package] for package in PACKAGES):7,d} lines  packages together")
    for kind, word in ((ast.ClassDef, "class"), (ast.FunctionDef, "function")):
        size, name = largest(kind)
        print(f"{size:7,d} lines  largest {word}: {name}")
    of = {package: sum(len(list(scalars(path))) for path in modules(package)) for package in PACKAGES}
    print(f"{sum(of.values()):7,d} scalar constants: {', '.join(f'{name} {count}' for name, count in of.items())}")
    words = own_words()
    print(f"{words.total():7,d} own words: {', '.join(f'{word} {count}' for word, count in words.most_common())}")
    print(f"        circle of folders: {' -> '.join(circle()) or 'none'}")
    stays = walk()
    returns = len(stays) - len(set(stays))
    print(f"        from `diagnose` to the verdict: {len(stays)} stays in {len(set(stays))} files, {returns} returns")
