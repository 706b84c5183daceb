"""Operating states: the table is complete, and FAULT is latched."""

import pytest

from hil.errors import DeviceError
from hil.signals.device import TRANSITIONS, OperatingState, StateCommand, StateMachine


@pytest.mark.parametrize("state", OperatingState)
@pytest.mark.parametrize("command", StateCommand)
def test_every_pair_moves_as_the_table_says_or_is_refused(state, command):
    machine = StateMachine("arm")
    machine.state = state
    following = TRANSITIONS.get((state, command))
    if following is None:
        with pytest.raises(DeviceError, match=f"arm is {state.name} and cannot {command.name}"):
            machine.command(command)
        assert machine.state is state
    else:
        assert machine.command(command) is following


def test_every_state_can_fault_and_only_clearing_leaves_a_fault():
    for state in OperatingState:
        assert TRANSITIONS[state, StateCommand.FAULT] is OperatingState.FAULT
    ways = {c for (s, c), to in TRANSITIONS.items() if s is OperatingState.FAULT and to is not s}
    assert ways == {StateCommand.CLEAR}
