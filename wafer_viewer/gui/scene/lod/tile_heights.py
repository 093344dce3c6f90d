"""Height ranges of surface parts, which determine the bounding boxes of tiles."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from wafer_viewer.gui.scene.lod.quadtree import Heights, Span
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.session.rendering.render_request import CoarseHeightField

_KEPT = 4096


def heights_of(on_show: DisplayedSurface, relief: CoarseHeightField | None) -> Heights:
    """Return a function for the lowest and highest scene z (mm) of a part; the global range without a relief."""
    facts = on_show.facts
    whole = on_show.scene_z(facts.low_um), on_show.scene_z(facts.high_um)
    if relief is None:
        return lambda rows, cols: whole
    z_um = np.frombuffer(relief.z_um, "<f4").reshape(relief.rows, relief.cols)
    scale = relief.pixel_um / facts.pixel_um

    @lru_cache(maxsize=_KEPT)
    def heights(rows: Span, cols: Span) -> tuple[float, float]:
        (r0, r1), (c0, c1) = (_part(span, scale, n) for span, n in zip((rows, cols), z_um.shape, strict=True))
        part = z_um[r0:r1, c0:c1]
        return on_show.scene_z(float(part.min())), on_show.scene_z(float(part.max()))

    return heights


def _part(span: Span, scale: float, n: int) -> Span:
    """Convert a span of level 0 to pixels of the relief, at least one."""
    first = min(max(0, int(span[0] / scale)), n - 1)
    return first, max(first + 1, min(n, int(np.ceil(span[1] / scale))))
