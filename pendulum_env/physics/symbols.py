"""Symbolic numbers for NumPy, which record their computation.

A law is a function of NumPy arrays. Called with a `Symbol`, it returns its expression; the step of the simulation
returns the expression of the whole step. Compiled and exported models are therefore identical to the simulated ones,
including a user's effects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from pendulum_env._typing import Array

UNARY = ("negative", "absolute", "sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "arctan", "sign", "rint")
BINARY = ("add", "subtract", "multiply", "divide", "power", "maximum", "minimum")
COMPARISONS = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
LOGICAL = ("logical_and", "logical_or")
WHERE, NAME = "where", "name"
UFUNCS = {name: name for name in (*UNARY, *BINARY, *COMPARISONS, *LOGICAL)} | {
    "fmax": "maximum",
    "fmin": "minimum",
    "bitwise_and": "logical_and",
    "bitwise_or": "logical_or",
    "float_power": "power",
    "fabs": "absolute",
    "true_divide": "divide",
}


@dataclass(eq=False)
class Symbol(NDArrayOperatorsMixin):
    """Symbolic value: a name, or an operation on other values.

    Attributes:
        op: name of the operation.
        inputs: operands.
        label: name of the value for a reader.
        most: largest value of a duration [s], for the number of steps.
    """

    op: str
    inputs: tuple[Operand, ...] = ()
    label: str = ""
    largest: float | None = None

    __hash__ = object.__hash__

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options:  # where= and out= are not supported
            raise TypeError(f"np.{ufunc.__name__} with {', '.join(options) or method} has no written form")
        if any(isinstance(x, np.ndarray) and x.dtype == object for x in inputs):  # arrays of symbols, elementwise
            return ufunc(*map(box, inputs))
        if ufunc.__name__ == "square":
            return inputs[0] * inputs[0]
        if ufunc.__name__ not in UFUNCS:
            raise TypeError(f"np.{ufunc.__name__} has no written form")
        return make_operation(UFUNCS[ufunc.__name__], *inputs)

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if func not in FUNCTIONS:
            raise TypeError(f"np.{func.__name__} has no written form")
        return FUNCTIONS[func](*args, **kwargs)

    def __bool__(self) -> bool:
        raise TypeError("a branch that depends on values has no written form: use np.where")


Operand = Symbol | float
FUNCTIONS: dict[Any, Any] = {
    np.where: lambda condition, then, other: make_operation(WHERE, condition, then, other),
    np.clip: lambda x, low, high: np.minimum(np.maximum(x, low), high),
    np.ones_like: lambda x: np.float64(1.0),
    np.zeros_like: lambda x: np.float64(0.0),
}


def may_be_true(condition: Any) -> bool:
    """Return whether a condition may be true; always True for a symbol, which evaluates both branches."""
    return isinstance(condition, Symbol) or bool(condition.any() if isinstance(condition, np.ndarray) else condition)


def find_longest(duration: Any) -> float:
    """Return the longest of durations, or the bound of a symbolic duration."""
    if not isinstance(duration, Symbol):
        return float(np.max(duration))
    if duration.largest is None:
        raise TypeError("a largest value has no written form")
    return duration.largest


def make_symbol(text: str, largest: float | None = None) -> Symbol:
    """Make a symbol with a name and, if known, a largest value."""
    return Symbol(NAME, label=text, largest=largest)


def make_symbols(text: str, *shape: int) -> Any:
    """Make an array of named symbols, or a single symbol without a shape."""
    if not shape:
        return make_symbol(text)
    symbols = np.empty(shape, dtype=object)
    for place in np.ndindex(shape):
        symbols[place] = make_symbol(".".join((text, *map(str, place))))
    return symbols


def box(value: Any) -> Any:
    """Box a symbol into an array of shape (), so that NumPy broadcasts it; return other values unchanged."""
    if not isinstance(value, Symbol):
        return value
    boxed = np.empty((), dtype=object)
    boxed[()] = value
    return boxed


def make_operation(op: str, *inputs: Any) -> Operand:
    """Make an operation, simplified if possible."""
    operands = tuple(x if isinstance(x, Symbol) else float(x) for x in inputs)
    if op == "add" and all(map(_is_condition, operands)):  # NumPy adds truth values so
        return Symbol("logical_or", operands)
    if op == "power" and not isinstance(operands[1], Symbol) and operands[1] == 2.0:
        return make_operation("multiply", operands[0], operands[0])
    if op == WHERE and not isinstance(operands[0], Symbol):
        return operands[1] if operands[0] else operands[2]
    simplified = _simplify(op, operands) if op in BINARY else Symbol(op, operands)
    if op == "multiply" and isinstance(simplified, Symbol):  # a share of a duration
        share, whole = operands
        if isinstance(whole, Symbol) and whole.largest is not None and not isinstance(share, Symbol) and share > 0:
            simplified.largest = share * whole.largest
    return simplified


def _simplify(op: str, operands: tuple[Operand, ...]) -> Operand:
    """Simplify an operation with a neutral or absorbing element."""
    first, second = operands
    is_number = [not isinstance(x, Symbol) for x in operands]
    if op == "add" and is_number[0] and first == 0:
        return second
    if op in ("add", "subtract") and is_number[1] and second == 0:
        return first
    if op == "subtract" and first is second:
        return 0.0
    if is_number[1] and (op, second) in (("minimum", np.inf), ("maximum", -np.inf)):
        return first
    if op == "power" and is_number[1] and second == 1:
        return first
    if op == "multiply" and any(flag and x == 0 for flag, x in zip(is_number, operands, strict=True)):
        return 0.0
    if op == "divide" and is_number[0] and first == 0:
        return 0.0
    if op == "multiply" and is_number[0] and first == 1 and not _is_condition(second):
        return second
    if op in ("multiply", "divide") and is_number[1] and second == 1 and not _is_condition(first):
        return first
    return Symbol(op, operands)


def _is_condition(operand: Operand) -> bool:
    return isinstance(operand, Symbol) and operand.op in (*COMPARISONS, *LOGICAL)


def set_label(value: Any, label: str) -> Any:
    """Label a symbol without a label; return the value."""
    if isinstance(value, Symbol) and not value.label:
        value.label = label
    return value


def repeat_step(step: Callable[[Any, Any], Sequence[Any]], inputs: Array, states: Array, every: int = 1) -> Array:
    """Run a step by NumPy, for steps that are not symbolic.

    Args:
        step: function from inputs and states to the states after a step.
        inputs: inputs of each step (N, ...).
        states: initial states (S, ...).
        every: steps between returned states.

    Returns:
        States at the start and after each `every` steps (N / every + 1, S, ...).
    """
    path, current = [states], states
    for k, input_row in enumerate(inputs):
        current = np.array([np.broadcast_to(row, states.shape[1:]) for row in step(input_row, current)])
        if (k + 1) % every == 0:
            path.append(current)
    return np.array(path)


def sort_symbols(results: Sequence[Operand]) -> Iterator[Symbol]:
    """Yield the symbols of the results, each after its inputs."""
    visited: set[Symbol] = set()
    stack = [x for x in reversed(results) if isinstance(x, Symbol)]
    while stack:
        symbol = stack[-1]
        open_inputs = [x for x in symbol.inputs if isinstance(x, Symbol) and x not in visited]
        if symbol not in visited and open_inputs:
            stack += reversed(open_inputs)
            continue
        stack.pop()
        if symbol not in visited:
            visited.add(symbol)
            yield symbol


def merge_equal(results: Sequence[Operand]) -> tuple[list[Symbol], dict[Symbol, Symbol]]:
    """Merge equal symbols; return the distinct symbols in order, and the representative of each symbol."""
    symbol_by_key: dict[object, Symbol] = {}
    representatives: dict[Symbol, Symbol] = {}
    order = []
    for symbol in sort_symbols(results):
        inputs = tuple(representatives[x] if isinstance(x, Symbol) else x for x in symbol.inputs)
        key = (symbol.op, inputs, symbol.label if symbol.op == NAME else "")
        first = symbol_by_key.setdefault(key, symbol)
        representatives[symbol] = first
        if first is symbol:
            order.append(symbol)
    return order, representatives
