"""A CAN bus with time on it: frames take their bits, one at a time, the lowest identifier first."""
