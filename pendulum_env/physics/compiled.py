"""Compile recurrences over a batch; NumPy would loop over small arrays.

Laws are NumPy functions. Evaluated on `symbols`, they become the lines of a program for LLVM, which compiles a small
program in 10 ms.
"""

import ctypes
import ctypes.util
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir

from pendulum_env._typing import Array, Mask
from pendulum_env.physics import symbols

MANY_LANES, FEW_RESULTS = 64, 50  # least number of lanes for a vector program; most results for LLVM's optimisation
WIDTH = 16  # lanes of a vector, two independent instructions of the processor
DOUBLE, WHOLE, POINTER = ir.DoubleType(), ir.IntType(64), ir.PointerType()
CALLS = {  # LLVM functions by operation; some call the C library
    "absolute": "fabs",
    "sqrt": "sqrt",
    "maximum": "maxnum",
    "minimum": "minnum",
    "exp": "exp",
    "log": "log",
    "power": "pow",
    "tan": "tan",
    "tanh": "tanh",
    "arctan": "atan",
    "rint": "rint",
}
LIBRARY = ("rint", "exp", "log", "pow", "tan", "tanh", "atan", "fmax", "fmin")
PI = (3.141592651605606, 1.9841871479187034e-09, 1.1442377452219664e-17)  # 27 bits, 25 bits and the rest
ODD = (  # coefficients of x, x^3, x^5, ...: minimax polynomial of the sine up to pi / 2, error 3e-19
    1.0,
    -0.16666666666666666,
    0.008333333333333186,
    -0.00019841269841208676,
    2.7557319211229606e-06,
    -2.505210689056952e-08,
    1.605894087848656e-10,
    -7.643026557971632e-13,
    2.7215749422983443e-15,
)
ARITHMETIC = {"add": "fadd", "subtract": "fsub", "multiply": "fmul", "divide": "fdiv"}
Place = tuple[int | None, float]  # operand: number of the line that computes it, or None and a constant
Line = tuple[Any, ...]  # operation, name of a given value, and places of the operands
Names = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]  # names of inputs, constants and states
SIGNS = {"less": "<", "less_equal": "<=", "greater": ">", "greater_equal": ">=", "equal": "==", "not_equal": "!="}


