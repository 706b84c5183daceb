"""A rig: what its file says, what is attached, and its devices opened and wired."""
