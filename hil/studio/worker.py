"""The process in which the studio computes: files that come in, own effects, and the bench.

It may begin with nothing: then the first session is brought in through the page.  One request is
computed at a time, and can be broken off: that ends the process, and a new one begins with the
models of the old one's last answer, so that nothing that was shown is lost.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hil import work
from hil.errors import ConfigError, HilError, in_short, own_place
from hil.interrupt import held_back, with_its_parent
from hil.models.model import base_model
from hil.record.recording import Recording
from hil.record.sources import find, load_sources
from hil.record.table_files import FORMATS, ending
from hil.studio import intake
from hil.studio import workbench as bench_verbs
from hil.studio.workbench import Inputs, Recommended, StudioRung, Workbench

#: What the page may ask for, and the names of its arguments.
_VERBS = {
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
    effects : tuple of str
        Names of these.
    recommended : Recommended or None
        What the last diagnosis of an earlier process said.
    """

    def __init__(
        self,
        inputs: Inputs | None = None,
        stack: list[StudioRung] | None = None,
        at: int = 0,
        table: str = "",
        written: tuple[str, ...] = (),
        effects: tuple[str, ...] = (),
        recommended: Recommended | None = None,
    ) -> None:
        self.table, self.written = table, written
        #: See `Workbench`.
        self.early: Callable[[dict[str, Any]], None] = lambda look: None
        models = [r.model for r in stack or ()] or ([inputs.model] if inputs else [])
        intake.again({p for m in models for p in m.plugins} | set(written))
        self.bench = Workbench(inputs, stack or [], at) if inputs else None
        self.effects = effects
        if self.bench is not None:
            self.bench.own, self.bench.files = list(effects), written
            self.bench.recommended = recommended

    def ask(self, verb: str, given: dict[str, str]) -> dict[str, Any]:
        """Answer a request that `checked_request` let through."""
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
        if ending(path) in FORMATS:
            shown = intake.shown(Path(path))
            self.table = path
            return {"intake": shown | {"preview": None}}
        found = find([path])
        runs, _ = load_sources(found, [], None, None)
        return self._with(runs, [str(p) for p in found], use, "")

    def preview(self, picks: str) -> dict[str, Any]:
        """What would be read of the table with these picks, and what is wrong with it."""
        read = intake.read_upload(self._open_table(), intake.Picked.parse(picks))
        return {"preview": intake.upload_summary(read)}

    def bring(self, picks: str, output: str, use: str) -> dict[str, Any]:
        """Write the session and go on with it."""
        picked, table = intake.Picked.parse(picks), self._open_table()
        read = intake.read_upload(table, picked)
        bad = [f["text"] for f in intake.upload_summary(read)["faults"] if f["severity"] == "error"]
        if bad:
            raise ConfigError(f"the recording cannot be fitted: {bad[0]}")
        self._fits(read.recordings[0], use)
        run, command = intake.write_session(read, picked, table, Path(output))
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
            stack = [replace(r, found=None, file="") for r in self.bench.stack]
            bench = Workbench(inputs, stack, self.bench.at)
        bench.own, bench.files = list(self.effects), self.written
        state = bench.start()
        self.bench, self.table = bench, ""
        return state

    # ------------------------------------------------------------ own effects

    def learn(self, path: str, text: str, agreed: str) -> dict[str, Any]:
        """Take the effects of the editor into the catalogue, and rank them."""
        place = Path(path).resolve()
        used = {n for r in self.bench.stack for n in r.model.names()} if self.bench else set()
        names = intake.learn_effects(place, text, agreed == "yes", str(place) in self.written, used)
        self.written = tuple(dict.fromkeys([*self.written, str(place)]))
        self.effects = tuple(dict.fromkeys([*self.effects, *names]))
        if self.bench is None:
            return {"saved": f"{path}: {', '.join(names)}", "notes": []}
        self.bench.own, self.bench.files = list(self.effects), self.written
        rung = self.bench.now
        plugins = tuple(dict.fromkeys([*rung.model.plugins, str(place)]))
        rung.model, rung.found, rung.file = replace(rung.model, plugins=plugins), None, ""
        # an effect of the same name may have other columns now
        self.bench.before = None
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


_SPAWN = multiprocessing.get_context("spawn")


