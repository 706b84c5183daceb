"""What the pages of studio and operator share: the guard at the door, type, colours, plots."""
