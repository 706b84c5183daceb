"""Feed-forward as source text: C, C++ and Python without dependencies, and parameters for ROS 2.

Every one computes the motor effort of a desired motion,

    tau = A' RNEA(A q + b, A v, A a) + friction, ripple and all other columns,

with tables of the same numbers.  Gravity alone is the call at rest without friction.  What was
written is run at given states, with this machine's compiler: efforts and cost.

Source of the recursion: Featherstone, Rigid Body Dynamics Algorithms, 2008, 5.3.
"""

from __future__ import annotations

import json
import keyword
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, printable
from hil.export.content import Content, Vocabulary
from hil.export.target import Program
from hil.models.formula import FUNCTIONS, STATE, Syntax, number, states

FloatArray = NDArray[np.float64]
#: Calls over which the cost is averaged, compiled and interpreted; seconds a compiler may take.
COMPILED, INTERPRETED, PATIENCE = 200_000, 300, 120
_MAIN = """
#include "{file}"
#include <stdio.h>
#include <time.h>
int main(void)
{{
    {vector} q, v, a, tau;
    struct timespec from, to;
    double sum = 0.0;
    int k;
    while (1) {{
        for (k = 0; k < {d}; ++k) if (scanf("%lf", &q[k]) != 1) goto timing;
        for (k = 0; k < {d}; ++k) if (scanf("%lf", &v[k]) != 1) return 1;
        for (k = 0; k < {d}; ++k) if (scanf("%lf", &a[k]) != 1) return 1;
        {call};
        for (k = 0; k < {d}; ++k) printf("%.17g ", tau[k]);
        {gravity};
        for (k = 0; k < {d}; ++k) printf("%.17g ", tau[k]);
    }}
timing:
    clock_gettime(CLOCK_MONOTONIC, &from);
    for (k = 0; k < {calls}; ++k) {{ q[0] = 1e-6 * k; {call}; sum += tau[0]; }}
    clock_gettime(CLOCK_MONOTONIC, &to);
    printf("%.17g %.17g", sum, ((to.tv_sec - from.tv_sec) + 1e-9 * (to.tv_nsec - from.tv_nsec)));
    return 0;
}}
"""


@dataclass(frozen=True)
class Run:
    """What came of it.

    Parameters
    ----------
    efforts, gravity : ndarray (n, d)
        At the states; empty where there is no compiler.
    cost : str
        Of one call, or why it is unknown.
    """

    efforts: FloatArray
    gravity: FloatArray
    cost: str


def run_c(text: str, states: FloatArray) -> Run:
    """Compile a C header and run it at states (n, 3, d) of q, v, a."""
    (name,) = re.findall(r"^static inline void (\w+)_feedforward\(", text, re.M)
    calls = f"{name}_feedforward(q, v, a, tau)", f"{name}_gravity(q, tau)"
    d = states.shape[2]
    vector = f"typedef double hil_vector[{d}]; hil_vector"
    return _compiled(("cc", "gcc", "clang"), ["-std=gnu99"], text, ".c", vector, calls, states)


def run_cpp(text: str, states: FloatArray) -> Run:
    """Compile a C++ header and run it; the rest as of `run_c`."""
    (name,) = re.findall(r"^namespace (\w+) \{\n\nnamespace detail", text, re.M)
    calls = f"tau = {name}::feedforward(q, v, a)", f"tau = {name}::gravity(q)"
    options, vector = ["-std=c++14"], f"{name}::Vector"
    return _compiled(("c++", "g++", "clang++"), options, text, ".cpp", vector, calls, states)


def _compiled(
    compilers: tuple[str, ...],
    options: list[str],
    text: str,
    ending: str,
    vector: str,
    calls: tuple[str, str],
    states: FloatArray,
) -> Run:
    n, _, d = states.shape
    found = next((x for x in compilers if shutil.which(x)), None)
    if found is None:
        none = np.zeros((0, d))
        return Run(
            none, none, f"cost of a call: unknown, no compiler here ({', '.join(compilers)})"
        )
    program = _MAIN.format(
        file="model.h", vector=vector, d=d, call=calls[0], gravity=calls[1], calls=COMPILED
    )
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "model.h").write_text(text, encoding="utf-8")
        (place / f"main{ending}").write_text(program, encoding="utf-8")
        command = [found, *options, "-O2", "-Wall", "-Werror", f"main{ending}", "-o", "main", "-lm"]
        _done(subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=PATIENCE))
        rows = " ".join(repr(float(x)) for x in states.reshape(-1))
        ran = subprocess.run(
            [str(place / "main")], input=rows, capture_output=True, text=True, timeout=PATIENCE
        )
        _done(ran)
    values = np.array(ran.stdout.split(), dtype=np.float64)
    both = values[:-2].reshape(n, 2, d)
    each = 1e9 * values[-1] / COMPILED
    return Run(both[:, 0], both[:, 1], f"cost of a call: {each:.0f} ns ({found} -O2, this machine)")