@contextlib.contextmanager
def _away_from_here() -> Iterator[None]:
    """Let a new process import nothing of the working directory before it has our path."""
    name = "PYTHONSAFEPATH"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        os.environ.pop(name)
        if before is not None:
            os.environ[name] = before


@dataclass(frozen=True)
class BenchState:
    """What a new process needs to go on.

    Parameters
    ----------
    inputs : Inputs
        Sessions and first model.
    stack : tuple of StudioRung
        Models, without their comparisons.
    at : int
        Current one.
    table : str
        Table whose columns are being picked.
    written, effects : tuple of str
        Files of own effects, and names of these.
    recommended : Recommended or None
        What the last diagnosis said.
    """

    inputs: Inputs | None
    stack: tuple[StudioRung, ...] = ()
    at: int = 0
    table: str = ""
    written: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    recommended: Recommended | None = None


@dataclass(frozen=True)
class Reached:
    """How far a request has come.

    Parameters
    ----------
    what : str
        What is done now.
    share : float
        Share of the work that is done, 0 to 1.
    """

    what: str
    share: float


@dataclass(frozen=True)
class FirstLook:
    """What can be shown before a request is done.

    Parameters
    ----------
    shown : dict
        Parts of the state, see `Workbench.early`.
    """

    shown: dict[str, Any]


def checked_request(verb: str, given: Mapping[str, Any]) -> dict[str, str]:
    """Arguments of a request, all of them text.

    Raises
    ------
    ConfigError
        If the request is none, or has other arguments.
    """
    if verb not in _VERBS:
        raise ConfigError(f"no request {verb!r}; there are {', '.join(_VERBS)}")
    names = _VERBS[verb]
    if set(given) != set(names) or not all(isinstance(v, str) for v in given.values()):
        wanted = ", ".join(names) or "nothing"
        raise ConfigError(f"request {verb!r} takes {wanted}, as text; got {', '.join(given)}")
    return {n: str(given[n]) for n in names}


def _said(verb: str, error: Exception) -> str:
    """A request that failed as nobody foresaw, in a sentence; of others than files with its trace.

    Parameters
    ----------
    verb : str
        The request.
    error : Exception
        What ended it.
    """
    if place := own_place(error):
        return (
            f"an effect of your own failed in {place}: {in_short(error)}; mend it in the editor. "
            "The models stay as they were"
        )
    if isinstance(error, OSError):
        where = f" {error.filename}" if error.filename else ""
        return f"{verb} did not reach{where}: {error.strerror or error}; choose another place"
    if isinstance(error, UnicodeError):
        return f"{verb} met a file that is not text in UTF-8; choose another one"
    traceback.print_exception(error)
    return (
        f"{verb} failed: {in_short(error)}. The models stay as they were; the "
        "terminal of the studio shows where"
    )


def _serve(pipe: Connection, kept: BenchState) -> None:
    """The process: requests in, answers and what must be kept out."""
    with_its_parent()
    stack = [replace(r, found=None) for r in kept.stack]
    session = StudioSession(
        kept.inputs,
        stack,
        kept.at,
        kept.table,
        kept.written,
        kept.effects,
        kept.recommended,
    )
    session.early = lambda look: pipe.send(FirstLook(look))
    with work.listening(lambda what, share: pipe.send(Reached(what, share))):
        while True:
            try:
                verb, given = pipe.recv()
            except EOFError:
                return
            pipe.send((*answer_request(session, verb, given), _kept(session)))


def answer_request(
    session: StudioSession, verb: str, given: dict[str, str]
) -> tuple[dict[str, Any] | None, str]:
    """What a request gives, or a sentence on why it gives nothing.

    Parameters
    ----------
    session : StudioSession
        Whom it is asked.
    verb, given
        The request, as `checked_request` let it through.
    """
    try:
        return session.ask(verb, given), ""
    except HilError as failed:
        return None, intake.on_page(failed)
    except Exception as failed:  # what was shown outlives any error
        return None, _said(verb, failed)


def _kept(session: StudioSession) -> BenchState:
    """What a new process would need."""
    of_files = session.table, session.written, session.effects
    bench = session.bench
    if bench is None:
        return BenchState(None, (), 0, *of_files)
    stack = tuple(replace(r, found=None) for r in bench.stack)
    return BenchState(bench.inputs, stack, bench.at, *of_files, bench.recommended)


