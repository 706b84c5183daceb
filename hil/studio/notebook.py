"""The error ladder in a notebook cell: candidates to pick, *Add*, *Undo*, and the errors fall.

The same bench as the studio's, without a server: every button is a method, and what it computes is
computed in the notebook's own process.
"""

from __future__ import annotations

import contextlib
import html
import math
from collections.abc import Callable, Iterator
from typing import Any

from hil import work
from hil.errors import ConfigError, HilError
from hil.identify.result import FitResult
from hil.models.model import RobotModel, as_model
from hil.record.arrays import Runs, as_runs, held_out
from hil.studio.workbench import Inputs, Workbench
from hil.work import single_threaded

__all__ = ["LadderWidget", "widget"]

#: Error over noise floor at which a bar is full.
_FULL = 10.0
#: Said where a diagnosis recommends no model.
_NOTHING_TO_TAKE = "The diagnosis recommends no other model."


def widget(recordings: Runs, model: RobotModel, holdout: Runs | None = None) -> LadderWidget:
    """The error ladder to be worked on in a notebook cell.

    Parameters
    ----------
    recordings : Recording or list of Recording
        Runs to fit.
    model : RobotModel
        First model of the ladder.
    holdout : Recording or list of Recording, optional
        Runs to judge on; without, blocks of the fitted runs are held out.

    Returns
    -------
    LadderWidget
        Shown where it is the last line of a cell; `model` and `result` are those of the rung that
        is chosen.

    Raises
    ------
    ConfigError
        If ipywidgets is not installed, or an argument is of another kind.
    DataError
        If a run has a fault that makes every result worthless.
    """
    runs, held = as_runs(recordings, "hil.widget"), held_out(holdout, "hil.widget")
    names = tuple(r.name for r in runs), tuple(r.name for r in held)
    first = as_model(model, "hil.widget")
    return LadderWidget(Workbench(Inputs(tuple(runs), tuple(held), first, *names)))


class LadderWidget:
    """A stack of models with their errors; buttons add, undo, diagnose.

    Parameters
    ----------
    bench : Workbench
        Sessions and models.

    Attributes
    ----------
    view : ipywidgets.VBox
        What the notebook shows.
    """

    def __init__(self, bench: Workbench) -> None:
        self._bench = bench
        self._w = _widgets()
        self._state: dict[str, Any] = {}
        self._ladder = self._w.HTML()
        self._choice = self._w.Dropdown(description="missing?", layout={"width": "36em"})
        self._meaning = self._w.HTML()
        self._said = self._w.HTML()
        self._bar = self._w.FloatProgress(max=1.0, layout={"visibility": "hidden"})
        self._buttons = {
            name: self._w.Button(description=name, tooltip=tip)
            for name, tip in (
                ("Add", "add the chosen effect and refit"),
                ("Undo", "back to the model before"),
                ("Redo", "forward to the model after"),
                ("Diagnose", "run the whole diagnosis on this model"),
                ("Take", "take the model that the diagnosis recommends"),
            )
        }
        self.view = self._w.VBox(
            [
                self._ladder,
                self._w.HBox([self._choice, self._buttons["Add"]]),
                self._meaning,
                self._w.HBox([self._buttons[n] for n in ("Undo", "Redo", "Diagnose", "Take")]),
                self._bar,
                self._said,
            ]
        )
        self._connect()
        self._computed(bench.start)

    # ------------------------------------------------------------ what the buttons do

    @property
    def result(self) -> FitResult:
        """Fit of the chosen rung."""
        return self._bench.compared().result

    @property
    def model(self) -> RobotModel:
        """Fitted model of the chosen rung, as `hil.write_model` takes it."""
        return self.result.model

    def add(self, effect: str, joint: str = "") -> None:
        """Add an effect on a joint (empty: where it has no joint, or on all), and refit.

        Raises
        ------
        ConfigError
            If the effect or the joint is unknown, or the effect cannot be fitted to these data.
        """
        self._computed(lambda: self._bench.add(effect, joint))

    def undo(self) -> None:
        """Back to the model before."""
        self._computed(self._bench.undo)

    def redo(self) -> None:
        """Forward to the model after."""
        self._computed(self._bench.redo)

    def diagnose(self) -> None:
        """Run the whole diagnosis on the chosen model, and say what it found."""
        self._computed(self._bench.diagnose)
        self._said.value = _paragraph(self._state["diagnosis"]["text"])

    def take(self) -> None:
        """Take the model that the diagnosis recommends as the next rung.

        Raises
        ------
        ConfigError
            If there is no diagnosis yet, or it recommends no other model.
        """
        found = self._bench.recommended
        if found is not None and found.rung is None:
            raise ConfigError(_NOTHING_TO_TAKE)
        self._computed(self._bench.take)

    # ------------------------------------------------------------ inside

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self.view._repr_mimebundle_(**options)

    def _repr_html_(self) -> str:
        """The ladder without its buttons, for programs that show no widgets."""
        return ladder_html(self._state)

    def __repr__(self) -> str:
        rungs = [f"{r['label']}: {_in_words(r)}" for r in self._state["ladder"]]
        return f"LadderWidget({'; '.join(rungs)})"

    def _connect(self) -> None:
        """Give every button its method; what cannot be done is said below the buttons."""
        methods: dict[str, Callable[[], None]] = {
            "Add": self._add_chosen,
            "Undo": self.undo,
            "Redo": self.redo,
            "Diagnose": self.diagnose,
            "Take": self.take,
        }
        for name, method in methods.items():
            self._buttons[name].on_click(lambda _, method=method: self._pressed(method))
        self._choice.observe(self._explained, "value")

    def _add_chosen(self) -> None:
        if self._choice.value is not None:
            effect, joint, _ = self._choice.value
            self.add(effect, joint)

    def _pressed(self, method: Callable[[], None]) -> None:
        self._said.value = ""
        try:
            method()
        except HilError as error:
            self._said.value = _paragraph(str(error))

    @single_threaded
    def _computed(self, ask: Callable[[], dict[str, Any]]) -> None:
        """Compute with a progress bar and no second click, and show what came out."""
        with self._busy():
            self._state = ask()
        self._show()

    @contextlib.contextmanager
    def _busy(self) -> Iterator[None]:
        def told(what: str, done: float) -> None:
            self._bar.description, self._bar.value = what, done

        self._bar.layout.visibility = "visible"
        for button in self._buttons.values():
            button.disabled = True
        try:
            with work.listening(told):
                yield
        finally:
            self._bar.layout.visibility = "hidden"
            self._enabled()

    def _enabled(self) -> None:
        bench, found = self._bench, self._bench.recommended
        can = {
            "Add": bool(self._choice.options),
            "Undo": bench.at > 0,
            "Redo": bench.at < len(bench.stack) - 1,
            "Diagnose": True,
            "Take": found is not None and found.rung is not None,
        }
        for name, button in self._buttons.items():
            button.disabled = not can[name]

    def _show(self) -> None:
        state = self._state
        self._ladder.value = ladder_html(state)
        options = [
            (_offer(c), (c["effect"], c["joint"] or "", c["meaning"])) for c in state["candidates"]
        ]
        self._choice.options = options
        self._choice.index = 0 if options else None  # the best one; by itself none is chosen
        self._enabled()

    def _explained(self, change: Any) -> None:
        chosen = change["new"]
        self._meaning.value = _paragraph(chosen[2]) if chosen else ""


