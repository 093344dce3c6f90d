"""Connected components and bridges of a graph with fields as vertices and overlaps as edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Whole32s = NDArray[np.int32]
Wholes = NDArray[np.intp]
Flags = NDArray[np.bool_]


def groups(n: int, first: Whole32s, second: Whole32s) -> Whole32s:
    """Return the component number [n] of each vertex, with components joined by edges (first, second)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    joined = csr_array((np.ones(len(first), np.int8), (first, second)), (n, n))
    return np.asarray(connected_components(joined, directed=False)[1], np.int32)


def bridges(n: int, first: Whole32s, second: Whole32s) -> Flags:
    """Return a mask [e] of the edges that lie on no cycle.

    Every edge outside of a spanning tree gets a random number, and every edge of the tree the exclusive or of the
    numbers of the cycles through it; there are none where that is 0 (Pritchard and Thurimella 2011).
    """
    above, depth = _tree(n, first, second)
    below = np.where(above[first] == second, first, np.where(above[second] == first, second, -1))
    in_tree = np.zeros(len(first), np.bool_)
    child, edge = np.unique(below, return_index=True)
    in_tree[edge[child >= 0]] = True
    marks = np.zeros(n + 1, np.uint64)
    numbers = np.random.default_rng(7).integers(1, 2**63, len(first), np.uint64)
    for end in (first, second):
        np.bitwise_xor.at(marks, end[~in_tree], numbers[~in_tree])
    by_depth = np.argsort(depth, kind="stable")
    for level in np.split(by_depth, np.cumsum(np.bincount(depth)))[::-1]:
        np.bitwise_xor.at(marks, above[level], marks[level])
    return in_tree & (marks[below] == 0)


def _tree(n: int, first: Whole32s, second: Whole32s) -> tuple[Wholes, Wholes]:
    """Return the parent [n] of each vertex in a spanning tree, and its depth below a common root, vertex n."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order

    roots = np.unique(groups(n, first, second), return_index=True)[1]
    a, b = np.append(first, np.full(len(roots), n)), np.append(second, roots)
    graph = csr_array((np.ones(len(a)), (a, b)), (n + 1, n + 1))
    order, above = (np.asarray(a, np.intp) for a in breadth_first_order(graph, n, directed=False))
    place = np.empty(n + 1, np.intp)
    place[order] = np.arange(n + 1)
    return above[:n], _depths(place[above[order[1:]]])[place[:n] - 1]


def _depths(parents: Wholes) -> Wholes:
    """Return the depth of each vertex except the root, in breadth-first order, where parents never decrease."""
    depth = np.zeros(len(parents), np.intp)
    begin, level = 0, 0
    end = int(np.searchsorted(parents, 0, "right"))
    while begin < len(parents):
        depth[begin:end] = level
        begin, end, level = end, int(np.searchsorted(parents, end, "right")), level + 1
    return depth


def count_up(lengths: Wholes) -> Wholes:
    """Return concatenated ranges 0, 1, ... of the given lengths."""
    return np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
