from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.session.core.command_queue import DEPTH, UndoHistory


@given(st.lists(st.one_of(st.integers(), st.sampled_from(["undo", "redo"]))))
def test_it_behaves_as_a_list_with_a_cursor(steps):
    history, values, at = UndoHistory(None), [None], 0
    for step in steps:
        if step == "undo":
            at = max(0, at - 1)
            assert history.undo() == values[at]
        elif step == "redo":
            at = min(len(values) - 1, at + 1)
            assert history.redo() == values[at]
        else:
            values[at + 1 :] = [step]
            at += 1
            history.put(step)
        assert history.value == values[at]
        assert history.can_undo == (at > 0)
        assert history.can_redo == (at < len(values) - 1)


def test_the_oldest_values_are_forgotten():
    history = UndoHistory(0)
    for i in range(1, DEPTH + 10):
        history.put(i)
    while history.can_undo:
        history.undo()
    assert history.value == 9


def test_another_thing_cannot_be_undone():
    history = UndoHistory(1)
    history.put(2)
    history.restart(3)
    assert (history.value, history.can_undo, history.can_redo) == (3, False, False)
