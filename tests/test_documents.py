"""What README and the pages of docs/ show is what the program does."""

import doctest
import importlib
import importlib.util
import inspect
import re
import tomllib

import pytest

from estimators.schemes.six import SCHEMES
from estimators.selection.search import find_effects, grow
from pendulum_env.physics import BASE, library
from tools import prose
from tools.prose import PAGES, README, ROOT, check, find_missing_line
from tools.refresh import update_output

EXAMPLES = sorted(
    path
    for package in ("pendulum_env", "estimators", "agents", "robots", "workbench")
    for path in (ROOT / package).rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.fixture
def isolated_folder(tmp_path):
    with prose.isolated_folder(tmp_path):
        yield


@pytest.mark.slow
@pytest.mark.pages
def test_the_readme_shows_what_happens(isolated_folder):
    assert len(prose.read_runnable_blocks(README)) > 5
    check(README)


@pytest.mark.slow
@pytest.mark.pages
@pytest.mark.parametrize("path", PAGES, ids=[str(path.relative_to(ROOT / "docs")) for path in PAGES])
def test_code_of_a_page_runs_and_prints_what_it_shows(isolated_folder, path):
    check(path)


@pytest.mark.parametrize("path", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_examples_in_docstrings_come_out_as_they_say(path):
    module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    found = doctest.testmod(module)
    assert found.attempted and not found.failed


@pytest.mark.parametrize(
    "path",
    [README, ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")],
    ids=lambda path: path.name,
)
def test_what_a_page_names_exists(path):
    page = path.read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page)
    assert not [link for link in links if not (path.parent / link).exists()]  # as a checkout shows the page
    rooms = "pendulum_env|estimators|agents|workbench|tests|benchmarks|examples|docs"
    files = re.findall(rf"(?<![\w/.-])((?:{rooms})/[\w./*-]*\w/?)", page)
    assert not [file for file in files if not any(ROOT.glob(file)) and not re.search(r"-v\d$", file)]
    modules = re.findall(rf"python -m ((?:{rooms})[\w.]*)", page)
    assert not [module for module in modules if importlib.util.find_spec(module) is None]
    targets = re.findall(r"(?m)(?:^    |`)make (?:[A-Z]+=\S+ )?(\w+)", page)
    rules = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert not [target for target in targets if not re.search(rf"(?m)^{target}:", rules)]
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    named = [*re.findall(r"extra `(\w+)`", page), *",".join(re.findall(r"'[\w.-]+\[([a-z][\w,]*)\]'", page)).split(",")]
    assert not set(named) - {*extras, ""}


def test_the_page_on_the_road_names_classes_and_functions_where_they_are():
    page = (ROOT / "docs" / "how-it-works.md").read_text(encoding="utf-8")
    rows = re.findall(r"(?m)^\|[^|\n]*\| ((?:`\w+`(?:, )?)+) \| `([\w/.]+\.py)` \|", page)
    told = re.findall(r"`(\w+)(?:\.\w+)?` in `([\w/.]+\.py)`", page)
    pairs = [(name, file) for names, file in rows for name in re.findall(r"\w+", names)] + told
    assert len(pairs) > 15
    for name, file in pairs:
        assert re.search(rf"(?m)^ *(class|def) {name}\b", (ROOT / file).read_text(encoding="utf-8")), (name, file)


def test_the_page_on_the_road_shows_the_loop_of_the_search():
    page = (ROOT / "docs" / "how-it-works.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"(?s)```py\n(.*?)```", page)
    assert shown.strip() == "\n\n\n".join(inspect.getsource(part).strip() for part in (find_effects, grow))


def test_the_extra_all_has_all_that_the_page_lists_and_constraints_pin_it():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    (everything,) = extras["all"]
    listed = re.findall(r"(?m)^\| `(\w+)` \|", (ROOT / "docs" / "how-to" / "install.md").read_text(encoding="utf-8"))
    user = re.search(r"\[(.+)\]", everything)[1].split(",")
    assert sorted([*user, "all"]) == sorted(listed) == sorted(set(extras) - {"docs", "dev"})
    pinned = re.findall(r"(?m)^([\w-]+)==", (ROOT / "constraints.txt").read_text(encoding="utf-8"))
    asked = {re.match(r"[\w-]+", one)[0] for extra in extras.values() for one in extra} - {"pendulum-ident"}
    assert asked <= set(pinned)


def test_the_table_of_the_readme_has_every_effect_and_scheme():
    table = README.read_text(encoding="utf-8").partition("## Effects and schemes")[2].partition("## ")[0]
    for id in [one.id for one in (*BASE, *library.BUILT_IN, *SCHEMES)]:
        assert table.count(f"`{id}`") == 1


def test_output_that_drifted_is_noticed():
    printed = "errors\ninertia  0.08951 ± 0.00012 kg m^2\ngravity  2.01 N m\n"
    assert (
        find_missing_line("inertia 0.08959 ± 0.00013 kg m^2\n...\ngravity 2.02 N m", printed) is None
    )  # as good as that
    assert find_missing_line("inertia 0.08965 ± 0.00012 kg m^2", printed) is not None  # more than a standard error off
    assert find_missing_line("inertia 0.08951 ± 0.00015 kg m^2", printed) is not None  # another standard error
    assert find_missing_line("gravity 2.04 N m", printed) is not None  # another number
    assert find_missing_line("inertia 0.08951 kg m^2", printed) is not None  # another text
    assert find_missing_line("gravity 2.01 N m\ninertia 0.08951 ± 0.00012", printed) is not None  # another order
    assert find_missing_line("spring 3 N m", printed) is not None


def test_stale_output_is_refreshed_and_what_was_left_out_stays_out():
    printed = "theta          unit\ninertia  0.0896 kg m^2  ##\nviscous  0.36 N m s\ngravity  2.01 N m\nall is well\n"
    stale = "theta     unit\ninertia  0.1 kg m^2\n...\n  gravity  1.9 N m\nall is not well\n"
    fresh = "theta          unit\ninertia  0.0896 kg m^2\n...\n  gravity  2.01 N m\nall is well\n"
    assert update_output(stale, printed) == (fresh, [])
    assert update_output(fresh, printed) == (fresh, [])
    assert update_output("spring 3 N m\n", printed) == ("spring 3 N m\n", ["spring 3 N m"])  # somebody has to look
