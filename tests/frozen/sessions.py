"""What must not change when the house is tidied: answers, designs, sessions and wires, as numbers.

`python tests/frozen/sessions.py` writes `frozen.json` anew; do so only where behaviour is meant to
change, and say in the commit what changed and why.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import plants
from mcap.reader import make_reader

import hil
from hil import cli
from hil.models.kernels import dahl_state

FILE = Path(__file__).with_name("frozen.json")
Law = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def _dahl(t, q, v, a):
    return 0.2 * dahl_state(np.ascontiguousarray(q), 0.08) - 0.2 * np.tanh(v / 0.02)


#: Extra effort of an axis by name; the last ones are in no catalogue.
LAWS: dict[str, Law] = {
    "nothing": lambda t, q, v, a: 0.0 * t,
    "stribeck": lambda t, q, v, a: 0.15 * np.exp(-((v / 0.4) ** 2)) * np.tanh(v / 0.02),
    "spring": lambda t, q, v, a: 0.12 * q,
    "hardening": lambda t, q, v, a: 0.1 * q**3,
    "asymmetric": lambda t, q, v, a: 0.15 * np.abs(v),
    "drag": lambda t, q, v, a: 0.05 * v * np.abs(v),
    "cogging": lambda t, q, v, a: 0.05 * np.sin(24 * q),
    "ripple": lambda t, q, v, a: 0.05 * np.sin(6 * q + 0.4),
    "presliding": _dahl,
    "rubbing": lambda t, q, v, a: 0.15 * q * np.tanh(v / 0.02),
    "stop": lambda t, q, v, a: 4.0 * np.maximum(q - 0.5, 0.0),
    "drift": lambda t, q, v, a: 0.002 * t * np.tanh(v / 0.02),
    "two": lambda t, q, v, a: 0.12 * q + 0.15 * np.abs(v),
    "three": lambda t, q, v, a: 0.12 * q + 0.15 * np.abs(v) + 0.05 * np.sin(24 * q),
    "hum": lambda t, q, v, a: 0.1 * np.sin(2 * np.pi * 7.3 * t),
    "gust": lambda t, q, v, a: 0.2 * np.sin(0.3 * t**1.5),
    "latch": lambda t, q, v, a: 0.1 * np.exp(-(((q - 0.2) / 0.05) ** 2)),
    "step": lambda t, q, v, a: 0.2 * (t > 14.0),
    "mixed": lambda t, q, v, a: 0.1 * q * v,
    "square": lambda t, q, v, a: 0.1 * a * np.abs(q),
}
DESIGNS = (
    "position-error",
    "position-force",
    "four-channel",
    "three-channel-1",
    "three-channel-3",
    "motion-forward",
    "force-forward",
)
RUNS = {
    "teleop": ("teleop",),
    "identify": ("identify",),
    "lawrence": ("lawrence",),
    "mechanical-operator": ("mechanical-operator",),
    "wire": ("wire.toml",),
}


def diagnosis(law: str, folder: Path) -> dict[str, Any]:
    """What `hil diagnose` says of an axis with an extra effort."""
    run = plants.smooth_axis(2, seconds=20.0, rate=250.0, extra=LAWS[law])
    table = np.column_stack([run.t, run.q, run.tau])
    with chdir(folder):
        np.savetxt(f"{law}.csv", table, delimiter=",", header="t,q1,tau1", comments="")
        said(["import", f"{law}.csv", "-o", f"{law}.mcap"])
        words = ["diagnose", f"{law}.mcap", "--model", f"{law}.model.toml", "--json"]
        out = json.loads(said(words))
    kept = ("verdict", "findings", "remaining", "corrections", "could_not_show", "ladder")
    found = {k: without_words(out[k]) for k in kept}
    found["sets"] = [p["effects"] for p in out["indistinguishable"]]
    found["ranking"] = [[c["effect"], c["joint"], c["relative_after"]] for c in out["candidates"]]
    return found


def without_words(x: Any) -> Any:
    """JSON without its sentences: names and numbers."""
    if isinstance(x, dict):
        return {k: without_words(v) for k, v in x.items()}
    if isinstance(x, list):
        return [without_words(v) for v in x if not (isinstance(v, str) and " " in v)]
    return x if not isinstance(x, str) or " " not in x or x.startswith("+") else ""


def design(name: str) -> dict[str, Any]:
    """What `hil design` says of a named design."""
    return without_words(json.loads(said(["design", "lawrence", "--design", name, "--json"])))


def session(name: str, folder: Path) -> dict[str, Any]:
    """Of a lockstep session: messages by topic, and what each arm measured and was told, as rms."""
    with chdir(folder):
        if name == "wire":
            said(["init", "teleop", "-o", "wire.toml"])
            text = Path("wire.toml").read_text("utf-8")
            Path("wire.toml").write_text(text.replace('"sim"', '"sim-wire"', 1), "utf-8")
        output = f"{name}.s.mcap"
        words = ["run", *RUNS[name], "--clock", "lockstep", "--seconds", "0.6", "--seed", "3"]
        said([*words, "-o", output])
        with Path(output).open("rb") as file:
            topics = [c.topic for _, c, _ in make_reader(file).iter_messages()]
        found: dict[str, Any] = {t: topics.count(t) for t in sorted(set(topics))}
        for arm in sorted({t.split("/")[1] for t in topics if t.endswith("measured_js")}):
            run = hil.load(output, arm)
            for what in ("q", "qd", "tau", "wrench"):
                values = getattr(run, what, None)
                if values is not None:
                    found[f"{arm}.{what}"] = np.sqrt(np.mean(np.square(values), axis=0)).tolist()
    return found


def said(words: list[str]) -> str:
    """Stdout of a command; a refused design is an answer, too."""
    out = io.StringIO()
    with redirect_stdout(out), redirect_stderr(io.StringIO()):
        code = cli.main(words)
    assert code in (0, 2, 3), (words, code, out.getvalue())
    return out.getvalue()


def rounded(x: Any) -> Any:
    """Numbers to five digits: what is compared, and what is kept."""
    if isinstance(x, dict):
        return {k: rounded(v) for k, v in x.items()}
    if isinstance(x, list):
        return [rounded(v) for v in x]
    return float(f"{x:.5g}") if isinstance(x, float) else x


def everything(folder: Path) -> dict[str, Any]:
    """All that is frozen."""
    return rounded(
        {
            "diagnoses": {law: diagnosis(law, folder) for law in LAWS},
            "designs": {name: design(name) for name in DESIGNS},
            "sessions": {name: session(name, folder) for name in RUNS},
        }
    )


if __name__ == "__main__":
    with TemporaryDirectory() as place:
        FILE.write_text(json.dumps(everything(Path(place)), indent=0) + "\n", "utf-8")
