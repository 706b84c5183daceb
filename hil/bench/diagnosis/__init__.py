"""Confusion matrix, power and calibration of the diagnosis over thousands of hidden effects.

`excitation` makes motions, `session` recordings, `cases` the plan, `amplitudes` how large an
effect is for a given excess, `judge` one case, `runner` all of them, `tables` what comes out.
"""
