"""Changed areas of a growing surface, so that the page redraws only those."""

from __future__ import annotations

from dataclasses import replace

from wafer_viewer.session.state.snapshot import Box, SurfaceInfo

KEPT = 32
"""Maximum number of separate changes; older ones are merged."""


def with_change(now: SurfaceInfo, before: SurfaceInfo | None, box_um: Box) -> SurfaceInfo:
    """Return the summary of a surface that differs from `before` only inside a box.

    The surface is new everywhere if there is no `before`, or if its pixel lattice differs.
    """
    if before is None or _lattice(now) != _lattice(before):
        return replace(now, changed=())
    earlier = before.changed or ((before.stamp, _whole(before)),)
    changed = (*earlier, (now.stamp, box_um))
    while len(changed) > KEPT:
        (_, first), (stamp, second), *rest = changed
        changed = ((stamp, _both(first, second)), *rest)
    return replace(now, changed=changed)


def stamp_of(info: SurfaceInfo, box_um: Box) -> int:
    """Return the stamp of the last change of a part of a surface."""
    return max((stamp for stamp, box in info.changed if _meet(box, box_um)), default=info.stamp)


def _lattice(info: SurfaceInfo) -> tuple[object, ...]:
    return info.result, info.rows, info.cols, info.pixel_um, info.x0_um, info.y0_um


def _whole(info: SurfaceInfo) -> Box:
    """Return the box of all pixels, enlarged by one pixel on each side."""
    x0, y1 = info.x0_um - info.pixel_um, info.y0_um + info.pixel_um
    return x0, y1 - (info.rows + 1) * info.pixel_um, x0 + (info.cols + 1) * info.pixel_um, y1


def _both(a: Box, b: Box) -> Box:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _meet(a: Box, b: Box) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]
