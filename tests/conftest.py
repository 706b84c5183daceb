"""Measurements that tests of several folders share."""

import tracemalloc

import pytest


@pytest.fixture
def memory_growth():
    """Bytes that 300 calls of a step keep, after 300 to warm up."""

    def measure(step):
        for _ in range(300):
            step()
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(300):
            step()
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
        return grown

    return measure
