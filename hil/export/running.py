"""Runs a written feed-forward at given states, with this machine's compiler: efforts and cost."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

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


def c(text: str, states: FloatArray) -> Run:
    """Compile a C header and run it at states (n, 3, d) of q, v, a."""
    (name,) = re.findall(r"^static void (\w+)_feedforward\(", text, re.M)
    calls = f"{name}_feedforward(q, v, a, tau)", f"{name}_gravity(q, tau)"
    d = states.shape[2]
    vector = f"typedef double hil_vector[{d}]; hil_vector"
    return _compiled(("cc", "gcc", "clang"), ["-std=gnu99"], text, ".c", vector, calls, states)


def cpp(text: str, states: FloatArray) -> Run:
    """Compile a C++ header and run it; the rest as of `c`."""
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


def python(text: str, states: FloatArray) -> Run:
    """Run a Python module; the rest as of `c`."""
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
