"""What is printed fits the terminal, and no number is ever broken."""

from io import StringIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from pendulum_env.formatting import draw_bar
from tests.cases import diagnosed
from workbench.printing import print_diagnosis
from workbench.terminal import Terminal

NUMBER = st.floats(-1e6, 1e6).map(lambda value: f"{value:.7g} ± {abs(value) / 1e4:.2g}")
HEADERS = ("scheme", "inertia [kg m^2]", "gravity [N m]", "viscous [N m s/rad]", "what it means")


def printed(width: int, headers, rows, left) -> str:
    terminal = Terminal()
    terminal._out = Console(file=StringIO(), width=width, force_terminal=True, color_system=None, markup=False)
    terminal.print_table(headers, rows, left)
    return terminal._out.file.getvalue()


@settings(max_examples=60)
@given(st.integers(40, 140), st.lists(st.tuples(NUMBER, NUMBER, NUMBER), min_size=1, max_size=4))
def test_numbers_stay_whole_at_any_width(width, numbers):
    words = "friction that grows where the speed falls, as between dry surfaces"
    rows = [(f"filtered_hamiltonian_{k}", *row, words) for k, row in enumerate(numbers)]
    out = printed(width, HEADERS, rows, ("what it means",))
    assert max(map(len, out.splitlines())) <= width
    for row in rows:
        assert all(word in out for cell in row[:-1] for word in cell.split(" ± "))


@pytest.mark.parametrize(("width", "stacked"), [(200, False), (60, True)])
def test_a_table_is_stacked_only_where_it_is_too_wide(width, stacked):
    out = printed(width, HEADERS, [("dynamic", "1", "2", "3", "nothing")], ())
    assert ("gravity [N m]  " in out.split("dynamic")[1]) == stacked


@pytest.mark.parametrize(("is_terminal", "lines"), [(True, 3), (False, 1)])
def test_further_lines_of_a_paragraph_are_indented_on_a_terminal_alone(is_terminal, lines):
    terminal = Terminal()
    terminal._out = Console(file=StringIO(), width=40 if is_terminal else 1000, force_terminal=is_terminal)
    terminal.print("- " + 20 * "word ")
    first, *others = terminal._out.file.getvalue().splitlines()
    assert first.startswith("- word") and len([first, *others]) == lines
    assert all(line.startswith("  word") for line in others)


@pytest.mark.parametrize(("name", "color"), [("stribeck", 33), ("steps", 32)])
def test_a_verdict_is_coloured_on_a_terminal_alone(name, color):
    terminal, found = Terminal(), diagnosed(name)
    for is_terminal in (True, False):
        kind = "standard" if is_terminal else None
        terminal._out = Console(file=StringIO(), width=200, force_terminal=is_terminal, color_system=kind)
        print_diagnosis(found, terminal)
        assert (f"\x1b[1;{color}m" in terminal._out.file.getvalue()) == is_terminal


def test_a_bar_is_as_long_as_its_share_in_eighths_or_halves():
    sizes = {sign: k / 8 for k, sign in enumerate(" ▏▎▍▌▋▊▉█")} | {"▐": 0.5}
    for share in np.linspace(-1, 1, 201):
        step = 1 / 8 if share >= 0 else 1 / 2
        size = sum(sizes[sign] for sign in draw_bar(share))
        assert abs(size - 12 * abs(share)) <= step / 2 + 1e-9 or size == step > 12 * abs(share) > 0
    assert draw_bar(0) == "" and draw_bar(3) == 12 * "█"
