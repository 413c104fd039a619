"""The form `c`: one file of C99 that needs nothing but its mathematics library."""

from __future__ import annotations

from pendulum_env.physics import Model
from workbench.export.dynamics import Dynamics, written
from workbench.export.heading import heading, parameter_note, plain, state_note
from workbench.export.request import Exported, Request
from workbench.export.source import Dialect, Source

DIALECT = Dialect(
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
)
SIGN = "static double sign(double x) { return (x > 0) - (x < 0); }"


def export(model: Model, request: Request) -> Exported:
    """The file: parameters by name, `pendulum_state`, `pendulum_start` and `pendulum_step`."""
    dynamics = written(model, request.step)
    start, step = Source.of(dynamics.start, DIALECT), Source.of(dynamics.after, DIALECT)
    needed, waiting = start.names | step.names, dynamics.waiting
    said = [line.replace("step(state, torque)", "pendulum_step(state, torque)") for line in heading(model, dynamics)]
    lines = ["/* " + "\n   ".join(said).replace("\n   \n", "\n\n") + " */", "", "#include <math.h>"]
    lines += ["#include <string.h>"] if waiting else []
    lines += ["", f"#define PENDULUM_STEP {dynamics.step!r} /* [s] */", ""]
    lines += [
        f"static const double {p.name} = {DIALECT.number(p.value)}; /* {parameter_note(p)} */"
        for p in dynamics.parameters
        if p.name in needed
    ]
    lines += ["", "typedef struct {"]
    lines += [f"    double {name}; /* {state_note(name)} */" for name in dynamics.state]
    lines += [f"    double commands[{waiting + 1}]; /* [N m], newest first */"] if waiting else []
    lines += ["} pendulum_state;", ""]
    lines += [SIGN, ""] if "sign" in start.used | step.used else []
    lines += ["/* State of a joint that has been so for long, without torque. */"]
    lines += ["void pendulum_start(pendulum_state *state, double position, double velocity) {"]
    lines += [f"    const double {name} = {text};" for name, text in start.lines]
    results = ["0.0", "position", "velocity", *start.results]
    lines += [f"    state->{name} = {text};" for name, text in zip(dynamics.state, results, strict=True)]
    lines += ["    memset(state->commands, 0, sizeof state->commands);"] if waiting else []
    lines += [
        "}",
        "",
        f"/* State one PENDULUM_STEP later, under a torque [{plain(model.torque_unit)}] held meanwhile. */",
    ]
    lines += ["void pendulum_step(pendulum_state *state, double torque) {"]
    lines += [f"    const double {name} = state->{name};" for name in dynamics.state if name in step.names]
    lines += _take_in(dynamics) if waiting else []
    lines += [f"    const double {name} = {text};" for name, text in step.lines]
    lines += [f"    state->{name} = {text};" for name, text in zip(dynamics.state, step.results, strict=True)]
    lines += ["}", ""]
    return Exported("\n".join(lines), ())


def _take_in(dynamics: Dynamics) -> list[str]:
    """Take in the command, and the one that arrives now."""
    return [
        f"    memmove(state->commands + 1, state->commands, {dynamics.waiting} * sizeof(double));",
        "    state->commands[0] = torque;",
        f"    torque = {dynamics.arriving('state->commands')};",
    ]