@dataclass(frozen=True)
class Recurrence:
    """Compiled step of the states of V B systems.

    Attributes:
        program: function of `_write_program`.
        engine: LLVM engine that owns the program.
        width: lanes of a vector.
        n_derived: number of values that the program computes once, from the constants.
    """

    program: Callable[..., None]
    engine: Any
    width: int
    n_derived: int

    def __call__(
        self,
        inputs: Array,
        constants: Array,
        states: Array,
        every: int = 1,
        steps_per_input: int = 1,
        returned: Sequence[int] | None = None,
    ) -> Array:
        """Return states at the start and after every `every` steps (N held / every + 1, kept, V, B).

        Args:
            inputs: inputs (N, inputs, B), equal for all V, or the result of `wrap_inputs`.
            constants: constants (constants, V, B).
            states: initial states (S, V, B).
            every: steps between returned states.
            steps_per_input: steps per input.
            returned: indices of the returned states; by default all.
        """
        return self.run(inputs, constants, states, every, steps_per_input, returned)[0]

    def run(
        self,
        inputs: Array,
        constants: Array,
        states: Array,
        every: int = 1,
        steps_per_input: int = 1,
        returned: Sequence[int] | None = None,
    ) -> tuple[Array, Array]:
        """Return the states as a call, and all states after the last step (S, V, B)."""
        shape, cycle, lanes = states.shape, states.shape[2], states.shape[1] * states.shape[2]
        rows = np.arange(len(states)) if returned is None else np.array(returned)
        wrapped = inputs if inputs.shape[2] > cycle else self.wrap_inputs(inputs)
        padded = -(-lanes // self.width) * self.width
        parameters, current = np.empty((len(constants) + self.n_derived, padded)), np.empty((len(states), padded))
        for values, place in ((constants, parameters), (states, current)):
            place[: len(values), :lanes] = values.reshape(len(values), lanes)
            place[: len(values), lanes:] = place[: len(values), lanes - 1 : lanes]
        steps = len(inputs) * steps_per_input
        path = np.empty((steps // every + 1, len(rows), padded))
        path[0] = current[rows]
        counts = steps, every, steps_per_input, padded, cycle, wrapped.shape[2], len(rows)
        self.program(*counts, *(values.ctypes.data for values in (wrapped, parameters, current, path, rows)))
        return path[..., :lanes].reshape(len(path), len(rows), *shape[1:]), current[:, :lanes].reshape(shape)

    def wrap_inputs(self, inputs: Array) -> Array:
        """Return inputs (N, inputs, B) in the layout of the program, with the first lanes repeated at the end.

        A vector may contain lanes of two variants.
        """
        cycle = inputs.shape[2]
        if cycle % self.width:
            lanes = np.arange(cycle + self.width) % cycle
            inputs = np.take(inputs, lanes, axis=-1, mode="clip")  # twice as fast as with checks
        return np.ascontiguousarray(inputs, dtype=float)


@dataclass(frozen=True)
class SymbolicStep:
    """Step of a recurrence in symbols or arrays of symbols.

    Attributes:
        given: symbols of the inputs, by label.
        before: symbols of the states before the step, by label.
        after: values of the states after the step and of further results, by label.
    """

    inputs: Mapping[str, Any]
    before: Mapping[str, Any]
    after: Mapping[str, Any]

    def compile(self, lanes: int) -> Recurrence:
        """Compile the program for a number of lanes; vectors and optimisation only for many lanes."""
        states = {
            label: self.before.get(label, symbols.make_symbols(label, *np.shape(symbols.box(value))))
            for label, value in self.after.items()
        }
        inputs, before, after = map(_flatten_parts, (self.inputs, states, self.after))
        level, width = (int(len(after) <= FEW_RESULTS), WIDTH) if lanes >= MANY_LANES else (0, 1)
        return compile_recurrence(inputs, [], before, after, level, width)


class Machine:
    """Recurrence that advances by single steps; each lane of a batch is a separate system.

    Attributes:
        given: inputs by label, each (..., *lanes); the caller fills them in place before a step.
        now: states and results by label, each (..., *lanes); a step changes them in place.
    """

    def __init__(self, write: Callable[..., SymbolicStep], arguments: tuple[Any, ...], *lanes: int) -> None:
        """Compile the step of `write(*arguments)` for the shape of the lanes; pickling keeps only these arguments."""
        self._arguments, self._lanes = (write, arguments, *lanes), lanes
        step = write(*arguments)
        self._program = step.compile(math.prod(lanes))  # keeps LLVM's engine alive
        self._input_rows, self.inputs = _allocate_rows(step.inputs, lanes, self._program.width)
        self._state_rows, self.states = _allocate_rows(step.after, lanes, self._program.width)
        padded = self._state_rows.strides[0] // self._state_rows.itemsize
        counts = 1, 2, 1, padded, padded, padded, 0  # no states are returned
        self.step = partial(
            self._program.program, *counts, self._input_rows.ctypes.data, 0, self._state_rows.ctypes.data, 0, 0
        )

    def reset(self, is_reset: Mask) -> None:
        """Set the states of lanes to zero; the mask is broadcast to the shape of the lanes."""
        self._state_rows[:, np.broadcast_to(is_reset, self._lanes).ravel()] = 0.0

    def __reduce__(self) -> Any:
        return Machine, self._arguments, (self._input_rows, self._state_rows)

    def __setstate__(self, values: tuple[Array, Array]) -> None:
        self._input_rows[:], self._state_rows[:] = values


def _allocate_rows(parts: Mapping[str, Any], lanes: tuple[int, ...], width: int) -> tuple[Array, dict[str, Array]]:
    """Allocate rows (N, L) for the values of all parts; return them with views of each part (..., *lanes).

    Rows are padded to a multiple of the width.
    """
    count = math.prod(lanes)
    rows = np.zeros((len(_flatten_parts(parts)), -(-count // width) * width))[:, :count]
    places, first = {}, 0
    for label, part in parts.items():
        shape = np.shape(symbols.box(part))
        end = first + math.prod(shape)
        places[label] = rows[first:end].reshape(*shape, *lanes)
        first = end
    return rows, places


def _flatten_parts(parts: Mapping[str, Any]) -> list[Any]:
    return [value for part in parts.values() for value in np.asarray(symbols.box(part), dtype=object).ravel()]


def compile_recurrence(
    inputs: Sequence[symbols.Symbol],
    constants: Sequence[symbols.Symbol],
    states: Sequence[symbols.Symbol],
    after: Sequence[symbols.Operand],
    level: int = 1,
    width: int = WIDTH,
) -> Recurrence:
    """Compile the states `after` a step, expressions in the symbols of inputs, constants and previous states.

    `level` is LLVM's level of optimisation, and `width` the lanes of a vector. Equal expressions are compiled once.
    """
    results = [
        x if isinstance(x, symbols.Symbol) else float(x) for x in after
    ]  # `np.where` of numbers returns an array
    names = tuple(tuple(symbol.label for symbol in each) for each in (inputs, constants, states))
    return _compile(names, *_write_lines(results), level, width)


def _write_lines(results: Sequence[symbols.Operand]) -> tuple[tuple[Line, ...], tuple[Place, ...]]:
    """Return expressions as lines, each an operation on earlier lines, and the places of the results."""
    order, representatives = symbols.merge_equal(results)
    place = {symbol: k for k, symbol in enumerate(order)}

    def find_place(operand: symbols.Operand) -> Place:
        return (place[representatives[operand]], 0.0) if isinstance(operand, symbols.Symbol) else (None, operand)

    lines = ((s.op, s.label if s.op == symbols.NAME else "", *map(find_place, s.inputs)) for s in order)
    return tuple(lines), tuple(map(find_place, results))


@lru_cache(maxsize=256)
def _compile(names: Names, lines: tuple[Line, ...], results: tuple[Place, ...], level: int, width: int) -> Recurrence:
    _initialise_llvm()
    machine = llvm.Target.from_default_triple().create_target_machine(
        llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten(), opt=level
    )
    steady = _list_steady_lines(names[1], lines, results)
    module = llvm.parse_assembly(str(_write_program(names, lines, results, steady, width)))
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    call = ctypes.CFUNCTYPE(None, *7 * [ctypes.c_int64], *5 * [ctypes.c_void_p])
    return Recurrence(call(engine.get_function_address("run")), engine, width, len(steady))


@cache
def _initialise_llvm() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    library = ctypes.CDLL(ctypes.util.find_library("m") or ctypes.util.find_library("msvcrt"))
    for name in LIBRARY:
        llvm.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)


def _list_steady_lines(constants: Sequence[str], lines: Sequence[Line], results: Sequence[Place]) -> list[int]:
    """Return the lines that depend only on constants and that other lines or the results use."""
    steady, used_lines = set[int](), {line for line, _ in results}
    for k, (op, label, *operands) in enumerate(lines):
        if label in constants if op == symbols.NAME else all(line is None or line in steady for line, _ in operands):
            steady.add(k)
        else:
            used_lines |= {line for line, _ in operands}
    return [k for k in sorted(steady & used_lines) if lines[k][0] != symbols.NAME]


def _write_program(
    names: Names, lines: Sequence[Line], results: Sequence[Place], steady: Sequence[int], width: int
) -> ir.Module:
    """Write the program: a loop over lanes for values of the constants, then loops over steps and lanes.

    The lanes of all variants form a row, computed by vectors of `width`. Arguments of the program: number of steps,
    steps between kept states, steps per input, number of lanes, lanes per variant, length of a row of inputs, number of
    kept states, then the addresses of inputs, constants, states, path and indices of the kept states.
    """
    module, kind = ir.Module(), DOUBLE if width == 1 else ir.VectorType(DOUBLE, width)
    program = ir.Function(module, ir.FunctionType(ir.VoidType(), 7 * [WHOLE] + 5 * [POINTER]), "run")
    steps, every, repeats, lanes, cycle, row, count, wrapped, parameters, current, path, returned = program.args
    builder = ir.IRBuilder(program.append_basic_block())
    write = _Instructions(module, builder, kind)
    (inputs, constants, states), size = names, builder.mul(lanes, WHOLE(8))
    shared = [*constants, *steady]  # rows of constants, then of values that depend only on them

    def place(array: Any, first: Any, number: Any, stride: Any) -> Any:
        return builder.gep(array, [builder.add(first, builder.mul(number, stride))], source_etype=DOUBLE)

    def load(array: Any, first: Any, labels: Sequence[Any], stride: Any) -> dict[Any, Any]:
        places = (place(array, first, WHOLE(k), stride) for k in range(len(labels)))
        return {key: builder.load(address, align=8, typ=kind) for key, address in zip(labels, places, strict=True)}

    if steady:
        with _build_loop(builder, lanes, width) as lane:
            values = write.write_lines(lines, load(parameters, lane, constants, lanes), steady)
            for k, line in enumerate(steady, len(constants)):
                builder.store(write.number(values[line]), place(parameters, lane, WHOLE(k), lanes), align=8)
    with _build_loop(builder, steps) as step:
        first = builder.mul(builder.mul(builder.sdiv(step, repeats), WHOLE(len(inputs))), row)
        with _build_loop(builder, lanes, width) as lane:
            variables = load(wrapped, builder.add(first, builder.srem(lane, cycle)), inputs, row)
            variables |= load(parameters, lane, shared, lanes) | load(current, lane, states, lanes)
            values = write.write_lines(lines, variables, [line for line, _ in results if line is not None])
            for k, (result, number) in enumerate(results):
                value = kind(number) if result is None else write.number(values[result])
                builder.store(value, place(current, lane, WHOLE(k), lanes), align=8)
        next_step = builder.add(step, WHOLE(1))
        with builder.if_then(builder.icmp_signed("==", builder.srem(next_step, every), WHOLE(0))):
            begin = builder.mul(builder.mul(builder.sdiv(next_step, every), count), lanes)
            copy = module.declare_intrinsic("llvm.memcpy", [POINTER, POINTER, WHOLE])
            with _build_loop(builder, count) as k:
                number = builder.load(builder.gep(returned, [k], source_etype=WHOLE), align=8, typ=WHOLE)
                ends = place(path, begin, k, lanes), place(current, WHOLE(0), number, lanes)
                builder.call(copy, [*ends, size, ir.IntType(1)(0)])
    builder.ret_void()
    return module


@contextmanager
def _build_loop(builder: ir.IRBuilder, count: Any, stride: int = 1) -> Iterator[Any]:
    """Yield the index of a loop from 0 to `count` by a stride."""
    before = builder.block
    inner, after = builder.append_basic_block(), builder.append_basic_block()
    builder.cbranch(builder.icmp_signed(">", count, WHOLE(0)), inner, after)
    builder.position_at_end(inner)
    index = builder.phi(WHOLE)
    index.add_incoming(WHOLE(0), before)
    yield index
    following = builder.add(index, WHOLE(stride))
    index.add_incoming(following, builder.block)
    builder.cbranch(builder.icmp_signed("<", following, count), inner, after)
    builder.position_at_end(after)


@dataclass(frozen=True)
class _Instructions:
    """Writer of instructions for expressions; `kind` is the type of values, a number or a vector."""

    module: ir.Module
    builder: ir.IRBuilder
    kind: Any

    def write_lines(self, lines: Sequence[Line], given: Mapping[Any, Any], results: Sequence[int]) -> dict[int, Any]:
        """Write the lines of results and their inputs; `given` has known values by name or by number of a line."""
        values: dict[int, Any] = {}
        required = set(results)
        for k in range(len(lines) - 1, -1, -1):
            if k in required and k not in given:
                required |= {line for line, _ in lines[k][2:] if line is not None}
        for k in sorted(required):
            op, label, *operands = lines[k]
            if op == symbols.NAME:
                values[k] = given[label]
            elif k in given:
                values[k] = given[k]
            else:
                inputs = [self.kind(x) if line is None else values[line] for line, x in operands]
                values[k] = self._write_line(op, inputs)
        return values

    def _write_line(self, op: str, inputs: list[Any]) -> Any:
        write = self.builder
        if op in symbols.LOGICAL:
            return {"logical_and": write.and_, "logical_or": write.or_}[op](*map(self._truth, inputs))
        if op == symbols.WHERE:
            return write.select(self._truth(inputs[0]), self.number(inputs[1]), self.number(inputs[2]))
        numbers = [self.number(x) for x in inputs]
        if op in symbols.COMPARISONS:
            compare = write.fcmp_unordered if op == "not_equal" else write.fcmp_ordered
            return compare(SIGNS[op], *numbers)
        if op in ARITHMETIC:
            return getattr(write, ARITHMETIC[op])(*numbers)
        if op == "negative":
            return write.fneg(*numbers)
        if op in ("sin", "cos"):
            return self._write_sine(numbers[0], 0.0 if op == "sin" else 0.5)
        if op == "sign":
            zero, one, minus = map(self.kind, (0.0, 1.0, -1.0))
            up, down = (write.fcmp_ordered(sign, numbers[0], zero) for sign in "><")
            return write.select(up, one, write.select(down, minus, zero))
        return self._write_call(CALLS[op], *numbers)

    def _write_sine(self, x: Any, shift: float) -> Any:
        """Return sin(x + shift pi) by its series about the nearest multiple of pi."""
        write, value_type = self.builder, self.kind
        turns = self._write_call("rint", self._write_call("fmuladd", x, value_type(1 / math.pi), value_type(shift)))
        remainder = x
        for part in PI:
            remainder = self._write_call("fmuladd", write.fsub(turns, value_type(shift)), value_type(-part), remainder)
        square, series = write.fmul(remainder, remainder), value_type(ODD[-1])
        for factor in reversed(ODD[:-1]):
            series = self._write_call("fmuladd", series, square, value_type(factor))
        half = write.fmul(turns, value_type(0.5))
        is_odd = write.fcmp_ordered("!=", half, self._write_call("rint", half))
        value = write.fmul(remainder, series)
        for sign, limit in (("<", -1.0), (">", 1.0)):  # above 1e8, arguments lose the digits of a turn
            value = write.select(write.fcmp_ordered(sign, value, value_type(limit)), value_type(limit), value)
        return write.select(is_odd, write.fneg(value), value)

    def _write_call(self, name: str, *inputs: Any) -> Any:
        """Write the call of an LLVM function."""
        full = f"llvm.{name}.{'f64' if self.kind == DOUBLE else f'v{self.kind.count}f64'}"
        function = ir.FunctionType(self.kind, [x.type for x in inputs])
        return self.builder.call(self.module.globals.get(full) or ir.Function(self.module, function, full), inputs)

    def number(self, value: Any) -> Any:
        """Convert a truth value to a number."""
        is_number = value.type == self.kind
        return value if is_number else self.builder.select(value, self.kind(1.0), self.kind(0.0))

    def _truth(self, value: Any) -> Any:
        is_number = value.type == self.kind
        return self.builder.fcmp_unordered("!=", value, self.kind(0.0)) if is_number else value
