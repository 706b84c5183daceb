"""Answers, designs and sessions are what they were when they were frozen."""

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import sessions

FROZEN = json.loads(sessions.FILE.read_text("utf-8"))
#: Relative difference of two machines' numbers that is no change.
ALIKE = 2e-4


def different(path, was, now):
    """Places where two trees of names and numbers differ."""
    if isinstance(was, dict) and isinstance(now, dict):
        for k in sorted({*was, *now}):
            yield from different(f"{path}.{k}", was.get(k), now.get(k))
    elif isinstance(was, list) and isinstance(now, list) and len(was) == len(now):
        for k, (a, b) in enumerate(zip(was, now, strict=True)):
            yield from different(f"{path}[{k}]", a, b)
    elif isinstance(was, float) or isinstance(now, float):
        if was is None or now is None or was != pytest.approx(now, rel=ALIKE, abs=1e-9):
            yield f"{path}: {was} -> {now}"
    elif was != now:
        yield f"{path}: {was} -> {now}"


def settled(answer):
    """An answer whose neighbours of one error come by name: which is first is rounding."""
    groups = []
    for entry in answer["ranking"]:
        after = groups and groups[-1][-1][2]
        if groups and entry[2] == pytest.approx(after, rel=ALIKE):
            groups[-1].append(entry)
        else:
            groups.append([entry])
    return {**answer, "ranking": [entry for some in groups for entry in sorted(some)]}


@pytest.mark.parametrize("law", sessions.LAWS)
def test_diagnosis(law, tmp_path):
    now = settled(sessions.rounded(sessions.diagnosis(law, tmp_path)))
    assert list(different(law, settled(FROZEN["diagnoses"][law]), now)) == []


def test_an_order_that_is_no_rounding_is_seen():
    was = {"ranking": [["a", "joint1", 1.0], ["b", "joint1", 1.0], ["c", "joint1", 1.1]]}
    same = {"ranking": [was["ranking"][k] for k in (1, 0, 2)]}
    other = {"ranking": [was["ranking"][k] for k in (0, 2, 1)]}
    assert list(different("", settled(was), settled(same))) == []
    assert list(different("", settled(was), settled(other))) != []


@pytest.mark.parametrize("name", sessions.DESIGNS)
def test_design(name):
    now = sessions.rounded(sessions.design(name))
    assert list(different(name, FROZEN["designs"][name], now)) == []


@pytest.mark.parametrize("name", sessions.RUNS)
def test_session(name, tmp_path):
    now = sessions.rounded(sessions.session(name, tmp_path))
    assert list(different(name, FROZEN["sessions"][name], now)) == []
