"""The forms `python` and `c`: a step as a program that needs nothing, laid out by the template of its language."""

from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined

from pendulum_env.physics import Model
from pendulum_env.physics.symbols import BINARY, LOGICAL, UNARY, WHERE
from workbench.export.dynamics import Dynamics, Parameter, Quantity, written
from workbench.export.request import Exported, Language, Request, plain, title
from workbench.export.source import INFIX, Dialect, Source

JOINT, ACTUATOR = "joint", "torque"  # names in a file of MuJoCo's, by which the program beside it finds them
CALLED = sorted({*UNARY, *BINARY, *LOGICAL, WHERE} - {*INFIX, "negative"})
FUNCTIONS = {  # of single numbers in Python, by NumPy's names; the others are called so in math, too
    "absolute": "abs",
    "maximum": "max",
    "minimum": "min",
    "power": "math.pow",
    "arctan": "math.atan",
    "sign": "lambda x: float(x > 0) - float(x < 0)",
    "logical_and": "lambda one, other: one and other",
    "logical_or": "lambda one, other: one or other",
    "where": "lambda condition, then, other: then if condition else other",
}
DIALECTS: dict[Language, Dialect] = {
    "python": Dialect(  # the module takes NumPy's numbers and arrays, too
        calls={
            op: f"np.{op}({', '.join(f'{{{k}}}' for k in range(3 if op == WHERE else 1 if op in UNARY else 2))})"
            for op in CALLED
        },
        infinity="math.inf",
    ),
    "c": Dialect(  # C99, with its mathematics library
        calls={
            "absolute": "fabs({0})",
            "sign": "sign({0})",
            "maximum": "fmax({0}, {1})",
            "minimum": "fmin({0}, {1})",
            "power": "pow({0}, {1})",
            "logical_and": "{0} && {1}",
            "logical_or": "{0} || {1}",
            "where": "{0} ? {1} : {2}",
            "arctan": "atan({0})",
            **{op: f"{op}({{0}})" for op in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")},
        },
        infinity="INFINITY",
    ),
}
STATE = {  # what its parts are, and their units
    "time": "[s]",
    "position": "[rad], 0 hangs down",
    "velocity": "[rad/s]",
    "integral": "of the error",
    "held": "output of the controller",
    "speed": "as the controller sees it [rad/s]",
    "phase": "turns of the controller, which looks again at 1",
}


def export(model: Model, request: Request, language: Language) -> Exported:
    """A module, or a file of C: parameters by name, the state, its start, and its step."""
    return Exported(program(language, model, written(model, request.step, request.drive)))


def program(language: Language, model: Model, dynamics: Dynamics, prefix: str = "pendulum") -> str:
    """Text of a program; in C, names begin with the prefix. What gives results is called before MuJoCo's own step."""
    dialect, results, count = DIALECTS[language], list(dynamics.results), len(dynamics.state)
    start = Source.of(dynamics.start, dialect)
    step = Source.of([*dynamics.after, *dynamics.results.values()], dialect)
    call = ", ".join(("state", *(quantity.name for quantity in dynamics.given)))
    return (
        _environment()
        .get_template("step.py.txt" if language == "python" else "step.c.txt")
        .render(
            number=dialect.number,
            title=title(model),
            torque_unit=plain(model.torque_unit),
            call=f"step({call})" if language == "python" else f"{prefix}_step({call})",
            prefix=prefix,
            dynamics=dynamics,
            waiting=dynamics.waiting,
            parameters=[p for p in dynamics.parameters if p.name in start.names | step.names],
            state=list(dynamics.state),
            given=dynamics.given,
            told=[quantity for quantity in dynamics.given if quantity.name not in ("position", "velocity")],
            results=results,
            start=start,
            step=step,
            after=step.results[:count],
            gives=step.results[count:],
            called=CALLED,
            functions=FUNCTIONS,
            joint=JOINT,
            actuator=ACTUATOR,
        )
    )


def note(item: Quantity | Parameter) -> str:
    """Name and unit of what a step is given or gives; unit and standard error of a parameter."""
    if isinstance(item, Quantity):
        return f"{item.name} [{plain(item.unit)}]"
    return f"[{plain(item.unit)}]" + (f", standard error {item.std:.2g}" if item.std else "")


def state_note(name: str) -> str:
    """What a part of the state is, and its unit."""
    return STATE.get(name, "what it was before, as the model remembers it")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("workbench.export"), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"note": note, "state_note": state_note}
    return environment
