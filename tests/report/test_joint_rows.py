"""Tables of errors of arms with many joints, as they are printed."""

from __future__ import annotations

from hil import terminal


def test_the_joints_of_a_long_arm_are_rows_of_its_errors():
    """An error of every joint before and after: fifteen columns are no table to read."""
    joints = [f"panda_joint{k}" for k in range(1, 8)]
    values = [[f"{k}.{m}{x}" for k in range(7)] for m in "12" for x in "34"]
    rows = [("before", values[:2]), ("+ spring", values[2:])]
    text = terminal.of_joints("held-out error", joints, rows, ("%", "simulated %"))
    head, _, first, *rest = text.splitlines()
    assert head.split("  ")[-1].strip() == "+ spring simulated %" and len(rest) == 6
    assert first.split() == ["panda_joint1", "0.13", "0.23", "0.14", "0.24"]
    assert max(map(len, text.splitlines())) <= 80


def test_of_few_joints_the_models_are_the_rows():
    text = terminal.of_joints("held-out error", ["a", "b"], [("before", [["1", "2"]])])
    assert text.splitlines()[2].split() == ["before", "1", "2"]
    many = [(f"+ effect {k}", [[str(k)] * 4]) for k in range(5)]  # a ladder longer than the arm
    assert len(terminal.of_joints("error", list("abcd"), many).splitlines()) == 2 + 5
