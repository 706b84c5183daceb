"""Controllers: pure laws `update(t, x, u)`; no clock, no input or output of their own."""
