"""Columns of an effect as text: what other programs can take over, each as far as it can.

A formula is one expression in the state of a joint,

    q, v, a           position, speed, acceleration
    sign, v0          tanh(v / v0), and the speed over which that is resolved
    qk, vk, v0k       place, speed and resolution of the other joint, where the shape names one
    q1, v1, a1, ...   position, speed and acceleration of the joint of that number
    low, high         ends of the recorded span
    pi                and the effect's own shape values, by name

with + - * / **, numbers, and the functions of `FUNCTIONS`.  What depends on more (the load, time,
the past) has no formula.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

FloatArray = NDArray[np.float64]
Operand = TypeVar("Operand")
#: Functions by name.
FUNCTIONS: dict[str, Callable[..., FloatArray]] = {
    "sin": np.sin,
    "cos": np.cos,
    "exp": np.exp,
    "abs": np.abs,
    "tanh": np.tanh,
    "max": np.maximum,
    "min": np.minimum,
}
#: What changes from instant to instant; every other name is a number of the model.
STATE = ("q", "v", "a", "qk", "vk")
_NUMBERED = re.compile(r"[qva][1-9][0-9]*")
_SIGN = "tanh(v / v0)"
_OPERATORS: dict[type[ast.operator], tuple[str, Callable[[FloatArray, FloatArray], FloatArray]]] = {
    ast.Add: ("+", np.add),
    ast.Sub: ("-", np.subtract),
    ast.Mult: ("*", np.multiply),
    ast.Div: ("/", np.divide),
    ast.Pow: ("**", np.power),
}


@lru_cache(maxsize=1024)
def parsed(text: str) -> ast.expr:
    """Expression of a formula, `sign` written out.

    Raises
    ------
    ConfigError
        If it is no expression, or holds what is not listed at the head of this file.
    """
    try:
        tree = ast.parse(text, mode="eval")
    except SyntaxError as error:
        raise ConfigError(f"formula {text!r} is no expression: {error.msg}") from error
    _Signs().visit(tree)
    for node in ast.walk(tree.body):
        if not _known(node):
            held = ast.unparse(node) if isinstance(node, ast.expr) else type(node).__name__
            raise ConfigError(
                f"formula {text!r} holds {held}; a formula has names, numbers, + - * / ** and "
                f"{', '.join(FUNCTIONS)}"
            )
    return tree.body


class _Signs(ast.NodeTransformer):
    """Puts the expression in place of its short name."""

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.parse(_SIGN, mode="eval").body if node.id == "sign" else node


def _known(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        called = isinstance(node.func, ast.Name) and node.func.id in FUNCTIONS
        return called and not node.keywords
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.operator):
        return type(node) in _OPERATORS
    return isinstance(node, ast.Name | ast.Load | ast.BinOp | ast.UnaryOp | ast.USub)


def names(text: str) -> set[str]:
    """Names of a formula but for functions and pi."""
    found = {n.id for n in ast.walk(parsed(text)) if isinstance(n, ast.Name)}
    return found - set(FUNCTIONS) - {"pi"}


def numbers(text: str) -> set[str]:
    """Names of a formula that are numbers of the model: all but those of a joint's state."""
    return {x for x in names(text) - set(STATE) if not _NUMBERED.fullmatch(x)}


def states(
    joints: int,
    q: Callable[[int], Operand],
    v: Callable[[int], Operand],
    a: Callable[[int], Operand],
) -> dict[str, Operand]:
    """Names ``q1``, ``v1``, ``a1``, ... of all joints, by what `q`, `v`, `a` make of a number.

    Joints are counted from 0 on there.
    """
    forms = {"q": q, "v": v, "a": a}
    return {f"{x}{j + 1}": form(j) for x, form in forms.items() for j in range(joints)}


def evaluate(text: str, values: Mapping[str, FloatArray | float]) -> FloatArray:
    """Value of a formula, of the shape of its names' values.

    Raises
    ------
    ConfigError
        If a name has no value.
    """
    return evaluated((text,), values)[0]


def evaluated(texts: Sequence[str], values: Mapping[str, FloatArray | float]) -> list[FloatArray]:
    """Values of several formulas; what they have in common is computed once.

    Raises
    ------
    ConfigError
        If a name has no value.
    """
    plan = _planned(tuple(texts))
    for text, needed in zip(texts, plan.names, strict=True):
        if not needed <= values.keys():
            lacking = ", ".join(sorted(needed - values.keys()))
            raise ConfigError(f"formula {text!r}: no value of {lacking}")
    found: list[FloatArray] = []
    for step in plan.steps:
        if step.form is None:
            value = values[step.source] if isinstance(step.source, str) else step.source
            found.append(np.asarray(value, dtype=np.float64))
        else:
            found.append(step.form(*(found[k] for k in step.args)))
    return [found[k] for k in plan.ends]


