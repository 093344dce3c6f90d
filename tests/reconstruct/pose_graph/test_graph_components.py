"""Which edges of a graph are bridges, and what hangs together."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.reconstruct.pose_graph.bridge_arbitration import bridges, count_up, groups

N = 9
EDGES = st.lists(st.tuples(st.integers(0, N - 1), st.integers(0, N - 1)).filter(lambda e: e[0] != e[1]), max_size=16)


@given(EDGES)
@settings(max_examples=examples(150))
def test_a_bridge_is_what_falls_apart_without_it(edges):
    first, second = np.array(edges, np.int32).reshape(-1, 2).T
    full = groups(N, first, second).max()
    falls_apart = [groups(N, np.delete(first, e), np.delete(second, e)).max() > full for e in range(len(edges))]
    assert bridges(N, first, second).tolist() == falls_apart


def test_counting_up():
    assert count_up(np.array([3, 0, 2])).tolist() == [0, 1, 2, 0, 1]
