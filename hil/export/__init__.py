"""Models for other programs: refitted within what these can express."""
