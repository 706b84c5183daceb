"""Links that several drivers share: a CAN bus through python-can, UDP through a socket."""