def _widgets() -> Any:
    try:
        import ipywidgets
    except ImportError as error:
        raise ConfigError(
            "hil.widget needs ipywidgets: pip install 'hil-teleop[notebook]'"
        ) from error
    return ipywidgets


def _paragraph(text: str) -> str:
    return "".join(f"<div>{html.escape(line)}</div>" for line in text.splitlines())


def _offer(c: dict[str, Any]) -> str:
    """One candidate in a line."""
    where = f" on {c['joint']}" if c["joint"] else ""
    after = c["relative_after"]
    return f"{c['effect']}{where}" + ("" if after is None else f": error to {after:.3g} %")


def _in_words(rung: dict[str, Any]) -> str:
    """Errors of a rung, joint by joint."""
    errors = [j["relative"] for j in rung["joints"] or ()]
    return ", ".join("-" if e is None else f"{e:.3g} %" for e in errors)


def ladder_html(state: dict[str, Any]) -> str:
    """Table of all rungs: held-out error of every joint, with a bar over its noise floor.

    Parameters
    ----------
    state : dict
        As `Workbench.state` gives it.
    """
    head = "".join(f"<th>{html.escape(j)}</th>" for j in state["joints"])
    rows = [
        f"<tr{_chosen(k == state['at'])}><td>{html.escape(rung['label'])}</td>"
        + "".join(_cell(x, state["adequate"]) for x in rung["joints"] or ())
        + "</tr>"
        for k, rung in enumerate(state["ladder"])
    ]
    judged = ", ".join(map(html.escape, state["holdout"])) or "held-out blocks of the fitted runs"
    return (
        f"<table><caption>Held-out error in % of the effort, and over the noise floor, on "
        f"{judged}</caption><tr><th>model</th>{head}</tr>{''.join(rows)}</table>"
    )


def _chosen(now: bool) -> str:
    return ' style="font-weight:bold" aria-current="true"' if now else ""


def _cell(error: dict[str, float | None], adequate: float) -> str:
    """Numbers of one joint, and a bar that is full at ten floors (logarithmic)."""
    relative, ratio = error["relative"], error["ratio"]
    if relative is None or ratio is None:
        return "<td>-</td>"
    # 1 floor: no bar; _FULL floors: the whole width
    share = min(max(math.log(max(ratio, 1.0)) / math.log(_FULL), 0.0), 1.0)
    colour = "#0072b2" if ratio <= adequate else "#d55e00"
    bar = f'<div style="height:4px;width:{100 * share:.0f}%;background:{colour}"></div>'
    return f'<td style="min-width:9em">{relative:.3g} % ({ratio:.2f} floors){bar}</td>'
