"""What tests of several folders share."""

import gc
import os
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# how long an example takes is the machine's affair, and measured in benchmarks; a submission is
# judged on the same examples each time, and new ones are searched by hand and by `hil bench fuzz`
settings.register_profile(
    "any machine",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize="HIL_SAME_EXAMPLES" in os.environ,
)
settings.load_profile("any machine")

#: A loop on the clock of a machine that other programs use faults where they hold it up; what
#: it does wrong itself it does every time.
TRIES = 5


#: Files that take 20 s of CPU and more come first, so that two processes end together.  Of the
#: first two one begins with a diagnosis and one with a session: what either needs is compiled once.
LONGEST = (
    "diagnosis/test_payload_body.py",
    "system/test_hidden_named.py",
    "diagnosis/test_how_it_was_recorded.py",
    "diagnosis/test_sensors_named.py",
    "system/test_own_arm_circle.py",
    "diagnosis/test_search.py",
    "experiments/test_experiments.py",
    "experiments/test_replicate.py",
    "experiments/test_hidden_effect.py",
    "diagnosis/test_named_again.py",
    "diagnosis/test_planar.py",
    "identify/test_simulated_fit.py",
    "diagnosis/test_unknown_robot.py",
    "diagnosis/test_transmission_named.py",
    "bench/test_nothing_hidden.py",
    "frozen/test_frozen.py",
    "teleop/test_hybrid_from_data.py",
    "system/test_commands.py",
    "diagnosis/test_amplifier_named.py",
    "diagnosis/test_joint_zeros.py",
    "diagnosis/test_minima.py",
    "diagnosis/test_sessions_differ.py",
    "sim/test_mujoco_plants.py",
    "report/test_report.py",
)


def pytest_collection_finish():
    # thousands of tests live until the end: the collector need not look at them again
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items):
    place = {Path(__file__).parent / name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))
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
        from hil import trusted_code
        from hil.rig.config import SafetyConfig
        from hil.rig.cut import proven

        if isinstance(what, Path):
            found = trusted_code.plugin(what, what.read_bytes())
        else:
            found = trusted_code.cut_program(proven(SafetyConfig(watchdog=1.0, cut=tuple(what))))
        trusted_code.give(found)
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
