"""Confusion matrix, power and calibration of the diagnosis over thousands of hidden effects.

`session` makes recordings, `cases` the plan, `amplitudes` says how large an effect is for a given
excess, `runner` judges each case, `tables` shows what comes out, `ablation` takes one rule away.
"""
