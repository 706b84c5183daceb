"""The commands of `hil`, one module each, and what they share."""
