"""The form `onnx`: a step of a batch of pendulums as a graph of operators, in double precision.

Inputs and outputs are named alike: time, position, velocity, the effects' memories, each of shape (batch,), and the
torque that is held over the step. The parameters are initializers of the graph under their own names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pendulum_env.physics import Model
from pendulum_env.physics.symbols import NAME, WHERE, Operand, Symbol, distinct
from workbench.export.dynamics import Dynamics, written
from workbench.export.extra import needed
from workbench.export.heading import heading
from workbench.export.request import Exported, Request, keep

OPSET = 18
DOUBLE = 11  # of onnx.TensorProto
OPERATORS = {
    "negative": "Neg", "absolute": "Abs", "sin": "Sin", "cos": "Cos", "tan": "Tan", "exp": "Exp", "log": "Log",
    "sqrt": "Sqrt", "tanh": "Tanh", "arctan": "Atan", "sign": "Sign",
    "add": "Add", "subtract": "Sub", "multiply": "Mul", "divide": "Div", "power": "Pow", "maximum": "Max",
    "minimum": "Min", "less": "Less", "less_equal": "LessOrEqual", "greater": "Greater",
    "greater_equal": "GreaterOrEqual", "equal": "Equal", "logical_and": "And", "logical_or": "Or", WHERE: "Where",
}  # fmt: skip
TRUTHS = ("logical_and", "logical_or")  # operators over truth values
LATE = "{seconds:g} s of dead time, as the graph has no place for commands on their way: delay the torque before it"


def export(model: Model, request: Request) -> Exported:
    """The graph, serialized.

    Raises:
        ExportError: if the torque arrives late and may not be exported without that, or a law cannot be written down.
        InputError: if the extra `export` is not installed.
    """
    onnx = needed("onnx")
    dynamics = written(model, request.step)
    late = [LATE.format(seconds=dynamics.delay * dynamics.step)] if dynamics.delay else []
    notes = keep("onnx", late, request)
    graph = _Graph(onnx.helper, dynamics)
    graph.write(dynamics.after)
    helper = onnx.helper
    ports = [helper.make_tensor_value_info(name, DOUBLE, ["batch"]) for name in (*dynamics.state, "torque")]
    results = [helper.make_tensor_value_info(f"next_{name}", DOUBLE, ["batch"]) for name in dynamics.state]
    content = helper.make_model(
        helper.make_graph(graph.nodes, "pendulum", ports, results, graph.constants),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=9,
        producer_name="pendulum-ident",
        doc_string="\n".join(heading(model, dynamics)),
    )
    onnx.checker.check_model(content, full_check=True)
    return Exported(content.SerializeToString(), notes)


@dataclass
class _Graph:
    """Operators in order, and the numbers they need."""

    helper: Any
    dynamics: Dynamics
    nodes: list[Any] = field(default_factory=list)
    constants: list[Any] = field(default_factory=list)
    numbers: dict[float, str] = field(default_factory=dict)

    def write(self, results: Sequence[Operand]) -> None:
        """Write down everything that the results need, and name them."""
        order, same = distinct(results)
        used = {symbol.label for symbol in order if symbol.op == NAME}
        for parameter in self.dynamics.parameters:
            if parameter.name in used:
                self._constant(parameter.name, parameter.value)
        names: dict[Symbol, str] = {}
        for symbol in order:
            names[symbol] = symbol.label if symbol.op == NAME else self._operation(symbol, names, same)
        for name, result in zip(self.dynamics.state, results, strict=True):
            value = names[same[result]] if isinstance(result, Symbol) else self._number(result)
            # what does not depend on the state has the shape of the batch all the same
            self._node("Add", [value, self._node("Sub", ["time", "time"])], f"next_{name}")

    def _operation(self, symbol: Symbol, names: dict[Symbol, str], same: dict[Symbol, Symbol]) -> str:
        inputs = []
        for place, x in enumerate(symbol.inputs):
            if not isinstance(x, Symbol):
                inputs.append(self._number(x))
                continue
            truth = symbol.op in TRUTHS or (symbol.op == WHERE and place == 0)
            given = names[same[x]]
            inputs.append(given if truth or not x.is_condition else self._node("Cast", [given], to=DOUBLE))
        if symbol.op == "not_equal":
            return self._node("Not", [self._node("Equal", inputs)])
        return self._node(OPERATORS[symbol.op], inputs)

    def _node(self, operator: str, inputs: Sequence[str], output: str = "", **attributes: int) -> str:
        output = output or f"t{len(self.nodes) + 1}"
        self.nodes.append(self.helper.make_node(operator, list(inputs), [output], **attributes))
        return output

    def _number(self, value: float) -> str:
        if value not in self.numbers:
            self.numbers[value] = f"number_{len(self.numbers) + 1}"
            self._constant(self.numbers[value], value)
        return self.numbers[value]

    def _constant(self, name: str, value: float) -> None:
        self.constants.append(self.helper.make_tensor(name, DOUBLE, [], np.array([value])))
