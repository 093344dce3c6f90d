"""Merging of defect pieces across cell borders, for example of a scratch over several dies. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wafer_viewer.measure.defects.segmentation import DefectPiece

NEAR_PX = 8.0
"""Pieces at a border with pixels within this distance are merged."""


def merge_border_pieces(pieces: Sequence[DefectPiece], pixel_um: float) -> list[list[DefectPiece]]:
    """Return the pieces in groups, one per defect."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    if not pieces:
        return []
    owner = np.concatenate([np.full(int(piece.border.sum()), k) for k, piece in enumerate(pieces)])
    at = np.concatenate([np.stack([p.x_um[p.border], p.y_um[p.border]], axis=1) for p in pieces])
    pairs = (
        np.asarray(KDTree(at).query_pairs(NEAR_PX * pixel_um, output_type="ndarray"))
        if len(at)
        else np.zeros((0, 2), int)
    )
    first, second = owner[pairs[:, 0]], owner[pairs[:, 1]]
    links = coo_array((np.ones(len(first)), (first, second)), shape=(len(pieces),) * 2)
    n, group = connected_components(links, directed=False)
    out: list[list[DefectPiece]] = [[] for _ in range(int(n))]
    for piece, k in zip(pieces, group, strict=True):
        out[int(k)].append(piece)
    return out
