"""A model in a notebook: its torque balance and its parameters."""

from pendulum_env.formatting import TextTable, join_words
from pendulum_env.notebook import make_card, make_paragraph, make_table, render_html
from pendulum_env.physics.model import Model, shorten_name


def tabulate_parameters(model: Model) -> TextTable:
    """Tabulate parameters with standard errors."""
    named = {**model.readable, **model.derived}
    rows = [(shorten_name(name), e.text, e.unit) for name, e in ((name, own.shown) for name, own in named.items())]
    return TextTable(("parameter", "estimate", "unit"), rows, left=("unit",))


@render_html.register
def show_model(model: Model) -> str:
    """Show the torque balance and the parameters of a model."""
    law = " + ".join(term.law for term in model.terms)
    title = f"Model with {join_words([term.id for term in model.terms])}"
    return make_card(title, make_paragraph(f"torque = {law}"), make_table(tabulate_parameters(model)))
