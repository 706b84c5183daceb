"""Studies of the thesis, end to end, each with its table."""