def _done(ran: subprocess.CompletedProcess[str]) -> None:
    if ran.returncode:
        raise ConfigError(
            f"the written program fails with exit code {ran.returncode}: {ran.stderr.strip()[:400]}"
        )


def run_python(text: str, states: FloatArray) -> Run:
    """Run a Python module; the rest as of `run_c`."""
    module: dict[str, Any] = {}
    exec(compile(text, "feedforward.py", "exec"), module)
    at = [[list(map(float, x)) for x in state] for state in states]
    efforts = np.array([module["feedforward"](*x) for x in at])
    gravity = np.array([module["gravity"](x[0]) for x in at])
    start = time.perf_counter()
    for _ in range(INTERPRETED):
        module["feedforward"](*at[0])
    each = 1e6 * (time.perf_counter() - start) / INTERPRETED
    return Run(efforts, gravity, f"cost of a call: {each:.0f} us (this interpreter, this machine)")


_C = Syntax(
    {name: name for name in FUNCTIONS} | {"abs": "fabs", "max": "fmax", "min": "fmin"},
    "pow({0}, {1})",
)
_PYTHON = Syntax(
    {name: name if name in ("abs", "max", "min") else f"math.{name}" for name in FUNCTIONS},
    "(({0}) ** ({1}))",
)
#: Words of C and C++ that are likely names of a file.
_WORDS = ("std", "class", "double", "float", "int", "main", "struct", "static", "new", "private")
_EVERYTHING = Vocabulary(columns=None)


def identifier(name: str) -> str:
    """A name that every language takes; not one word alone that may be a language's own."""
    out = re.sub(r"\W", "_", name, flags=re.ASCII)
    own = out[:1].isalpha() and not (out in _WORDS or keyword.iskeyword(out))
    return out if own else f"model_{out}"


def comment(text: str) -> str:
    """Text that no comment of C, C++ or Python ends in, whatever name a user's file gave.

    What is written here is compiled and run to measure its cost, so a name must not become code.
    """
    return re.sub(r"[^\w .,:;()\[\]{}<>=+%^|'\"-]", "_", " ".join(printable(text).split()))


def _tables(content: Content) -> dict[str, NDArray[Any]]:
    """Numbers of the bodies by name; none of a robot without bodies."""
    tree, bodies = content.robot.tree, content.bodies
    if tree is None or bodies is None:
        return {}
    return {
        "parent": tree.parent,
        "turn": tree.turn,
        "place": tree.place,
        "axis": tree.axis,
        "body": bodies,
        "gravity_vector": tree.gravity,
        "follow": tree.follow,
        "shift": tree.shift,
    }


def _statements(content: Content, line: str, syntax: Syntax, mark: str) -> list[str]:
    """One line a column, its effect as a comment."""
    out = []
    every = states(len(content.robot.joints), "q[{}]".format, "v[{}]".format, "a[{}]".format)
    for c in content.columns:
        state = {"q": f"q[{c.joint}]", "v": f"v[{c.joint}]", "a": f"a[{c.joint}]", **every}
        state |= {"qk": f"q[{c.other}]", "vk": f"v[{c.other}]"}
        term = c.written(state, syntax)
        out.append(f"{line.format(c.joint, term)}  {mark} {comment(c.effect)}")
    return out


# ------------------------------------------------------------ C and C++


def _braces(x: NDArray[Any]) -> str:
    """Nested initialiser of an array."""
    if x.ndim == 0:
        return str(int(x)) if x.dtype.kind == "i" else number(float(x)).strip("()")
    return "{" + ", ".join(_braces(part) for part in x) + "}"


def _c_tables(content: Content, prefix: str, storage: str) -> list[str]:
    out = []
    for name, x in _tables(content).items():
        size = "".join(f"[{n}]" for n in x.shape)
        kind = "int" if x.dtype.kind == "i" else "double"
        out.append(f"{storage} {kind} {prefix}{name}{size} = {_braces(x)};")
    return out


def _template(name: str) -> str:
    return (files("hil.export") / "templates" / name).read_text(encoding="utf-8")


