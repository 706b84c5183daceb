"""Layouts with which a viewer opens a session: its signals on pages of plots.

What a session holds becomes pages, panels and curves once; each viewer has its own way to write
them down, and its own name for a signal.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from hil.errors import DataError
from hil.record.container import Container, Topic, read
from hil.record.schema import decode_joint_state

#: Colours that colour-blind people tell apart (Okabe and Ito 2008), in the order of use.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
#: Units of the parts of a joint state, of a joint that turns and of one that slides.
_UNITS = {
    "rad": {"position": "rad", "velocity": "rad/s", "effort": "N m"},
    "m": {"position": "m", "velocity": "m/s", "effort": "N"},
}
_FIELD = re.compile(r"float64 (\w+)(?:  # \[(.*)\])?")
#: Panels of the loop: title, unit, fields of ``/loop/timing``.
_LOOP = (
    ("Timing", "ns", ("wake_late", "busy")),
    ("Lost", "count", ("missed", "dropped", "ring")),
    ("State", "number", ("state", "status")),
    ("Hottest winding", "degC", ("winding",)),
)


@dataclass(frozen=True)
class Curve:
    """One signal.

    Parameters
    ----------
    label : str
        What the legend says.
    topic : str
        Its channel.
    path : tuple of str
        Names of the fields down to it; of a joint state ``(part, joint)``.
    index : int
        Place of the joint in the message; -1 where it is none of a joint.
    """

    label: str
    topic: str
    path: tuple[str, ...]
    index: int = -1


@dataclass(frozen=True)
class Panel:
    """Curves of one channel on common axes.

    Parameters
    ----------
    title, unit : str
        What they are.
    curves : tuple of Curve
        At least one.
    schema : str
        Of the channel, e.g. ``geometry_msgs/msg/WrenchStamped``.
    """

    title: str
    unit: str
    curves: tuple[Curve, ...]
    schema: str

    @property
    def heading(self) -> str:
        """Title with the unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


@dataclass(frozen=True)
class Page:
    """Panels that are seen together."""

    title: str
    panels: tuple[Panel, ...]


def pages(path: str | Path) -> list[Page]:
    """Pages of a session.

    Raises
    ------
    DataError
        If the file is no session, or holds nothing that can be plotted.
    """
    box = read(path)
    topics = [t for t in box.topics.values() if len(t) and t.encoding == "cdr"]
    found = [
        Page("Positions", _joint_panels(box, topics, "measured_js", "position")),
        Page("Velocities", _joint_panels(box, topics, "measured_js", "velocity")),
        Page("Efforts", _joint_panels(box, topics, "_jf", "effort")),
        Page("Forces", tuple(_wrench(t) for t in topics if _kind(t) == "WrenchStamped")),
        Page("More", tuple(_fields(t) for t in topics if _own(t))),
        Page("Loop", tuple(_loop(box))),
    ]
    full = [p for p in found if p.panels]
    if not full:
        raise DataError(
            f"session {path} holds no channel that a layout shows: none of joint states, wrenches "
            "and numbers has a message; 'hil info' lists what is there"
        )
    return full


def curves(layout: list[Page]) -> Iterator[Curve]:
    """All curves of all pages."""
    return (c for page in layout for panel in page.panels for c in panel.curves)


def _kind(topic: Topic) -> str:
    return topic.schema.rpartition("/")[2]


def _own(topic: Topic) -> bool:
    """Whether a channel is one of estimates, controller states, currents: numbers by name."""
    rest = _kind(topic) not in ("JointState", "WrenchStamped")
    apart = topic.name == "/loop/timing" or topic.name.startswith("/rig/")
    return rest and not apart and bool(_names(topic))


def _names(topic: Topic) -> dict[str, str]:
    """Fields of an own message and their units, from its schema."""
    head = topic.schema_text.decode("utf-8", "replace").partition("=" * 80)[0]
    return {m[1]: m[2] or "" for m in _FIELD.finditer(head)}


def _joint_panels(box: Container, topics: list[Topic], ending: str, part: str) -> tuple[Panel, ...]:
    out = []
    for t in topics:
        if _kind(t) != "JointState" or not t.name.endswith(ending):
            continue
        arm = t.name.strip("/").partition("/")[0]
        units = box.metadata.get(f"robot/{arm}", {}).get("unit", "rad").split()
        joints, parts = decode_joint_state(t.only(np.arange(len(t)) < 1))
        if parts[part] is not None:
            made = tuple(Curve(j, t.name, (part, j), k) for k, j in enumerate(joints))
            named = f"{t.name} {part}" if ending == "measured_js" else t.name
            said = " or ".join(_UNITS.get(u, _UNITS["rad"])[part] for u in dict.fromkeys(units))
            out.append(Panel(named, said, made, t.schema))
    return tuple(out)


