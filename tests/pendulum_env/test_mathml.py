"""Laws as MathML."""

import xml.etree.ElementTree as ElementTree

import pytest

from estimators.schemes.six import SCHEMES
from pendulum_env.mathml import format_law
from pendulum_env.physics import BASE, list_nameable
from pendulum_env.physics.table import TABLES

LAWS = [kind.law for kind in (*BASE, *list_nameable().values(), *TABLES.values())] + [one.balance for one in SCHEMES]


@pytest.mark.parametrize("law", [*LAWS, "a) ^ (b & <c> ^"])
def test_a_law_is_markup_without_signs_of_the_command_line(law):
    text = "".join(ElementTree.fromstring(format_law(law)).itertext())
    assert not {"'", "^", "_"} & set(text) and "tau" not in text


def test_powers_indices_and_derivatives_stand_at_what_they_belong_to():
    root = ElementTree.fromstring(format_law("fs exp(-|q'/vs|^n) sgn q'"))
    assert [[part.text for part in index] for index in root.iter("msub")] == [["f", "s"], ["v", "s"]]
    assert [power[1].text for power in root.iter("msup")] == ["n"]
    assert [[part.text for part in dotted] for dotted in root.iter("mover")] == 2 * [["q", "˙"]]
    (power,) = ElementTree.fromstring(format_law("(q + 1)^(1/r)")).iter("msup")
    assert "".join(power[0].itertext()) == "(q+1)" and "".join(power[1].itertext()) == "1/r"