def _filled(template: str, **parts: str) -> str:
    out = _template(template)
    for key, value in parts.items():
        out = out.replace(f"@{key}@", value)
    return out


def _c_family(content: Content, name: str, head: Sequence[str], cpp: bool) -> str:
    name = identifier(name)
    tables = _c_tables(content, f"{name}_", "static const")
    joints = ", ".join(comment(j) for j in content.robot.joints)
    tree = content.robot.tree
    bodies = _filled("bodies.h.txt", NAME=name) if tables else ""
    said = "\n".join(f" * {comment(x)}" for x in head)
    return _filled(
        "feedforward.hpp.txt" if cpp else "feedforward.h.txt",
        BODIES=bodies,
        HEAD=said,
        TABLES="\n".join(tables),
        MOVED=f"    {name}_bodies(q, v, a, tau);" if tables else "",
        GRAVITY=f"    {name}_bodies(q, still, still, tau);" if tables else "",
        COLUMNS="\n".join(_statements(content, "    tau[{0}] += {1};", _C, "//")),
        GUARD=f"{name.upper()}_FEEDFORWARD_H",
        BODY_COUNT=str(0 if tree is None else len(tree.joints)),
        COUNT=str(len(content.robot.joints)),
        JOINTS=joints,
        NAME=name,
    )


def _write_c(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
    return {".h": _c_family(content, name, head, cpp=False)}


def _write_cpp(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
    return {".hpp": _c_family(content, name, head, cpp=True)}


# ------------------------------------------------------------ Python and ROS 2


def _write_python(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
    tables = _tables(content)
    lines = [f"{key.upper()} = {x.tolist()!r}" for key, x in tables.items()]
    text = _filled(
        "feedforward.py.txt",
        HEAD=json.dumps("\n".join(head)),
        JOINTS=repr(tuple(content.robot.joints)),
        TABLES="\n".join(lines),
        BODIES=_template("bodies.py.txt") if tables else "",
        COLUMNS="\n".join(_statements(content, "    tau[{0}] += {1}", _PYTHON, "#")),
        START="_bodies(q, v, a)" if tables else "[0.0] * len(JOINTS)",
        GRAVITY="_bodies(q, still, still)" if tables else "still",
    )
    return {".py": text}


def _write_ros2(content: Content, name: str, head: tuple[str, ...]) -> dict[str, str]:
    said = "q, v, a: state of a column's own joint; qk, vk: of its joint under other_joints"
    told = (*head, f"{said}; q1, v1, a1: of the first joint; ...")
    lines = [*(f"# {x}" for x in told), "/**:", "  ros__parameters:"]
    lines.append(f"    joints: {json.dumps(list(content.robot.joints))}")
    if tables := _tables(content):
        lines.append("    bodies:")
        lines += [f"      {key}: {x.reshape(-1).tolist()!r}" for key, x in tables.items()]
    lines.append("    columns:")
    every = states(len(content.robot.joints), str, str, str)
    for j, joint in enumerate(content.robot.joints):
        own = [c for c in content.columns if c.joint == j]
        others = {c.other for c in own} - {-1}
        state = {x: x for x in STATE} | {x: x for x in every}
        lines.append(f"      {json.dumps(joint)}:")
        # an empty list has no type there, so what a joint lacks is left out
        if own:
            lines += [
                f"        effects: {json.dumps([c.effect for c in own])}",
                f"        values: {[float(c.value) for c in own]!r}",
                f"        formulas: {json.dumps([_plain(c.written(state)) for c in own])}",
            ]
        if others:
            other = [content.robot.joints[c.other] if c.other >= 0 else joint for c in own]
            lines.append(f"        other_joints: {json.dumps(other)}")
    return {".yaml": "\n".join(lines) + "\n"}


def _plain(term: str) -> str:
    """The column of a term: what stands behind its value."""
    return term.partition(" * ")[2]


def _measured(run: Callable[..., Run]) -> Callable[[str, Content], str]:
    """Cost of one call in words."""

    def cost(text: str, content: Content) -> str:
        return run(text, np.zeros((1, 3, len(content.robot.joints)))).cost

    return cost


C = Program("feed-forward as a C header", ".h", _EVERYTHING, _write_c, _measured(run_c))
CPP = Program("feed-forward as a C++ header", ".hpp", _EVERYTHING, _write_cpp, _measured(run_cpp))
PYTHON = Program(
    "feed-forward as a Python module", ".py", _EVERYTHING, _write_python, _measured(run_python)
)
ROS2 = Program("feed-forward as ROS 2 parameters", ".yaml", _EVERYTHING, _write_ros2)
