"""All that the studio does for a page: files that come in, own effects, and the bench.

It may begin with nothing: then the first session is brought in through the page.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hil.errors import ConfigError
from hil.models.model import base_model
from hil.record.recording import Recording
from hil.record.sources import find, load_sources
from hil.record.table_files import FORMATS
from hil.studio import intake, own
from hil.studio import workbench as bench_verbs
from hil.studio.workbench import Inputs, StudioRung, Workbench

#: What the page may ask for, and the names of its arguments.
VERBS = {
    **bench_verbs.VERBS,
    "open": ("path", "use"),
    "preview": ("picks",),
    "bring": ("picks", "output", "use"),
    "leave": (),
    "learn": ("path", "text", "agreed"),
}
#: What a session is brought in for.
USES = ("fit", "holdout", "new")


class StudioSession:
    """The bench, where there is one, and the table whose columns are being picked.

    Parameters
    ----------
    inputs : Inputs or None
        Sessions and first model; none: they come through the page.
    stack : list of StudioRung
        Models of an earlier process.
    at, table, written
        Current model, table being picked, files of effects that this studio wrote.
    """

    def __init__(
        self,
        inputs: Inputs | None = None,
        stack: list[StudioRung] | None = None,
        at: int = 0,
        table: str = "",
        written: tuple[str, ...] = (),
        effects: tuple[str, ...] = (),
    ) -> None:
        self.table, self.written = table, written
        #: See `Workbench`.
        self.early: Callable[[list[dict[str, Any]]], None] = lambda rows: None
        models = [r.model for r in stack or ()] or ([inputs.model] if inputs else [])
        own.again({p for m in models for p in m.plugins} | set(written))
        self.bench = Workbench(inputs, stack or [], at) if inputs else None
        self.effects = effects
        if self.bench is not None:
            self.bench.own = list(effects)

    def ask(self, verb: str, given: dict[str, str]) -> dict[str, Any]:
        """Answer a request that `checked` let through."""
        if verb in bench_verbs.VERBS:
            return self._of_bench(verb, given)
        answer: dict[str, Any] = getattr(self, verb)(**given)
        return answer

    def _of_bench(self, verb: str, given: dict[str, str]) -> dict[str, Any]:
        if self.bench is None:
            if verb == "start":
                return self.open(self.table, "new") if self.table else {"intake": None}
            raise ConfigError("there is no session yet; drop a file on the page first")
        self.bench.early = self.early
        found: dict[str, Any] = getattr(self.bench, verb)(**given)
        return found

    # ------------------------------------------------------------ files

    def open(self, path: str, use: str) -> dict[str, Any]:
        """Columns of a table to pick from, or a session or bag as it is."""
        if Path(path).suffix.lower() in FORMATS:
            shown = intake.shown(Path(path))
            self.table = path
            return {"intake": shown | {"preview": None}}
        found = find([path])
        runs, _ = load_sources(found, [], None, None)
        return self._with(runs, [str(p) for p in found], use, "")

    def preview(self, picks: str) -> dict[str, Any]:
        """What would be read of the table with these picks, and what is wrong with it."""
        read = intake.read(self._open_table(), intake.Picked.parse(picks))
        return {"preview": intake.told(read)}

    def bring(self, picks: str, output: str, use: str) -> dict[str, Any]:
        """Write the session and go on with it."""
        picked, table = intake.Picked.parse(picks), self._open_table()
        read = intake.read(table, picked)
        bad = [f["text"] for f in intake.told(read)["faults"] if f["severity"] == "error"]
        if bad:
            raise ConfigError(f"the recording cannot be fitted: {bad[0]}")
        self._fits(read.recordings[0], use)
        run, command = intake.write(read, picked, table, Path(output))
        return self._with([run], [output], use, command)

    def leave(self) -> dict[str, Any]:
        """Leave the table without bringing it in."""
        self.table = ""
        return {"intake": None}

    def _open_table(self) -> Path:
        if not self.table:
            raise ConfigError("no table is open; drop one on the page first")
        return Path(self.table)

    def _fits(self, run: Recording, use: str) -> None:
        """Refuse a session of another robot, and a use that is none."""
        if use not in USES:
            raise ConfigError(f"a session is brought in for {', '.join(USES)}; got {use!r}")
        if self.bench is None:
            if use == "holdout":
                raise ConfigError("there is no session to fit yet; bring that one in first")
            return
        joints = self.bench.inputs.runs[0].joints
        if use != "new" and run.joints != joints:
            raise ConfigError(
                f"the new session has joints {', '.join(run.joints)}, the open one has "
                f"{', '.join(joints)}; they are of two robots. Choose 'begin anew' to leave the "
                "open one"
            )

    def _with(self, runs: list[Recording], paths: list[str], use: str, made: str) -> dict[str, Any]:
        """The bench with further sessions; it stays as it was where they cannot be compared."""
        for run in runs:
            self._fits(run, use)
        commands = (made,) if made else ()
        if self.bench is None or use == "new":
            model = base_model(runs[0].robot, runs[0].arm)
            bench = Workbench(Inputs(tuple(runs), (), model, tuple(paths), made=commands))
        else:
            inputs = _joined(self.bench.inputs, runs, paths, use)
            inputs = replace(inputs, made=(*inputs.made, *commands))
            stack = [replace(r, found=None) for r in self.bench.stack]
            bench = Workbench(inputs, stack, self.bench.at)
        bench.own = list(self.effects)
        state = bench.start()
        self.bench, self.table = bench, ""
        return state

    # ------------------------------------------------------------ own effects

    def learn(self, path: str, text: str, agreed: str) -> dict[str, Any]:
        """Take the effects of the editor into the catalogue, and rank them."""
        place = Path(path).resolve()
        used = {n for r in self.bench.stack for n in r.model.names()} if self.bench else set()
        names = own.learn(place, text, agreed == "yes", str(place) in self.written, used)
        self.written = tuple(dict.fromkeys([*self.written, str(place)]))
        self.effects = tuple(dict.fromkeys([*self.effects, *names]))
        if self.bench is None:
            return {"saved": f"{path}: {', '.join(names)}", "notes": []}
        self.bench.own = list(self.effects)
        rung = self.bench.now
        plugins = tuple(dict.fromkeys([*rung.model.plugins, str(place)]))
        rung.model, rung.found = replace(rung.model, plugins=plugins), None
        return self.bench.state()


def _joined(inputs: Inputs, runs: list[Recording], paths: list[str], use: str) -> Inputs:
    """Further sessions among those that are fitted, or judged on; each with a name of its own."""
    taken = {r.name for r in (*inputs.runs, *inputs.held)}
    fresh = tuple(
        replace(r, name=f"{r.name}#{len(taken) + k}") if r.name in taken else r
        for k, r in enumerate(runs)
    )
    if use == "holdout":
        return replace(inputs, held=(*inputs.held, *fresh), holdout=(*inputs.holdout, *paths))
    return replace(inputs, runs=(*inputs.runs, *fresh), sessions=(*inputs.sessions, *paths))
