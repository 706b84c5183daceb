"""What tests of several folders share."""

import tracemalloc
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# how long an example takes is the machine's affair, and measured in benchmarks
settings.register_profile(
    "any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any machine")

#: A loop on the clock of a machine that other programs use faults where they hold it up; what
#: it does wrong itself it does every time.
TRIES = 5


def pytest_collection_modifyitems(items):
    for item in items:
        if item.get_closest_marker("real_time"):
            item.add_marker(pytest.mark.flaky(reruns=TRIES - 1))


@pytest.fixture(autouse=True, scope="session")
def nothing_of_the_user(tmp_path_factory):
    """What is agreed to and latched in tests stays in them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HIL_STATE", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture
def agreed():
    """Agree to what a model file, or the cut program of a rig, would run."""

    def agree(what):
        from hil import consent
        from hil.rig.config import SafetyConfig
        from hil.rig.cut import proven

        if isinstance(what, Path):
            found = consent.plugin(what, what.read_bytes())
        else:
            found = consent.cut_program(proven(SafetyConfig(watchdog=1.0, cut=tuple(what))))
        consent.give(found)
        return found

    return agree


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