def _wrench(topic: Topic) -> Panel:
    made = (Curve(f"force {a}", topic.name, ("wrench", "force", a)) for a in "xyz")
    return Panel(topic.name, "N", tuple(made), topic.schema)


def _fields(topic: Topic) -> Panel:
    names = _names(topic)
    units = ", ".join(dict.fromkeys(u for u in names.values() if u))
    made = tuple(Curve(n, topic.name, (n,)) for n in names)
    return Panel(topic.name, units, made, topic.schema)


def _loop(box: Container) -> Iterator[Panel]:
    timing = box.topics.get("/loop/timing")
    if timing is None or not len(timing):
        return
    held = _names(timing)
    for title, unit, fields in _LOOP:
        made = tuple(Curve(f, "/loop/timing", (f,)) for f in fields if f in held)
        if made:
            yield Panel(title, unit, made, timing.schema)


# ------------------------------------------------------------ Foxglove, Lichtblick


def foxglove_path(c: Curve) -> str:
    """Message path of a curve."""
    steps = c.path if c.index < 0 else (f"{c.path[0]}[{c.index}]",)
    return ".".join((c.topic, *steps))


#: Keys under which Foxglove and Lichtblick keep the title of a panel.
PANEL_TITLES = ("foxglovePanelTitle", "lichtblickPanelTitle")


def foxglove(layout: list[Page]) -> str:
    """Layout of Foxglove and Lichtblick: a tab a page, a plot a panel."""
    configs: dict[str, object] = {}
    tabs = []
    for page in layout:
        names = []
        for panel in page.panels:
            names.append(f"Plot!hil{len(configs)}")
            configs[names[-1]] = {
                **dict.fromkeys(PANEL_TITLES, panel.heading),
                "paths": [
                    {
                        "value": foxglove_path(c),
                        "label": c.label,
                        "color": COLOURS[k % len(COLOURS)],
                        "enabled": True,
                        "timestampMethod": "receiveTime",
                    }
                    for k, c in enumerate(panel.curves)
                ],
                "isSynced": True,
                "legendDisplay": "floating",
                "showLegend": True,
                "showPlotValuesInLegend": False,
                "sidebarDimension": 240,
                "showXAxisLabels": True,
                "showYAxisLabels": True,
                "xAxisVal": "timestamp",
            }
        tabs.append({"title": page.title, "layout": _split(names)})
    configs["RawMessages!events"] = {
        **dict.fromkeys(PANEL_TITLES, "Events"),
        "topicPath": "/events",
    }
    tabs.append({"title": "Events", "layout": "RawMessages!events"})
    configs["Tab!hil"] = {"activeTabIdx": 0, "tabs": tabs}
    table = {
        "configById": configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "Tab!hil",
    }
    return json.dumps(table, indent=1) + "\n"


def _split(names: list[str], direction: str = "row") -> object:
    """Panels side by side, then below each other: a tree of halves."""
    if len(names) == 1:
        return names[0]
    half = (len(names) + 1) // 2
    other = "column" if direction == "row" else "row"
    parts = _split(names[:half], other), _split(names[half:], other)
    share = 100.0 * half / len(names)
    return {
        "first": parts[0],
        "second": parts[1],
        "direction": direction,
        "splitPercentage": round(share, 1),
    }


# ------------------------------------------------------------ PlotJuggler


def plotjuggler_name(c: Curve) -> str:
    """Name of a curve's series."""
    steps = c.path if c.index < 0 else c.path[::-1]  # topic/joint/position
    return "/".join((c.topic, *steps))


#: Of the layout; the first releases of PlotJuggler 3 ask before they take another or none, later
#: ones do not read it.
LAYOUT_VERSION = "2.3.8"


