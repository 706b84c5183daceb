"""Notes beside a verdict: pairs to whoever shows them, and no words to parse for whoever asks."""

import copy
import pickle

from hil.diagnosis.heldout import BOTH, DIFFER, HELD_OUT_ADVICE, RIG_STATE, _advised
from hil.diagnosis.residual_tests import CHANGED, CUT_THERE, changes_told
from hil.diagnosis.types import Change
from hil.diagnosis.verbs import _as_fault
from hil.diagnosis.verdict import HIGH_FLOOR, LARGE, NO_SENSOR, NOT_WHITE, no_noise, not_white
from hil.record.consistency import DataFault, Note, notes_of


def test_a_note_is_a_pair_that_says_what_it_is_of():
    note = DataFault("gap", "warning", "elbow: left", "rows are missing").note
    code, text = note
    assert (code, text) == ("gap", "elbow: left: rows are missing")
    assert note == (code, text) and note.joint == "elbow: left"  # no colon of a sentence ends it
    for other in (copy.deepcopy(note), pickle.loads(pickle.dumps(note)), note.saying(text)):
        assert other == note and vars(other) == vars(note)
    assert note.saying("else").joint == note.joint and note.saying("else")[1] == "else"


def test_a_comparison_keeps_what_its_notes_are_of():
    note = Note("differs", "j1: it is another one", "j1", "another", "state")
    fault = _as_fault(note)
    assert fault.sentence == note[1] and fault.note is note
    assert vars(_as_fault(("plain", "words")).note) == vars(Note("plain", "words"))


def test_notes_are_found_by_their_codes():
    one, two = Note("a", "x", "j1"), Note("b", "y", "j2")
    assert notes_of([one, ("a", "of no joint"), two], "a") == [one]
    assert [n.joint for n in notes_of([one, two], "a", "b")] == ["j1", "j2"]


def test_a_floor_that_is_no_noise_is_told_from_one_that_no_sensor_makes():
    size = "31 % on j1: it says"
    for kind, no, white in (
        ("", "", ""),
        (NOT_WHITE, "", f"{LARGE}: {size}"),
        (NO_SENSOR, size, f"{LARGE}: {size}"),
    ):
        notes = [Note(HIGH_FLOOR, f"{LARGE}: {size}. More", size=size, kind=kind)]
        assert no_noise(notes) == no
        assert not_white(notes) == white


def test_only_the_last_of_several_differences_says_what_to_do():
    one = Note(DIFFER, "j1: x", "j1", "j1: x", RIG_STATE)
    two = Note(DIFFER, "j2: y", "j2", "j2: y")
    assert [n[1] for n in _advised([one, two])] == ["j1: x", f"j2: y. {HELD_OUT_ADVICE}"]
    # what is left of several is advised anew, by what is left
    again = _advised(_advised([one, two])[1:])
    assert [n[1] for n in again] == [f"j2: y. {BOTH}"]


def test_a_change_keeps_its_joint_behind_the_advice():
    found = [Change(j, "offset", "N m", "run1", 2.0, 0.1, 0.3, 9.0) for j in ("j1", "j2")]
    told = changes_told(found)
    assert [n.joint for n in notes_of(told, CHANGED)] == ["j1", "j2"]
    assert CUT_THERE in told[-1][1] and CUT_THERE not in told[0][1]