@dataclass(frozen=True)
class _Step:
    """A function of earlier steps, or a name or number where `form` is None."""

    form: Callable[..., FloatArray] | None
    args: tuple[int, ...] = ()
    source: str | float = 0.0


@dataclass(frozen=True)
class _Plan:
    """Steps of some formulas in order, their last ones, and the names that each needs."""

    steps: tuple[_Step, ...]
    ends: tuple[int, ...]
    names: tuple[frozenset[str], ...]


@lru_cache(maxsize=1024)
def _planned(texts: tuple[str, ...]) -> _Plan:
    steps: dict[_Step, int] = {}
    ends = tuple(_step(parsed(text), steps) for text in texts)
    return _Plan(tuple(steps), ends, tuple(frozenset(names(text)) for text in texts))


def _step(node: ast.expr, steps: dict[_Step, int]) -> int:
    """Number of the step that computes a node; it and those before it are put into `steps`."""
    if isinstance(node, ast.Constant):
        step = _Step(None, source=float(str(node.value)))
    elif isinstance(node, ast.Name):
        step = _Step(None, source=math.pi if node.id == "pi" else node.id)
    elif isinstance(node, ast.UnaryOp):
        step = _Step(np.negative, (_step(node.operand, steps),))
    elif isinstance(node, ast.BinOp):
        args = _step(node.left, steps), _step(node.right, steps)
        step = _Step(_OPERATORS[type(node.op)][1], args)
    else:
        name, arguments = _call(node)
        step = _Step(FUNCTIONS[name], tuple(_step(x, steps) for x in arguments))
    return steps.setdefault(step, len(steps))


def _call(node: ast.expr) -> tuple[str, list[ast.expr]]:
    """Function and arguments of a call that `parsed` has let pass."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return node.func.id, node.args
    raise ConfigError(f"{ast.unparse(node)!r} is no call of a function")


@dataclass(frozen=True)
class Syntax:
    """How a language writes a formula.

    Parameters
    ----------
    functions : mapping of str to str
        Its names of `FUNCTIONS`.
    power : str
        How it writes a power, e.g. ``"pow({0}, {1})"``.
    """

    functions: Mapping[str, str]
    power: str


PLAIN = Syntax({name: name for name in FUNCTIONS}, "({0} ** {1})")


def written(
    text: str, known: Mapping[str, float], state: Mapping[str, str], syntax: Syntax = PLAIN
) -> str:
    """A formula in some language, numbers in place of all names that are no state.

    Parameters
    ----------
    text : str
        The formula.
    known : mapping of str to float
        Values of the names that are numbers of the model.
    state : mapping of str to str
        What the language calls those of `STATE`.
    syntax : Syntax
        The language.

    Raises
    ------
    ConfigError
        If a name is in neither.
    """
    lacking = names(text) - set(known) - set(state)
    if lacking:
        raise ConfigError(f"formula {text!r}: no value of {', '.join(sorted(lacking))}")
    return _text(parsed(text), {"pi": math.pi, **known}, state, syntax)


def _text(
    node: ast.expr, known: Mapping[str, float], state: Mapping[str, str], syntax: Syntax
) -> str:
    if isinstance(node, ast.Constant):
        return number(float(str(node.value)))
    if isinstance(node, ast.Name):
        return state[node.id] if node.id in state else number(known[node.id])
    if isinstance(node, ast.UnaryOp):
        return f"(-{_text(node.operand, known, state, syntax)})"
    if isinstance(node, ast.BinOp):
        left, right = (_text(x, known, state, syntax) for x in (node.left, node.right))
        if isinstance(node.op, ast.Pow):
            return syntax.power.format(left, right)
        return f"({left} {_OPERATORS[type(node.op)][0]} {right})"
    name, args = _call(node)
    return f"{syntax.functions[name]}({', '.join(_text(x, known, state, syntax) for x in args)})"


def number(x: float) -> str:
    """A finite number with all its digits; below zero in brackets.

    Raises
    ------
    ConfigError
        If it is not finite.
    """
    if not math.isfinite(x):
        raise ConfigError(f"a value of the model is {x}; fit it anew, a program needs a number")
    return f"({float(x)!r})" if x < 0 or str(float(x))[0] == "-" else repr(float(x))