def plotjuggler(layout: list[Page]) -> str:
    """Layout of PlotJuggler: a tab a page, panels below each other."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f'<root version="{LAYOUT_VERSION}">']
    lines.append(' <tabbed_widget parent="main_window" name="Main Window">')
    for page in layout:
        n = len(page.panels)
        sizes = ";".join([f"{1 / n:.6f}"] * n)
        lines += [f'  <Tab tab_name={quoteattr(page.title)} containers="1">', "   <Container>"]
        lines.append(f'    <DockSplitter orientation="-" count="{n}" sizes="{sizes}">')
        for panel in page.panels:
            lines.append(f"     <DockArea name={quoteattr(panel.heading)}>")
            lines.append('      <plot mode="TimeSeries" style="Lines">')
            lines.append("       <limitY/>")
            for k, c in enumerate(panel.curves):
                name, colour = quoteattr(plotjuggler_name(c)), COLOURS[k % len(COLOURS)]
                lines.append(f'       <curve name={name} color="{colour}"/>')
            lines += ["      </plot>", "     </DockArea>"]
        lines += ["    </DockSplitter>", "   </Container>", "  </Tab>"]
    lines += ['  <currentTabIndex index="0"/>', " </tabbed_widget>"]
    lines += [' <use_relative_time_offset enabled="1"/>', "</root>"]
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------ rerun

_RERUN = '''"""Opens a session in the rerun viewer: python {file} S.mcap.

Needs rerun-sdk 0.41 or later. Without this file, `rerun S.mcap` opens a session without pages.
Written by hil view.
"""

import argparse
import json

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

COLOURS = [
{colours}
]
# Page, and its panels: title, entity, component, and label and selector of every curve.  Where
# the component is empty, the entity itself holds the numbers, one a joint.
PAGES = json.loads("""
{pages}
""")


def lines(component, curves):
    """What draws the curves of an entity."""
    if not component:
        colours = [COLOURS[k % len(COLOURS)] for k in range(len(curves))]
        return [rr.SeriesLines(names=[label for label, _ in curves], colors=colours)]
    made = []
    for k, (label, selector) in enumerate(curves):
        source = VisualizerComponentMapping(
            "Scalars:scalars",
            ComponentSourceKind.SourceComponent,
            source_component=component,
            selector=selector,
        )
        line = rr.SeriesLines(names=label, colors=[COLOURS[k % len(COLOURS)]])
        made.append(line.visualizer(mappings=[source]))
    return made


def view(title, entity, component, curves):
    """One panel."""
    overrides = {{entity: lines(component, curves)}}
    return rrb.TimeSeriesView(name=title, contents=[entity], overrides=overrides)


def blueprint():
    """All pages, as tabs."""
    tabs = [rrb.Grid(*(view(*p) for p in panels), name=name) for name, panels in PAGES]
    return rrb.Blueprint(rrb.Tabs(*tabs), collapse_panels=True)


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("session", metavar="S.mcap")
    rr.script_add_args(options)
    args = options.parse_args()
    rr.script_setup(args, "hil", default_blueprint=blueprint())
    rr.log_file_from_path(args.session)
    rr.script_teardown(args)
'''


def rerun_source(c: Curve, schema: str) -> tuple[str, str, str]:
    """Entity, component and selector of a curve."""
    if c.index >= 0:
        return f"{c.topic}/{c.path[0]}", "", ""
    return c.topic, f"{schema.replace('/', '.')}:message", "".join(f".{s}" for s in c.path)


def rerun(layout: list[Page]) -> str:
    """Program that opens a session in rerun: a tab a page, a view a panel."""
    table = []
    for page in layout:
        panels = []
        for p in page.panels:
            sources = [rerun_source(c, p.schema) for c in p.curves]
            entity, component, _ = sources[0]
            named = [(c.label, s[2]) for c, s in zip(p.curves, sources, strict=True)]
            panels.append((p.heading, entity, component, named))
        table.append((page.title, panels))
    text = json.dumps(table, indent=1).replace("\\", "\\\\")
    colours = [list(bytes.fromhex(c[1:])) for c in COLOURS]
    rows = "\n".join(f"    {row}," for row in colours)
    return _RERUN.format(colours=rows, pages=text, file="FILE.py")


@dataclass(frozen=True)
class Viewer:
    """How a viewer gets its layout.

    Parameters
    ----------
    title, ending, opens, sign : str
        Name; of the file; what to do with it, with ``{file}`` and ``{session}``; what stands in
        every such file.
    write : callable
        Text of a layout.
    """

    title: str
    ending: str
    opens: str
    sign: str
    write: Callable[[list[Page]], str]


VIEWERS: dict[str, Viewer] = {
    "foxglove": Viewer(
        "Foxglove or Lichtblick",
        ".json",
        "open {session} in it, then import {file} in the menu of layouts",
        '"configById"',
        foxglove,
    ),
    "plotjuggler": Viewer(
        "PlotJuggler", ".xml", "plotjuggler -d {session} -l {file}", "<tabbed_widget", plotjuggler
    ),
    "rerun": Viewer("rerun", ".py", "python {file} {session}", "Written by hil view.", rerun),
}
