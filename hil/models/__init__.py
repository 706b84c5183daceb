"""Models of a robot: frozen tuples of named physical effects, composed with `+`."""
