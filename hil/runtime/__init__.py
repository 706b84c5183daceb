"""Runtime: clocks, the fast loop, the ring between the loops, the slow side, safety."""