class Worker:
    """Computes requests in a process of its own, one after the other.

    Parameters
    ----------
    inputs : Inputs or None
        What the studio was opened with; None: sessions come through the page.
    table : str
        Table whose columns are to be picked.
    """

    def __init__(self, inputs: Inputs | None, table: str = "") -> None:
        self._kept = BenchState(inputs, table=table)
        self._lock = threading.Lock()
        self._process: Any = None
        self._answers: threading.Thread | None = None
        self._verb, self._since, self._number = "", 0.0, 0
        self._error, self._note = "", ""
        self._state: dict[str, Any] | None = None
        self._intake: dict[str, Any] | None = None
        self._preview: dict[str, Any] | None = None
        self._reached, self._look = Reached("", 0.0), FirstLook({})

    def ask(self, verb: str, given: Mapping[str, Any]) -> int:
        """Begin a request; its number.

        Raises
        ------
        ConfigError
            If another one is running, or the request is none.
        """
        words = checked_request(verb, given)
        with self._lock:
            if self._verb:
                raise ConfigError(f"{self._verb} is running; wait for it, or cancel it")
            self._verb, self._since, self._error, self._note = verb, time.monotonic(), "", ""
            self._reached, self._look = Reached("", 0.0), FirstLook({})
            self._number += 1
            number = self._number
            if self._process is None:
                self._start()
            pipe = self._pipe
        asked = (pipe, number, words)
        self._answers = threading.Thread(target=self._wait, args=asked, daemon=True)
        self._answers.start()
        return number

    def _start(self) -> None:
        ours, theirs = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_serve, args=(theirs, self._kept), daemon=True)
        # an interruption is for the server, which ends this process
        with _away_from_here(), held_back():
            self._process.start()
        theirs.close()
        self._pipe = ours

    def _wait(self, pipe: Connection, number: int, words: dict[str, str]) -> None:
        """Send the request and take its answer, unless it was broken off."""
        try:
            pipe.send((self._verb, words))
            while isinstance(answer := pipe.recv(), Reached | FirstLook):
                if isinstance(answer, FirstLook):
                    self._look = answer
                else:
                    self._reached = answer
            data, error, kept = answer
        except (EOFError, OSError):
            data, error, kept = None, "the computation ended before its answer", self._kept
            with self._lock:
                if number == self._number:
                    self._process = None
        with self._lock:
            if number != self._number or not self._verb:
                return
            self._verb, self._error, self._kept = "", error, kept
            if data is not None:
                self._take(data)

    def _take(self, data: dict[str, Any]) -> None:
        """Keep an answer where the page looks for it."""
        if "saved" in data:
            self._note = ". ".join([f"written: {data['saved']}", *data.get("notes", ())])
        elif "intake" in data:
            self._intake, self._preview = data["intake"], None
        elif "preview" in data:
            self._preview = data["preview"]
        else:
            self._state, self._intake, self._preview = data, None, None

    def cancel(self) -> None:
        """Break off what is running; the last answer stays."""
        with self._lock:
            if not self._verb:
                return
            self._verb, self._error = "", "cancelled"
            self._number += 1
            self._process.kill()
            self._process = None

    def status(self) -> dict[str, Any]:
        """What is running and since when [s]; number, error and note of the last request."""
        with self._lock:
            return {
                "running": self._verb,
                "seconds": time.monotonic() - self._since if self._verb else 0.0,
                "number": self._number,
                "doing": self._reached.what,
                "share": self._reached.share,
                "ladder": self._look.shown.get("ladder", []) if self._verb else [],
                "looked": bool(self._verb) and "series" in self._look.shown,
                "error": self._error,
                "note": self._note,
            }

    @property
    def look(self) -> dict[str, Any]:
        """What can be shown of the running request before it is done."""
        return self._look.shown

    @property
    def state(self) -> dict[str, Any] | None:
        """Last answer for the page."""
        with self._lock:
            return self._state

    @property
    def files(self) -> dict[str, Any]:
        """The table whose columns are being picked, and what its last picks would give."""
        with self._lock:
            return {"intake": self._intake, "preview": self._preview}

    def close(self) -> None:
        """End the process."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
                self._process = None
