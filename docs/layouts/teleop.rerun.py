"""Opens a session in the rerun viewer: python FILE.py S.mcap.

Needs rerun-sdk 0.41 or later. Without this file, `rerun S.mcap` opens a session without pages.
Written by hil view.
"""

import argparse
import json

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

COLOURS = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [86, 180, 233],
    [230, 159, 0],
    [0, 0, 0],
]
# Page, and its panels: title, entity, component, and label and selector of every curve.  Where
# the component is empty, the entity itself holds the numbers, one a joint.
PAGES = json.loads("""
[
 [
  "Positions",
  [
   [
    "/leader/measured_js position [rad]",
    "/leader/measured_js/position",
    "",
    [
     [
      "joint1",
      ""
     ],
     [
      "joint2",
      ""
     ],
     [
      "joint3",
      ""
     ]
    ]
   ],
   [
    "/follower/measured_js position [rad]",
    "/follower/measured_js/position",
    "",
    [
     [
      "joint1",
      ""
     ],
     [
      "joint2",
      ""
     ],
     [
      "joint3",
      ""
     ]
    ]
   ]
  ]
 ],
 [
  "Velocities",
  [
   [
    "/leader/measured_js velocity [rad/s]",
    "/leader/measured_js/velocity",
    "",
    [
     [
      "joint1",
      ""
     ],
     [
      "joint2",
      ""
     ],
     [
      "joint3",
      ""
     ]
    ]
   ],
   [
    "/follower/measured_js velocity [rad/s]",
    "/follower/measured_js/velocity",
    "",
    [
     [
      "joint1",
      ""
     ],
     [
      "joint2",
      ""
     ],
     [
      "joint3",
      ""
     ]
    ]
   ]
  ]
 ],
 [
  "Efforts",
  [
   [
    "/leader/setpoint_jf [N m]",
    "/leader/setpoint_jf/effort",
    "",
    [
     [
      "joint1",
      ""
     ],
     [
      "joint2",
      ""
     ],
     [
      "joint3",
      ""
     ]
    ]
   ],
   [
    "/follower/setpoint_jf [N m]",
    "/follower/setpoint_jf/effort",
    "",
    [
     [
      "joint1",
      ""
     ],
     [
      "joint2",
      ""
     ],
     [
      "joint3",
      ""
     ]
    ]
   ]
  ]
 ],
 [
  "Forces",
  [
   [
    "/leader/measured_cf [N]",
    "/leader/measured_cf",
    "geometry_msgs.msg.WrenchStamped:message",
    [
     [
      "force x",
      ".wrench.force.x"
     ],
     [
      "force y",
      ".wrench.force.y"
     ],
     [
      "force z",
      ".wrench.force.z"
     ]
    ]
   ],
   [
    "/follower/measured_cf [N]",
    "/follower/measured_cf",
    "geometry_msgs.msg.WrenchStamped:message",
    [
     [
      "force x",
      ".wrench.force.x"
     ],
     [
      "force y",
      ".wrench.force.y"
     ],
     [
      "force z",
      ".wrench.force.z"
     ]
    ]
   ]
  ]
 ],
 [
  "More",
  [
   [
    "/controller/state",
    "/controller/state",
    "hil_msgs.msg.ControllerState:message",
    [
     [
      "started",
      ".started"
     ],
     [
      "offset1",
      ".offset1"
     ],
     [
      "offset2",
      ".offset2"
     ],
     [
      "offset3",
      ".offset3"
     ],
     [
      "force_x",
      ".force_x"
     ],
     [
      "force_y",
      ".force_y"
     ],
     [
      "force_z",
      ".force_z"
     ],
     [
      "error1",
      ".error1"
     ],
     [
      "error2",
      ".error2"
     ],
     [
      "error3",
      ".error3"
     ],
     [
      "rate1",
      ".rate1"
     ],
     [
      "rate2",
      ".rate2"
     ],
     [
      "rate3",
      ".rate3"
     ]
    ]
   ]
  ]
 ],
 [
  "Loop",
  [
   [
    "Timing [ns]",
    "/loop/timing",
    "hil_msgs.msg.LoopTiming:message",
    [
     [
      "wake_late",
      ".wake_late"
     ],
     [
      "busy",
      ".busy"
     ]
    ]
   ],
   [
    "Lost [count]",
    "/loop/timing",
    "hil_msgs.msg.LoopTiming:message",
    [
     [
      "missed",
      ".missed"
     ],
     [
      "dropped",
      ".dropped"
     ],
     [
      "ring",
      ".ring"
     ]
    ]
   ],
   [
    "State [number]",
    "/loop/timing",
    "hil_msgs.msg.LoopTiming:message",
    [
     [
      "state",
      ".state"
     ],
     [
      "status",
      ".status"
     ]
    ]
   ],
   [
    "Hottest winding [degC]",
    "/loop/timing",
    "hil_msgs.msg.LoopTiming:message",
    [
     [
      "winding",
      ".winding"
     ]
    ]
   ]
  ]
 ]
]
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
    overrides = {entity: lines(component, curves)}
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
