"""Robots of one to seven joints in MuJoCo, with hidden effects of their own: the test plants.

Nothing here is shared with the tuning plants of `hil.sim_devices.fast`: another engine, other
robots, other motions, other laws.  `robots` is the table of links, `describe` writes MJCF and URDF
from it, `motions` makes references, `laws`, `drives`, `sensors` and `structure` hold the hidden
effects, `kinds` names them, and `session` runs a recording.  The library reaches it by entry
point only (group ``hil.sim_sessions``, name ``mujoco``).
"""
